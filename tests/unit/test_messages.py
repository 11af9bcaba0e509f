"""The published messages against the contract's list of fields."""

import dataclasses
import math

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from improvements import improvement

from palmd.config.any_config import as_yaml, config_hash
from palmd.events import (
    Estimate,
    ObjectEstimate,
    PadLift,
    PadSample,
    PalmMotion,
    PalmSample,
    ShapeEstimate,
    Unexplained,
)
from palmd.faults import TABLE
from palmd.messages import (
    NAMED_STATE,
    LogEntry,
    PadView,
    contact_fields,
    entries_of,
    estimate_fields,
    events_fields,
    events_of,
    improvement_fields,
    info_fields,
    log_fields,
    motion_fields,
    named_state_is_finite,
    note_fields,
    object_fields,
    rig_fields,
    shape_fields,
    stamp,
    state_fields,
    unexplained_fields,
)
from palmd.pivot_quantities import PIVOT_TOPICS
from palmd.quantities import (
    CONFIG,
    CONTACT,
    ESTIMATE,
    EVENTS,
    IMPROVEMENT,
    INFO,
    LOG,
    LOOP,
    MOTION,
    NOTE,
    OBJECT,
    RIG,
    SHAPE,
    STATE,
    UNEXPLAINED,
)
from palmd.rig.world import default_config
from palmd.system.rig_constants import RIG_NAMES
from palmd.three_palms_quantities import PALM3_TOPICS
from palmd.topics import TOPICS
from tools.published import validate

# The published contract, written out here a second time.
UNCERTAIN = [quantity.source for quantity in ESTIMATE.quantities if quantity.uncertain]


def an_estimate(**changes) -> Estimate:
    values = {name: 0.01 * (i + 1) for i, name in enumerate(UNCERTAIN)}
    sd = dict.fromkeys(UNCERTAIN, 0.001)
    extra = {"nis": 1.0, "observability": math.nan, "touched": 0.5}
    estimate = Estimate(t=1.0, valid=True, observer="shape", object_count=2, sd=sd, **values, **extra)
    return dataclasses.replace(estimate, **changes)


ZEROS = np.zeros(len(RIG_NAMES))
ENTRIES = (
    LogEntry(
        7, 0.98, "fault", "pad1-silent", "hold", "", math.nan, "pad 1 fell silent: its last packet is 61 ms old", "mute"
    ),
    LogEntry(8, 0.98, "state", "hold", "", "", math.nan, "tracking -> hold: fault pad1-silent"),
    LogEntry(9, 0.99, "fault", "pad1-silent", "", "", 0.01, "over after 0.01 s"),
)


def built():
    shape = ShapeEstimate(1.0, np.zeros(180), np.ones(180), np.ones(180), np.arange(180) < 90)
    loop = {
        "ticks": 1,
        "overruns": 0,
        **{f"{a}_{b}_ms": 0.1 for a in ("lateness", "work") for b in ("p50", "p99", "max")},
        "lateness_ms": [0.1, 0.2],
        "pad1_bytes_discarded": 3,
        "arm_crc_errors": 0,
        "bus_published": 1,
        "lag_ms": 40.0,
        "late_dropped": 0,
        "rss_mb": 100.0,
        "blocks": 300_000,
        "backend": "c",
    }
    return {
        ESTIMATE: estimate_fields(an_estimate()),
        SHAPE: shape_fields(shape),
        OBJECT: object_fields(ObjectEstimate(1.0, ("bolt", "nut"), np.array([0.97, 0.01]), 0.02, 1)),
        CONTACT: contact_fields((PadView(0.02, 17, 0.004, True, False), PadView()), math.nan),
        MOTION: motion_fields(PalmMotion.at_rest((0.5, 1.5)), None, "rock", 1, 0.25, "T"),
        STATE: state_fields("hold", [TABLE["pad1-port"], TABLE["vm-backend"]]),
        LOOP: loop,
        INFO: info_fields("0.1.0", "shape", default_config()),
        EVENTS: events_fields(1.0, [PadSample(0.99, 1, 0.02), PadLift(0.995, 2), PalmSample(0.98, (0.5, 1.5))]),
        IMPROVEMENT: improvement_fields(1.0, improvement(np.arange(3.0), np.eye(3), t=0.8)),
        UNEXPLAINED: unexplained_fields(1.0, Unexplained(0.8)),
        NOTE: note_fields(1.0, "put back"),
        CONFIG: {"config_hash": config_hash(default_config()), "yaml": as_yaml(default_config())},
        RIG: rig_fields(ZEROS + 1e-3, ZEROS + 1e-4, ZEROS + 1e-3, ZEROS),
        LOG: log_fields(ENTRIES),
    }


def test_every_topic_is_built_as_its_table_says():
    assert set(built()) == set(TOPICS) - {*PIVOT_TOPICS.published, *PALM3_TOPICS.published}
    for topic, fields in built().items():
        assert validate(topic, stamp(fields, 1.7e9, 12.5, 7)) == []


def test_log_entries_are_decoded_unchanged():
    fields = msgpack.unpackb(msgpack.packb(log_fields(ENTRIES)))
    assert repr(entries_of(fields)) == repr(ENTRIES)
    del fields["code"]  # as in older recordings
    assert repr(entries_of(fields)) == repr(tuple(dataclasses.replace(entry, code="") for entry in ENTRIES))
    assert entries_of(log_fields(())) == ()


def test_the_named_state_is_the_contracts():
    assert NAMED_STATE == ("r1", "r2", "omega0", "s1", "s2", "phi1", "omega1", "phi2", "omega2", "rho", "psi")


def test_info_has_the_rigs_dimensions():
    config = default_config()
    rig = config.rig.model_copy(update={"palm1_length_mm": 130.0, "base_mm": (110.0, -5.0)})
    pads = config.pads.model_copy(update={"palm2": config.pads.palm2.model_copy(update={"length_mm": 40.0})})
    fields = info_fields("0", "shape", config.model_copy(update={"rig": rig, "pads": pads}))
    lengths = {name: fields[name] for name in ("palm1_length_m", "palm2_length_m", "pad1_length_m", "pad2_length_m")}
    assert lengths == pytest.approx(
        {"palm1_length_m": 0.13, "palm2_length_m": 0.12, "pad1_length_m": 0.0555, "pad2_length_m": 0.04}
    )
    assert fields["base_m"] == pytest.approx([0.11, -0.005])
    assert fields["phi1_limits_rad"] == pytest.approx([math.radians(6), math.radians(150)])
    assert fields["phi2_limits_rad"] == pytest.approx([math.radians(35), math.radians(155)])
    assert fields["rate_limit_rad_s"] == pytest.approx(math.radians(120))
    assert fields["config_hash"] != info_fields("0", "shape", config)["config_hash"]


def test_a_numpy_bool_is_sent_as_a_boolean():
    assert estimate_fields(an_estimate(valid=np.bool_(True)))["valid"] is True


def test_the_timestamp_is_exact_to_the_nanosecond():
    fields = stamp({}, 1.7e9, 4066.152798716, 3)
    assert fields == {"v": 1, "timestamp": 1.7e9, "mono_ns": 4066152798716, "seq": 3}


def test_messages_are_transferred_with_string_keys_and_nan():
    for fields in built().values():
        back = msgpack.unpackb(msgpack.packb(fields))
        assert set(back) == set(fields)
        assert all(isinstance(key, str) for key in back)
    contact = msgpack.unpackb(msgpack.packb(built()[CONTACT]))
    assert math.isnan(contact["s2_m"])
    assert math.isnan(contact["arm_age_ms"])
    assert contact["age1_ms"] == pytest.approx(4.0)


@pytest.mark.parametrize("name", NAMED_STATE)
def test_an_estimate_is_invalid_without_any_of_the_named_fields(name):
    good = an_estimate()
    assert named_state_is_finite(good)
    assert not named_state_is_finite(dataclasses.replace(good, **{name: math.nan}))
    assert not named_state_is_finite(dataclasses.replace(good, sd={**good.sd, name: math.inf}))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"r1_m": None}, "r1_m must be number"),
        ({"valid": 1}, "valid must be bool"),
        ({"object": True}, "object must be number"),
        ({"extra": 1.0}, "extra is not in the table"),
        ({"sd": {"r1": 1.0}}, "sd must be sds"),
    ],
)
def test_validate_finds_invalid_fields(change, complaint):
    fields = stamp(estimate_fields(an_estimate()), 0.0, 0.0, 0) | change
    assert [complaint in error for error in validate(ESTIMATE, fields)] == [True]


def test_validate_finds_missing_fields():
    fields = estimate_fields(an_estimate())
    del fields["r2_m"]
    errors = validate(ESTIMATE, fields)
    assert any("r2_m is missing" in error for error in errors)
    assert any("mono_ns is missing" in error for error in errors)


NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
MAYBE = st.none() | NUMBERS
PADS = st.sampled_from([1, 2])
JOINTS = st.tuples(NUMBERS, NUMBERS)
EVENT = st.one_of(
    st.builds(PadSample, NUMBERS, PADS, NUMBERS, MAYBE),
    st.builds(PadLift, NUMBERS, PADS),
    st.builds(PalmSample, NUMBERS, JOINTS, st.none() | JOINTS, st.none() | JOINTS),
)


@given(NUMBERS, st.lists(EVENT, max_size=6))
def test_events_are_decoded_bit_for_bit(t, events):
    fields = msgpack.unpackb(msgpack.packb(events_fields(t, events)))
    back = events_of(fields)
    assert back == tuple(events)
    assert repr(back) == repr(tuple(events))  # the sign of zero counts too
    assert fields["t_tick_s"] == t


def test_events_with_other_fields_are_refused():
    fields = events_fields(1.0, [PadSample(0.99, 1, 0.02), PadLift(0.99, 2)])
    with pytest.raises(ValueError, match="source is 3"):
        events_of(fields | {"source": [3, 1]})
    with pytest.raises(ValueError, match="shorter"):
        events_of(fields | {"s_m": [0.02]})
    with pytest.raises(KeyError):
        events_of({"source": []})


def test_an_sd_of_a_quantity_without_one_is_found():
    fields = stamp(built()[RIG], 1.7e9, 12.5, 7)
    fields["sd"]["pad3_zero_m"] = 1.0
    assert validate(RIG, fields)
