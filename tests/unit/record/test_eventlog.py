"""Event logs: golden lines, tolerated and rejected input, error messages, and writing."""

import contextlib
import gzip
import json
import math
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palmd.events import PadLift, PadSample, PalmSample
from palmd.record.eventlog import LogError, event_line, header_line, line_text, read_log
from palmd.rig.simulate import simulate_log
from palmd.system.description import AS_CALIBRATED, MAP_SD_M, PadSensor, RigDescription
from palmd.system.vibration import AVERAGED, DRY, Vibration

HEADER = (
    '{"palmd_log":1,"rig":{"gravity_m_s2":9.81,"hinge":{"mode":"arc","palm1_length_m":0.11},'
    '"pad":{"length_m":0.0555,"noise_m":1e-4,"resolution_m":1.27e-4},"force_scale_std":0.05}}'
)
FIXED = HEADER.replace('"mode":"arc","palm1_length_m":0.11', '"mode":"fixed"')
PAD = '{"t":0.0031,"pad":1,"s_m":0.0213,"force_n":0.31}'
PALMS = (
    '{"t":0.004,"palms":{"phi1_rad":0.7,"phi2_rad":1.6,"omega1_rad_s":0.1,"omega2_rad_s":-0.2,'
    '"alpha1_rad_s2":3,"alpha2_rad_s2":-4.5}}'
)


@pytest.fixture
def log(tmp_path):
    """Writes lines (or bytes) to a file and returns its path."""
    path = tmp_path / "run.jsonl"

    def write(*lines):
        data = lines[0] if isinstance(lines[0], bytes) else "".join(f"{line}\n" for line in lines).encode()
        path.write_bytes(data)
        return path

    return write


@pytest.fixture
def described(log):
    """Writes a log of one reading with these keys in its rig; its path."""

    def write(**rig):
        header = json.loads(FIXED)
        header["rig"] |= rig
        return log(json.dumps(header), PAD)

    return write


def refused(path):
    with pytest.raises(LogError) as caught:
        read_log(path)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_a_gzipped_log_is_read(log):
    lines = f"{HEADER}\n{PAD}\n{PALMS}\n".encode()
    unpacked = read_log(log(lines)).events
    packed = gzip.compress(lines)
    assert read_log(log(packed)).events == unpacked
    assert refused(log(gzip.compress(f"{HEADER}\nno\n".encode()))).endswith("run.jsonl:2: not JSON: Expecting value")
    for broken in (packed[:-12], packed[:12], packed[:2], packed[:20] + bytes(8) + packed[28:]):
        assert refused(log(broken)).endswith("run.jsonl: the gzip file is truncated or damaged")


def test_golden_lines(log):
    run = read_log(log(HEADER, PAD, PALMS, '{"t":0.005,"pad":2,"s_m":0.02}'))
    assert run.events == (
        PadSample(0.0031, 1, 0.0213, 0.31),
        PalmSample(0.004, (0.7, 1.6), (0.1, -0.2), (3.0, -4.5)),
        PadSample(0.005, 2, 0.02, None),
    )
    pad = PadSensor(length=0.0555, noise=1e-4, resolution=1.27e-4, force_scale_std=0.05, force_resolution=0.02)
    assert run.rig == RigDescription(
        gravity=9.81, hinge="arc", palm1_length=0.11, base=(0.11, 0.0), palm_angle_noise=2e-4, pads=(pad, pad)
    ).known_to({**AS_CALIBRATED, "map_sd": MAP_SD_M})  # because the log has no calibration_sd  # fmt: skip
    assert run.notes == ()


@pytest.mark.parametrize(
    ("given", "map_sd"),
    [
        ({}, MAP_SD_M),
        ({"zero_m": 1e-4}, MAP_SD_M),
        ({"zero_m": 0.0}, 0.0),
        ({"zero_m": 0.0, "map_length_m": 2e-3}, 0.0),
        ({"map_m": 2e-5}, 2e-5),
        ({"zero_m": 1e-4, "map_m": 0.0}, 0.0),
    ],
)
def test_pads_have_the_residual_map_error_of_a_calibration_unless_the_rig_is_exactly_known(described, given, map_sd):
    assert [pad.map_sd for pad in read_log(described(calibration_sd=given)).rig.pads] == [map_sd] * 2


MAPPED = {"map": [[0.0, 0.0], [20.0, 0.1], [40.0, -0.2]]}


def with_pads(one, other):
    header = json.loads(FIXED)
    sensor = {"length_m": 0.0555, "noise_m": 1e-4, "resolution_m": 1.27e-4, "force_scale_std": 0.05}
    header["rig"]["pads"] = [sensor | one, sensor | other]
    return json.dumps(header)


def test_readings_are_corrected_by_the_map_of_their_pad(log):
    pads = [f'{{"t":0.01,"pad":{pad},"s_m":0.02,"force_n":1.0}}' for pad in (1, 2)]
    run = read_log(log(with_pads({}, MAPPED), *pads, '{"t":0.02,"pad":2,"s_m":0.04,"force_n":1.0}'))
    assert [event.s for event in run.events] == pytest.approx([0.02, 0.0201, 0.0398])


@pytest.mark.parametrize(
    "points",
    [
        [],
        [[1, 2]],
        [[1, 0.1], [1, 0.2]],
        [[2, 0], [1, 0]],
        [[0, "a"], [1, 0]],
        3,
        [[0], [1]],
        [[0, 0], [1, 9]],
        [[0, 0], [1e-200, 0]],
        [[0, 0], [1e308, 1]],
    ],
)
def test_an_invalid_map_is_rejected_by_name(log, points):
    with pytest.raises(LogError, match="map must"):
        read_log(log(with_pads({"map": points}, {}), PAD))


def test_optional_keys_of_a_header(described):
    rig = read_log(described(palm_angle_noise_rad=1e-3, force_resolution_n=0.0, palm2_length_m=0.2, colour="red")).rig
    assert rig.hinge == "fixed"
    assert (rig.palm_angle_noise, [pad.force_resolution for pad in rig.pads]) == (1e-3, [0.0, 0.0])


@pytest.mark.parametrize(
    ("given", "zero", "lag", "friction"),
    [
        (None, 1e-4, 2e-3, 0.3),
        ({"zero_m": None}, 1e-4, 2e-3, 0.3),
        ({"zero_m": 3e-4}, 3e-4, 2e-3, 0.3),
        ({"zero_m": 0.0, "scale": 0}, 0.0, 0.0, 0.3),
        ({"zero_m": 0.0, "friction": 0.0}, 0.0, 0.0, 0.0),
    ],
    ids=["nothing", "null", "one", "known", "known alike"],
)
def test_rig_constants_that_a_log_leaves_out_get_default_uncertainties(described, given, zero, lag, friction):
    rig = read_log(described(calibration_sd=given)).rig
    assert (rig.pads[0].zero_sd, rig.pads[1].lag_sd, rig.friction_sd) == (zero, lag, friction)


def test_rates_and_forces_may_be_missing_or_null(log):
    run = read_log(
        log(
            HEADER,
            '{"t":0,"palms":{"phi1_rad":0.7,"phi2_rad":1.6,"omega1_rad_s":null}}',
            '{"t":0,"pad":2,"s_m":0.02,"force_n":null}',
        )
    )
    assert run.events == (PalmSample(0.0, (0.7, 1.6)), PadSample(0.0, 2, 0.02))


def test_truth_never_becomes_an_event_and_unknown_keys_are_ignored(log):
    run = read_log(
        log(
            HEADER,
            '{"t":0.0,"truth":{"psi_rad":NaN,"pad":1}}',
            '{"t":0.001,"pad":1,"s_m":0.02,"truth":{"s1_m":0.02}}',
            '{"note":"a cat walked over the rig"}',
            "",
            '{"t":0.002,"pad":1,"s_m":0.03,"mood":[1,{}]}',
        )
    )
    assert run.events == (PadSample(0.002, 1, 0.03),)
    assert run.notes == (f"{log(HEADER, PAD)}: 1 lines of an unknown kind ignored",)


def test_readings_off_the_pad_are_left_out_as_when_they_are_received(log):
    run = read_log(log(HEADER, PAD, *(f'{{"t":0.01,"pad":1,"s_m":{s}}}' for s in (-0.001, 0, 1e-6, 0.0564, 0.0566))))
    assert [event.s for event in run.events] == [0.0213, 1e-6, 0.0564]
    assert "3 readings off the pad" in run.notes[0]


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_a_simulated_run_is_read_completely(log, ending):
    lines, _ = simulate_log("rig", 0, 1.0)
    run = read_log(log("".join(json.dumps(line) + ending for line in lines).encode()))
    assert len(run.events) == len(lines) - 1
    assert [event.t_sample for event in run.events] == [line["t"] for line in lines[1:]]
    assert run.rig.palm1_length == lines[0]["rig"]["hinge"]["palm1_length_m"]


def test_a_truncated_last_line_is_dropped_with_a_note_wherever_it_was_cut(log):
    whole = f"{HEADER}\n{PAD}\n".encode()
    last = '{"t":0.005,"pad":2,"s_m":0.02,"note":"é"}'.encode()
    for cut in range(1, len(last)):
        run = read_log(log(whole + last[:cut]))
        assert len(run.events) == 1, last[:cut]
        assert "run.jsonl:3: the last line is truncated" in run.notes[0]
    assert len(read_log(log(whole + last)).events) == 2
    assert len(read_log(log(whole + b"\0\0\0\0")).events) == 1
    assert ":3: not JSON" in refused(log(whole + last[:9] + b"\n"))


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("{", "not JSON"),
        ('{"t":0.1 "pad":1}', "not JSON"),
        ("[1]", "must be an object {…}, got a list"),
        ("17", "must be an object {…}, got 17"),
        ("[" * 100_000, "not JSON"),
        ('{"t":' + "9" * 5000 + ',"pad":1,"s_m":0.02}', "not JSON"),
        ('{"t":1' + "0" * 400 + ',"pad":1,"s_m":0.02}', "t must be a finite number, got a number above 1e20"),
        ('{"pad":1,"s_m":0.02}', "t is missing"),
        ('{"t":"0.1","pad":1,"s_m":0.02}', 't must be a finite number, got "0.1"'),
        ('{"t":true,"pad":1,"s_m":0.02}', "t must be a finite number, got true"),
        ('{"t":NaN,"pad":1,"s_m":0.02}', "t must be a finite number, got NaN"),
        ('{"t":0.1,"pad":3,"s_m":0.02}', "pad must be 1 or 2, got 3"),
        ('{"t":0.1,"pad":true,"s_m":0.02}', "pad must be 1 or 2, got true"),
        ('{"t":0.1,"pad":"1","s_m":0.02}', 'pad must be 1 or 2, got "1"'),
        ('{"t":0.1,"pad":1}', "s_m is missing"),
        ('{"t":0.1,"pad":1,"s_m":null}', "s_m must be a finite number, got null"),
        ('{"t":0.1,"pad":1,"s_m":Infinity}', "s_m must be a finite number, got Infinity"),
        ('{"t":0.1,"pad":1,"s_m":1e999}', "s_m must be a finite number, got Infinity"),
        ('{"t":0.1,"pad":1,"s_m":21.3}', "s_m is 21.3, not a position on a palm; the unit is metres"),
        ('{"t":0.1,"pad":1,"s_m":0.02,"force_n":"3"}', 'force_n must be a finite number, got "3"'),
        ('{"t":0.1,"palms":[0.7,1.6]}', "palms must be an object {…}"),
        ('{"t":0.1,"palms":{"phi1_rad":0.7}}', "phi2_rad is missing"),
        ('{"t":0.1,"palms":{"phi1_rad":45,"phi2_rad":1.6}}', "phi1_rad is 45"),
        ('{"t":0.1,"palms":{"phi1_rad":0.7,"phi2_rad":90}}', "phi2_rad is 90"),
        ('{"t":0.1,"palms":{"phi1_rad":0.7,"phi2_rad":1.6,"alpha1_rad_s2":-Infinity}}', "alpha1_rad_s2 must be a fin"),
        ('{"t":-1.1,"pad":1,"s_m":0.02}', "time goes back by 1.1031 s"),
        ('{"t":1700000000,"pad":1,"s_m":0.02}', "time jumps by 1.7e+09 s"),
        ('{"x":"' + "y" * (1 << 20) + '"}', "the line is longer than"),
    ],
)
def test_a_bad_line_is_reported_with_its_place(log, line, what):
    assert f"run.jsonl:3: {what}" in refused(log(HEADER, PAD, line, PAD))


@pytest.mark.parametrize(
    ("header", "what"),
    [
        (PAD, "the first line must be the header"),
        ("{}", "the first line must be the header"),
        (HEADER.replace('"palmd_log":1', '"palmd_log":2'), "palmd_log is 2; this palmd reads version 1"),
        (HEADER.replace('"palmd_log":1', '"palmd_log":true'), "palmd_log is true; this palmd reads version 1"),
        ('{"palmd_log":1}', "rig is missing"),
        (HEADER.replace('"gravity_m_s2":9.81,', ""), "gravity_m_s2 is missing"),
        (HEADER.replace("9.81", "0"), "gravity_m_s2 must be more than 0, got 0"),
        (HEADER.replace("9.81", "NaN"), "gravity_m_s2 must be a finite number, got NaN"),
        (HEADER.replace('"arc"', '"bent"'), 'hinge.mode must be fixed or arc, got "bent"'),
        (HEADER.replace(',"palm1_length_m":0.11', ""), "palm1_length_m is missing"),
        (HEADER.replace('"noise_m":1e-4', '"noise_m":"small"'), 'noise_m must be a finite number, got "small"'),
        (HEADER.replace("1.27e-4", "-1"), "resolution_m must be at least 0, got -1"),
        (
            HEADER.replace('"gravity', '"palm1_curvature_per_m":75.0,"gravity'),
            "palm1_curvature_per_m is 75, a radius of 13.3 mm: the pad would bend by more than a quarter turn",
        ),
        (
            HEADER.replace('"gravity', '"palm2_curvature_per_m":"flat","gravity'),
            'palm2_curvature_per_m must be a finite number, got "flat"',
        ),
    ],
)
def test_a_bad_header_is_reported(log, header, what):
    assert f"run.jsonl:1: {what}" in refused(log(header, PAD))


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        (None, Vibration()),
        ({}, Vibration()),
        ({"relation": "antiphase"}, Vibration("antiphase")),
        ({"relation": "none"}, DRY),
        ({"law": "averaged"}, AVERAGED),
        (
            {
                "relation": "in_phase",
                "frequency_hz": 250,
                "speed_m_s": 0.015,
                "speed_sd_m_s": 1e-3,
                "transmission": 0.9,
            },
            Vibration("in_phase", frequency=250.0, speed=0.015, speed_sd=1e-3, transmission=0.9),
        ),
        ({"speed_m_s": 0.015, "speed_m_s_sd": 1e-3}, Vibration(speed=0.015, speed_sd=1e-3)),
    ],
)
def test_vibration_in_the_header(described, written, meant):
    assert read_log(described(vibration=written)).rig.vibration == meant


@pytest.mark.parametrize(
    ("written", "what"),
    [
        ("fast", "vibration must be an object"),
        ({"relation": "alike"}, "vibration.relation must be one of independent, in_phase, antiphase, unknown, none"),
        ({"law": "old"}, "vibration.law must be one of sign_pairs, averaged"),
        ({"speed_m_s": 0}, "speed_m_s must be more than 0, got 0"),
        ({"frequency_hz": "250"}, "frequency_hz must be a finite number"),
        ({"transmission": 1.5}, "vibration.transmission must be 0 to 1, got 1.5"),
        ({"relation": ["independent"]}, "vibration.relation must be one of"),
    ],
)
def test_an_invalid_vibration_is_rejected(described, written, what):
    assert f"run.jsonl:1: {what}" in refused(described(vibration=written))


def test_files_that_are_no_log_are_rejected(log, tmp_path):
    assert refused(tmp_path / "none.jsonl").endswith("none.jsonl: No such file or directory")
    assert refused(tmp_path).endswith("Is a directory")
    assert ":1: the file is empty" in refused(log(b""))
    assert ":1: the file is empty" in refused(log(b"\n  \n"))
    assert ":1: not text (UTF-8)" in refused(log(b"\x89MCAP0\r\n" + bytes(range(256))))
    assert ":1: not JSON" in refused(log(HEADER[:50].encode()))
    assert ":1: the log holds no events" in refused(log(HEADER))
    assert ":2: the log holds no events" in refused(log(HEADER, '{"t":0,"truth":{}}'))


def test_late_events_keep_the_order_of_the_file(log):
    times = (0.0, 0.5, 0.02, 0.02, 0.6, -0.3)
    run = read_log(log(HEADER, *(f'{{"t":{t},"pad":1,"s_m":0.02}}' for t in times)))
    assert tuple(event.t_sample for event in run.events) == times
    assert "time goes back by 1.2 s" in refused(
        log(HEADER, *(f'{{"t":{t},"pad":1,"s_m":0.02}}' for t in (0, 1.5, 1, 0.3)))
    )


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150, deadline=None)
@given(st.binary(max_size=300), st.integers(0, 200), st.integers(0, 50))
def test_any_bytes_are_read_or_rejected(tmp_path, noise, start, length):
    data = f"{HEADER}\n{PAD}\n{PALMS}\n".encode()
    path = tmp_path / "run.jsonl"
    for spoilt in (noise, data[:start] + noise + data[start + length :]):
        path.write_bytes(spoilt)
        with contextlib.suppress(LogError):
            assert all(math.isfinite(event.t_sample) for event in read_log(path).events)


finite = st.floats(-1e3, 1e3)
events = st.one_of(
    st.builds(PadSample, st.floats(0, 1), st.sampled_from([1, 2]), st.floats(1e-4, 0.055), st.none() | finite),
    st.builds(
        PalmSample,
        st.floats(0, 1),
        st.tuples(st.floats(0, 3), st.floats(0.1, 3)),
        *(st.none() | st.tuples(finite, finite),) * 2,
    ),
)
sensors = st.builds(
    PadSensor,
    length=st.just(0.0555),
    noise=st.floats(1e-6, 1),
    force_resolution=st.floats(0, 1),
    curvature=st.floats(-20, 20),
)
rigs = st.builds(
    RigDescription,
    gravity=st.floats(0.1, 20),
    hinge=st.sampled_from(["arc", "fixed"]),
    palm_angle_noise=st.floats(1e-6, 1),
    goal_rounding=st.floats(0, 1),
    pads=st.tuples(sensors, sensors),
    vibration=st.builds(
        Vibration,
        st.sampled_from(["independent", "in_phase", "antiphase", "unknown", "none"]),
        *(st.none() | st.floats(1e-3, 500),) * 4,
        *(st.none() | st.floats(0, 1),) * 2,
        st.sampled_from(["sign_pairs", "averaged"]),
    ),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50, deadline=None)
@given(rigs, st.lists(events, min_size=1, max_size=20), st.floats(0.05, 0.5))
def test_a_written_log_is_read_back_unchanged(tmp_path, rig, run, length):
    if rig.hinge == "arc":
        rig = replace(rig, palm1_length=length, base=(length, 0.0))
    assert event_line(PadLift(1.0, 1)) is None
    path = tmp_path / "run.jsonl"
    path.write_text("".join(map(line_text, [header_line(rig), *map(event_line, run)])), encoding="utf-8")
    read = read_log(path)
    assert read.rig == rig
    assert read.events == tuple(run)


def test_pads_that_differ_are_read_back_unchanged(log):
    one, two = PadSensor(), PadSensor(0.04, 3e-4, 2e-4, 0.1, 0.03, 0.05, 2e-4, 1e-3, 3e-4, 4e-5, 5e-3)
    rig = RigDescription(palm1_length=0.11, base=(0.11, 0.0), angle_sd=1e-3, pads=(one, two))
    header = header_line(rig)
    assert header["rig"]["pad"] == {"length_m": 0.04, "noise_m": 3e-4, "resolution_m": 2e-4}, "for older readers"
    assert read_log(log(json.dumps(header), PAD)).rig == rig
    alike = header_line(replace(rig, pads=(two, two)))
    assert "pads" not in alike["rig"]
    assert read_log(log(json.dumps(alike), PAD)).rig.pads == (two, two)


@pytest.mark.parametrize("pads", [{}, [{}], [{"length_m": 0.05}, 3], [{"length_m": 0.05}, {"length_m": 0.05}]])
def test_invalid_pads_are_rejected(described, pads):
    assert ":1: " in refused(described(pads=pads))


@pytest.mark.parametrize(("most_n", "saturated"), [(2.54, 6), (3.0, 0), (2.0, 0)])
def test_a_force_at_the_pads_last_count_is_a_lower_bound(log, most_n, saturated):
    forces = [min(0.5 * n, most_n) for n in range(1, 12)]
    lines = (f'{{"t":{0.01 * n},"pad":1,"s_m":0.02,"force_n":{force}}}' for n, force in enumerate(forces))
    clipped = [sample for sample in read_log(log(FIXED, *lines)).events if sample.at_least is not None]
    assert len(clipped) == saturated
    assert all(sample.force is None for sample in clipped)
