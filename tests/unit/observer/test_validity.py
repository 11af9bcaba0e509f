"""The rule for `valid`: each single piece of evidence can withhold it."""

import math

import pytest

from palmd.events import DECIDED
from palmd.observer.validity import (
    MOST_NIS,
    PREDICTABLE_AGE_S,
    PREDICTABLE_SD_M,
    RESUMED_FOR_S,
    SURE,
    Evidence,
    Thresholds,
    consistent,
    identified,
    predictable,
    reasons,
    settled,
)
from palmd.system.reasons import Code

LEAST = Thresholds(age_s=0.4, radius_sd_m=3e-4, disagreement_m=2e-4)
GOOD = Evidence(
    touching=True,
    palms_known=True,
    resumed_for_s=1.0,
    finite=True,
    consistent=True,
    age_s=1.0,
    radius_sd_m=1e-4,
    disagreement_m=1e-4,
    rig_known=True,
    explained=True,
)


def test_with_all_evidence_the_estimate_is_settled():
    assert settled(GOOD, LEAST)


@pytest.mark.parametrize(
    ("missing", "code"),
    [
        ({"touching": False}, Code.UNTOUCHED),
        ({"palms_known": False}, Code.NO_ARM_REPORTS),
        ({"resumed_for_s": RESUMED_FOR_S}, Code.JUST_TOUCHED),
        ({"finite": False}, Code.NOT_FINITE),
        ({"consistent": False}, Code.INCONSISTENT),
        ({"age_s": 0.4}, Code.TOO_YOUNG),
        ({"radius_sd_m": 3e-4}, Code.NOT_SHARP),
        ({"radius_sd_m": math.nan}, Code.NOT_SHARP),
        ({"disagreement_m": 2e-4}, Code.AMBIGUOUS),
        ({"disagreement_m": math.nan}, Code.AMBIGUOUS),
        ({"rig_known": False}, Code.RIG_UNKNOWN),
        ({"explained": False}, Code.UNEXPLAINED),
    ],
)
def test_without_any_single_piece_of_evidence_it_is_not_settled(missing, code):
    evidence = GOOD._replace(**missing)
    assert not settled(evidence, LEAST)
    assert reasons(evidence, LEAST) == (code,)


def test_with_all_evidence_only_convexity_or_identity_can_be_missing():
    assert reasons(GOOD, LEAST) == (Code.NOT_SETTLED,)


def test_the_nis_has_an_upper_limit():
    assert consistent(1.0)
    assert consistent(0.1)
    assert not any(consistent(nis) for nis in (MOST_NIS, 3.0, math.nan))


def test_an_object_is_identified_with_hysteresis():
    between = (SURE + DECIDED) / 2
    assert identified(SURE, before=False)
    assert not identified(between, before=False)
    assert identified(between, before=True)
    assert not identified(DECIDED - 1e-3, before=True)


def test_an_unsettled_estimate_may_predict_motion():
    sharp, old = 0.9 * PREDICTABLE_SD_M, 1.1 * PREDICTABLE_AGE_S
    assert predictable(finite=True, read_lately=True, age_s=old, radius_sd_m=sharp)
    assert not predictable(finite=False, read_lately=True, age_s=old, radius_sd_m=sharp)
    assert not predictable(finite=True, read_lately=False, age_s=old, radius_sd_m=sharp)
    assert not predictable(finite=True, read_lately=True, age_s=PREDICTABLE_AGE_S, radius_sd_m=sharp)
    assert not predictable(finite=True, read_lately=True, age_s=old, radius_sd_m=PREDICTABLE_SD_M)
