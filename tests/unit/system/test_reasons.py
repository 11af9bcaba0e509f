"""Reasons have codes that programs may rely on."""

import pytest

from palmd.observer.pivot.reconstruct import ONE_SIDE
from palmd.observer.three_palms.reconstruct import UNCONFIRMED
from palmd.system.reasons import COMMON, PIVOT, THREE_PALMS, code_of


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("nothing touches palm 1, 3", "nothing-touches-palm"),
        (
            "the outline's standard deviation is 0.12 mm; 0.05 mm is accepted",
            "the-outline-s-standard-deviation-is-mm-mm-is-accepted",
        ),
        ("what an older version said 3 times", "what-an-older-version-said-times"),
        ("", ""),
    ],
)
def test_a_reason_has_a_code_without_its_values(words, code):
    assert code_of(words) == code


def test_codes_are_unique_and_the_observers_reasons_are_in_the_tables():
    rows = (*COMMON, *PIVOT, *THREE_PALMS)
    assert len({code for code, _ in rows}) == len({words for _, words in rows}) == len(rows)
    assert {ONE_SIDE, UNCONFIRMED} <= {words for _, words in rows}
