"""The bus as an independent subscriber receives it: three frames, plain maps, no gaps, the promised rates."""

import collections
import json
import re
import time

import msgpack
import pytest
from harness import Bench

from palmd.pivot_quantities import PIVOT_TOPICS
from palmd.quantities import CONFIG, IMPROVEMENT, NOTE, OBJECT, UNEXPLAINED
from palmd.rig.simulate import simulate_log
from palmd.three_palms_quantities import PALM3_TOPICS
from palmd.topics import TOPICS
from tools.published import validate

pytestmark = pytest.mark.rig

SECONDS = 3.0
RATES_HZ = {  # wide limits below the promise for a slow machine; never above the promise
    "palm/estimate": (50.0, 101.0),
    "palm/contact": (50.0, 101.0),
    "palm/motion": (50.0, 101.0),
    "palm/events": (50.0, 101.0),
    "palm/shape": (4.0, 10.5),
    "palm/state": (5.0, 20.0),
    "palm/loop": (0.5, 1.2),
    "palm/info": (0.5, 1.2),
    "palm/config": (0.5, 1.2),
    "palm/log": (0.5, 10.5),
    "palm/rig": (0.5, 6.0),  # the smoother answers at most four times a second
}
STAMP = re.compile(rb"\d{10,}\.\d{3,}")
PLOTTED_TEXT = 100  # PlotJuggler omits longer strings


# without the topics of stored outlines and of the smoother's first result
SELDOM = (OBJECT, IMPROVEMENT, UNEXPLAINED, NOTE)
ALWAYS = [topic for topic in TOPICS if topic not in (*SELDOM, *PIVOT_TOPICS.published, *PALM3_TOPICS.published)]


@pytest.fixture(scope="module")
def wire(bench):
    """All messages during some seconds of a running plan, by topic: frames, and the map."""
    bench.run_plan()
    return heard(bench)


def heard(bench):
    bench.drain()
    found = collections.defaultdict(list)
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        for frames in bench.subscriber.frames(1, 0.05):
            found[frames[0].decode("ascii")].append((frames, msgpack.unpackb(frames[1], strict_map_key=True)))
    return found


def plain(value):
    return isinstance(value, bool | int | float | str)


def test_every_topic_comes_at_its_rate(wire):
    assert wire.keys() - {IMPROVEMENT.name, UNEXPLAINED.name} == {topic.name for topic in ALWAYS} == RATES_HZ.keys()
    for topic, (low, high) in RATES_HZ.items():
        times = [fields["mono_ns"] * 1e-9 for _, fields in wire[topic]]
        assert low * SECONDS - 1.0 <= len(times) <= high * SECONDS + 2.0, topic
        assert times == sorted(times)


@pytest.mark.parametrize("topic", ALWAYS, ids=lambda topic: topic.name)
def test_messages_agree_with_the_contract(wire, topic):
    numbers = []
    for frames, fields in wire[topic.name]:
        assert len(frames) == 3
        assert STAMP.fullmatch(frames[2])
        assert float(frames[2]) == pytest.approx(fields["timestamp"], abs=1e-5)
        assert abs(fields["timestamp"] - time.time()) < 120.0
        assert fields["v"] == 1
        assert validate(topic, fields) == []
        for name, value in fields.items():
            if name == "sd":
                assert all(isinstance(key, str) and isinstance(sd, float) for key, sd in value.items())
            else:
                assert plain(value) or (isinstance(value, list) and all(map(plain, value))), name
            held = name == "cause" and fields["state"] in ("hold", "fault")  # the cause of a hold is published in full
            document = topic is CONFIG and name == "yaml"  # not for plotting
            if isinstance(value, str) and not held and not document:
                assert len(value) < PLOTTED_TEXT, name
        numbers.append(fields["seq"])
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_all_messages_of_a_tick_have_one_time(wire):
    ticks = [{fields["mono_ns"] for _, fields in wire[f"palm/{topic}"]} for topic in ("estimate", "contact", "motion")]
    assert len(ticks[0] & ticks[1] & ticks[2]) >= max(map(len, ticks)) - 2


def test_published_values_of_the_object_are_consistent(wire):
    _, shape = wire["palm/shape"][-1]
    lengths = {len(shape[name]) for name in ("theta_rad", "h_m", "h_sd_m", "touched")}
    assert len(lengths) == 1
    assert lengths.pop() >= 180
    assert set(shape["touched"]) <= {0, 1}
    _, state = wire["palm/state"][-1]
    assert len(state["faults"]) == len(state["severities"]) == len(state["hints"])
    _, estimate = wire["palm/estimate"][-1]
    assert set(estimate["sd"]) <= {name for name, value in estimate.items() if isinstance(value, float)}


def test_with_stored_outlines_the_object_is_recognised(tmp_path):
    library = tmp_path / "library"
    library.mkdir()
    for seed in (1, 2):
        truth = simulate_log("rig", seed, 0.1)[1]
        stored = {name: truth[name] for name in ("theta_rad", "h_m", "rho_m")}
        (library / f"object{seed}.json").write_text(json.dumps(stored))
    bench = Bench(tmp_path, observer={"shape": str(library)})
    try:
        bench.run_plan()
        messages = [fields for _, fields in heard(bench)[OBJECT.name]]
        for _ in range(5):  # rejecting both outlines takes a second of steady contact
            if max(fields["none"] for fields in messages) > 0.9:
                break
            messages += [fields for _, fields in heard(bench)[OBJECT.name]]
    finally:
        bench.close()
    assert len(messages) >= 10
    assert all(validate(OBJECT, fields) == [] for fields in messages)
    assert messages[-1]["names"] == ["object1", "object2"]
    assert sum(messages[-1]["probability"]) + messages[-1]["none"] == pytest.approx(1.0)
    assert max(fields["none"] for fields in messages) > 0.9
