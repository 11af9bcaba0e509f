"""Reasons have stable codes for programs."""

import pickle

import pytest

from palmd.console.shipped import shipped
from palmd.daemon.systems import live_system
from palmd.messages import invalid_reasons
from palmd.system.reasons import NO_REASON, Code, Reason
from palmd.yamlfile import load_any_config
from tools.studies.stub_observers import EmptyObserver


class Silent(EmptyObserver):
    name, object_count, late_dropped = "silent", 0, 0


def test_a_code_is_its_text_and_has_a_meaning():
    assert Code("no-force") is Code.NO_FORCE is pickle.loads(pickle.dumps(Code.NO_FORCE))
    assert all(code == code.value == str(code) and code.meaning for code in Code)


@pytest.mark.parametrize("unknown", ["", "what-a-later-version-says"])
def test_an_unknown_code_is_read_as_the_generic_one(unknown):
    assert Code(unknown) is Code.OTHER


def test_a_reason_is_true_and_its_absence_false():
    assert Reason(Code.UNTOUCHED, "nothing touches the pad")
    assert not NO_REASON


def test_a_reason_crosses_a_process_with_its_code():
    reason = Reason(Code.UNTOUCHED, "nothing touches the pad")
    other = pickle.loads(pickle.dumps(reason))
    assert (other, other.code) == ("nothing touches the pad", Code.UNTOUCHED)


@pytest.mark.parametrize(
    ("configuration", "code"),
    [("demo.yaml", Code.NO_ANSWER), ("pivot.yaml", Code.OBSERVER_FAILED), ("three_palms.yaml", Code.OBSERVER_FAILED)],
)
def test_an_observer_that_failed_has_a_code(configuration, code):
    system = live_system(load_any_config(shipped(configuration)))
    assert invalid_reasons(system.invalid_estimate(1.0, Silent())) == [code]
