"""The fault table and its monitor."""

import re
from pathlib import Path

import pytest

from palmd.faults import FAULTS, TABLE, FaultMonitor, Severity


def codes(monitor: FaultMonitor) -> list[str]:
    return [fault.code for fault in monitor.active]


def test_the_table_is_consistent():
    assert len(TABLE) == len(FAULTS)
    for fault in FAULTS:
        assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", fault.code)
        assert fault.text
        assert fault.hint
        assert "\n" not in fault.text + fault.hint
        assert fault.debounce_s >= 0.0


def test_only_faults_without_a_latch_are_said_to_clear_themselves():
    for fault in FAULTS:
        assert (fault.latch == "no") == (fault.clears == "itself"), fault.code


def test_every_stop_fault_stays_after_it_has_stopped_the_arm():
    assert all(fault.latch != "no" for fault in FAULTS if fault.severity is Severity.STOP)


def test_the_table_agrees_with_the_manual():
    """Severity, debounce, latch and clearing: written twice so that an accidental change is noticed."""
    said = {}
    page = Path(__file__).parents[2] / "docs/reference/faults.md"
    for line in page.read_text("utf-8").splitlines():
        if line.startswith("| `"):
            code, severity, *_, after, latch, clears = (cell.strip(" `") for cell in line.strip("|").split("|"))
            said[code] = (severity, float(after.removesuffix(" s")), latch, clears)
    assert said == {f.code: (str(f.severity), f.debounce_s, f.latch, f.clears) for f in FAULTS}


def test_a_fault_lasts_as_long_as_its_condition():
    monitor = FaultMonitor()
    assert monitor.update({"pad1-port"}, 0.0, armed=False)
    assert codes(monitor) == ["pad1-port"]
    assert monitor.update(set(), 0.1, armed=False)
    assert codes(monitor) == []


def test_debouncing_needs_an_unbroken_condition():
    monitor = FaultMonitor()
    debounce = TABLE["pad1-lifted"].debounce_s
    assert debounce > 0.02
    monitor.update({"pad1-lifted"}, 0.0, armed=False)
    monitor.update(set(), 0.02, armed=False)
    monitor.update({"pad1-lifted"}, 0.03, armed=False)
    monitor.update({"pad1-lifted"}, debounce + 0.01, armed=False)
    assert codes(monitor) == []
    monitor.update({"pad1-lifted"}, 0.03 + debounce, armed=False)
    assert codes(monitor) == ["pad1-lifted"]


@pytest.mark.parametrize(
    ("code", "armed", "stays"),
    [
        ("pad1-port", True, False),
        ("arm-power-off", False, False),
        ("arm-power-off", True, True),
        ("arm-estop", False, True),
    ],
)
def test_latching(code, armed, stays):
    monitor = FaultMonitor()
    monitor.update({code}, 0.0, armed=armed)
    monitor.update(set(), 1.0, armed=False)
    assert codes(monitor) == ([code] if stays else [])


def test_reset_clears_only_faults_whose_cause_has_ended():
    monitor = FaultMonitor()
    monitor.update({"arm-estop", "tick-error"}, 0.0, armed=True)
    monitor.update({"arm-estop"}, 0.1, armed=True)
    assert monitor.latched(Severity.STOP)
    assert monitor.reset()
    assert codes(monitor) == ["arm-estop"]
    monitor.update(set(), 0.2, armed=False)
    assert codes(monitor) == ["arm-estop"]
    assert monitor.reset()
    assert codes(monitor) == []
    assert not monitor.latched(Severity.STOP)


def test_active_faults_keep_the_tables_order_and_object_while_nothing_changes():
    monitor = FaultMonitor()
    monitor.update({"vm-backend", "arm-estop", "pad2-port"}, 0.0, armed=False)
    assert codes(monitor) == ["arm-estop", "pad2-port", "vm-backend"]
    before = monitor.active
    assert not monitor.update({"vm-backend", "arm-estop", "pad2-port"}, 0.1, armed=False)
    assert monitor.active is before
    assert [fault.code for fault in monitor.standing(Severity.HOLD)] == ["pad2-port"]


def test_an_unknown_code_is_an_error():
    with pytest.raises(KeyError):
        FaultMonitor().update({"no-such-fault"}, 0.0, armed=False)


def test_a_certain_condition_needs_no_debounce():
    monitor = FaultMonitor()
    monitor.update({"pad1-lifted", "pad2-lifted"}, 0.0, armed=True)
    assert monitor.active == ()
    monitor.update({"pad1-lifted", "pad2-lifted"}, 0.01, armed=True, certain={"pad1-lifted", "pad2-lifted"})
    assert [fault.code for fault in monitor.active] == ["pad1-lifted", "pad2-lifted"]
