"""`palmd estimate`: causal replay, its lines, its output files, what it refuses."""

import io
import json
import math
import subprocess
import sys

import numpy as np
import pytest

from palmd import observer
from palmd.cli import main
from palmd.events import Estimate, PadSample, ShapeEstimate
from palmd.quantities import ESTIMATE, SHAPE, STAMP
from palmd.record.eventlog import EventLog, read_log
from palmd.record.replay import replay, texts, tick_count, tick_fields
from palmd.rig.simulate import simulate_log
from palmd.system.description import RigDescription
from tools.studies.stub_observers import EmptyObserver

SECONDS = 3.0


def estimate_at(t, **changes):
    values = dict.fromkeys(Estimate.__dataclass_fields__, 0.5) | {"invalid_reasons": ()}
    values |= {"t": t, "valid": False, "observer": "spy", "object_count": 1, "sd": {"r1": math.nan}}
    return Estimate(**values | changes)


class Spy(EmptyObserver):
    """An observer that only records which events precede each estimate."""

    def __init__(self):
        self.fed = []
        self.seen = []

    def feed(self, event):
        self.fed.append(event)

    def estimate(self, t):
        self.seen.append((t, len(self.fed)))
        return estimate_at(t)

    def shape(self, t):
        theta = np.linspace(0.0, 6.0, 180)
        return ShapeEstimate(t, theta, theta, theta, theta > 1.0)


def run_of(*times):
    return EventLog(RigDescription(), tuple(PadSample(t, 1, 0.02) for t in times))


def test_each_tick_sees_the_events_up_to_its_time_and_no_others():
    spy = Spy()
    ticks = list(replay(run_of(5.0, 5.004, 5.01, 5.0101, 5.019, 5.035), spy))
    assert spy.seen == [(pytest.approx(t), n) for t, n in ((5.01, 3), (5.02, 5), (5.03, 5), (5.04, 6))]
    assert [tick.number for tick in ticks] == [1, 2, 3, 4]


def test_a_late_event_is_fed_at_its_arrival_not_at_its_timestamp():
    spy = Spy()
    run = run_of(0.0, 0.012, 0.003, 0.02)
    list(replay(run, spy))
    assert [n for _, n in spy.seen] == [1, 4]
    assert spy.fed == list(run.events)


@pytest.mark.parametrize(("times", "count"), [((3.0,), 1), ((0.0, 0.01), 1), ((0.0, 0.0100001), 2), ((0.0, 0.32), 32)])
def test_the_last_tick_has_seen_every_event(times, count):
    spy = Spy()
    assert len(list(replay(run_of(*times), spy))) == count == tick_count(run_of(*times))
    assert len(spy.fed) == len(times)


def test_a_shape_is_written_every_second():
    ticks = list(replay(run_of(0.0, 2.5), Spy()))
    assert [tick.t for tick in ticks if tick.shape is not None] == pytest.approx([1.0, 2.0])


def test_lines_hold_the_fields_of_the_contract():
    (tick,) = [tick for tick in replay(run_of(7.0, 8.0), Spy()) if tick.shape]
    estimate, shape = map(json.loads, texts(tick_fields(tick)))
    assert set(estimate) == {"t"} | {field.name for field in (*STAMP, *ESTIMATE.quantities)}
    assert estimate["t"] == estimate["timestamp"] == 8.0
    assert (estimate["mono_ns"], estimate["seq"], estimate["object"]) == (8_000_000_000, 100, 1)
    assert estimate["sd"] == {"r1_m": None}
    assert set(shape) == {"t", "shape"}
    assert set(shape["shape"]) == {field.name for field in SHAPE.quantities}
    assert len(shape["shape"]["touched"]) == 180
    assert not any("NaN" in line for line in texts(tick_fields(tick)))


def test_missing_values_are_null():
    run = run_of(0.0, 0.01)
    spy = Spy()
    spy.estimate = lambda t: estimate_at(t, r1=math.nan, nis=math.inf)
    ((text,),) = (list(texts(tick_fields(tick))) for tick in replay(run, spy))
    line = json.loads(text)
    assert line["r1_m"] is None
    assert line["nis"] is None
    assert line["r2_m"] == 0.5


# ---------------------------------------------------------------------------------------------- the command


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "run.jsonl"
    log, _ = simulate_log("nominal", 0, SECONDS)
    path.write_text("".join(json.dumps(line) + "\n" for line in log))
    return path


def read(path):
    ticks = [json.loads(line) for line in path.read_text().splitlines()]
    return [line for line in ticks if "shape" not in line], [line for line in ticks if "shape" in line]


def test_the_command_gives_the_same_estimates_as_the_daemons_observer(simulated, tmp_path):
    log = simulated
    out = tmp_path / "out.jsonl"
    assert main(["estimate", str(log), "-o", str(out), "--observer", "extended"]) == 0
    estimates, shapes = read(out)
    run = read_log(log)
    twin, waiting = observer.make("extended", run.rig), list(run.events)
    for number, line in enumerate(estimates, 1):
        t = number * 0.01
        assert line["t"] == pytest.approx(t, abs=1e-9)
        while waiting and waiting[0].t_sample <= t + 1e-9:
            twin.feed(waiting.pop(0))
        wanted = twin.estimate(t)
        assert line["valid"] is bool(wanted.valid)
        for name, value in (("r1_m", wanted.r1), ("omega0_rad_s", wanted.omega0), ("mass_kg", wanted.mass)):
            assert line[name] == (value if math.isfinite(value) else None)
    assert not waiting
    assert len(shapes) == int(SECONDS - 0.04)
    assert all(line["observer"] == "extended" for line in estimates)


def test_truth_in_the_log_changes_nothing(simulated, tmp_path):
    log = simulated
    spoilt = []
    for line in log.read_text().splitlines():
        event = json.loads(line)
        spoilt.append(line)
        if "t" in event:
            spoilt.append(json.dumps({"t": event["t"], "truth": {"r1_m": 0.5}, "pad": 1, "s_m": 0.05}))
    with_truth = tmp_path / "truth.jsonl"
    with_truth.write_text("\n".join(spoilt) + "\n")
    outs = tmp_path / "a.jsonl", tmp_path / "b.jsonl"
    for path, out in zip((log, with_truth), outs, strict=True):
        assert main(["estimate", str(path), "-o", str(out), "--observer", "extended"]) == 0
    assert outs[0].read_bytes() == outs[1].read_bytes()


@pytest.mark.parametrize(
    ("keep", "blind"),
    [
        (lambda event: event.get("pad") != 2, (0.0, SECONDS)),
        (lambda event: "palms" not in event, (0.0, SECONDS)),
        (lambda event: "pad" not in event, (0.0, SECONDS)),
        (lambda event: not 1.0 < event["t"] < 2.0, (1.15, 2.0)),
    ],
    ids=["one pad only", "no palms", "no pads", "a gap"],
)
def test_poor_logs_give_no_traceback_and_no_valid_estimate_while_blind(simulated, tmp_path, keep, blind):
    header, *events = simulated.read_text().splitlines()
    log, out = tmp_path / "poor.jsonl", tmp_path / "out.jsonl"
    log.write_text("\n".join([header, *(line for line in events if keep(json.loads(line)))]) + "\n")
    assert main(["estimate", str(log), "-o", str(out), "--observer", "extended"]) == 0
    valid = [line["valid"] for line in read(out)[0] if blind[0] < line["t"] < blind[1]]
    assert len(valid) > 50
    assert not any(valid)


def test_standard_output_and_notes(simulated, tmp_path, capsys):
    log = tmp_path / "cut.jsonl"
    log.write_bytes(simulated.read_bytes()[:20_000])
    assert main(["estimate", str(log), "-o", "-", "--observer", "extended"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out.splitlines()[0])["t"] == 0.01
    assert "is truncated" in err


def test_the_quasistatic_observer_reports_the_papers_error_terms(tmp_path):
    lines, _ = simulate_log("friction", 405, 4.0)
    log, out = tmp_path / "run.jsonl", tmp_path / "out.jsonl"
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert main(["estimate", str(log), "-o", str(out), "--observer", "quasistatic"]) == 0
    ticks = [json.loads(line) for line in out.read_text().splitlines()]
    last = [line for line in ticks if "valid" in line][-1]
    assert last["valid"]
    assert last["observer"] == "quasistatic"
    assert 0.0 < abs(last["e_f_m"]) < 5e-3
    assert 0.0 <= last["e_c_m"] < 1e-3
    assert last["nis"] is last["observability"] is None
    assert [line for line in ticks if "shape" in line]


def test_a_reader_that_closes_the_pipe_is_no_fault(simulated):
    command = [sys.executable, "-m", "palmd", "estimate", str(simulated), "-o", "-", "--observer", "extended"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 0


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_on_a_terminal_the_current_step_is_shown_before_progress_is_known(simulated, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    assert main(["estimate", str(simulated), "-o", str(tmp_path / "out.jsonl"), "--observer", "quasistatic"]) == 0
    said = [each.strip() for each in terminal.getvalue().replace("\x1b[K", "").split("\r") if each.strip()]
    assert said[:2] == [f"reading {simulated} ...", "preparing the quasistatic observer ..."]
