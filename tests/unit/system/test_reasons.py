"""Reasons have stable codes for programs."""

import pytest

from palmd.observer.pivot.reconstruct import ONE_SIDE
from palmd.observer.three_palms.reconstruct import UNCONFIRMED
from palmd.observer.validity import CODES as TWO_PALMS
from palmd.system.reasons import CODES, MEANINGS, code_of


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("nothing touches palm 1, 3", "untouched"),
        ("the outline's standard deviation is 0.12 mm; 0.05 mm is accepted", "not-sharp"),
        ("what no version said 3 times", "other"),
        ("", ""),
    ],
)
def test_a_reasons_code_leaves_out_its_values(words, code):
    assert code_of(words) == code


def test_every_code_has_a_meaning_and_the_observers_reasons_are_in_the_table():
    assert set(CODES.values()) | set(TWO_PALMS) <= set(MEANINGS)
    assert {ONE_SIDE, UNCONFIRMED} <= set(CODES)
