"""Which of a smoother's answers the loop's filters accept."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from improvements import improvement

from palmd.model import shape, shape_map
from palmd.model.smoothing import ORDER, RIG_CONSTANTS
from palmd.observer.coverage import NORMAL_BINS
from palmd.observer.filters.shape_map import smoother_outline
from palmd.observer.handover import Handover, SmoothedFilters, _turned, outline_sd
from palmd.system.description import RigDescription

N, SMOOTHED_N = shape_map.N, shape_map.size(ORDER)
OWN_SD = 1e-5  # of the bank's outlines (m)
SHAPE = slice(shape_map.Z.SHAPE, None)
TOUCHED = np.arange(NORMAL_BINS) < 20


def track(valid, left_open_m=None):
    """A leading bank; or an answer's filter alone, with the outline's uncertainty from the rig's constants."""
    bank = SimpleNamespace(
        n=N, size=2, x=np.zeros((2, N)), P=np.tile(OWN_SD**2 * np.eye(N), (2, 1, 1)), score=np.array([0.0, -3.0]),
        nis=np.ones(2), best=lambda: 0, lost=lambda: False,
    )  # fmt: skip
    forgetting = SimpleNamespace(prior_age_s=np.ones(2))
    history = SimpleNamespace(clear=lambda: None)
    size = shape.COEFFICIENTS if left_open_m is None else SMOOTHED_N - shape_map.Z.SHAPE
    outline = np.zeros(size), (OWN_SD**2 + (left_open_m or 0.0) ** 2) * np.eye(size)
    filters = SimpleNamespace(outline=lambda _: outline)
    smoothed = left_open_m is not None
    fusion = SimpleNamespace(
        bank=bank,
        filters=filters,
        uses_smoothed_filter=smoothed,
        includes_rig_uncertainty=smoothed,
        forgetting=forgetting,
        history=history,
    )
    return SimpleNamespace(fusion=fusion, valid=valid, coverage=SimpleNamespace(marks=TOUCHED))


def handover():
    filters = SimpleNamespace()
    return Handover(
        RigDescription(), SimpleNamespace(), SmoothedFilters(filters, filters), SimpleNamespace(candidate=None)
    )


def answered(sd, valid):
    """Whether an unconfirmed answer of this one-sigma (m) joins a bank, and the bank."""
    now, P = track(valid), sd**2 * np.eye(SMOOTHED_N)
    answer = improvement(np.zeros(SMOOTHED_N), P, established=False, touched=TOUCHED)
    return handover().hand_over(now, 1, answer, np.zeros(SMOOTHED_N), P, nis=1.0), now.fusion.bank


@pytest.mark.parametrize(("sd", "valid", "taken"), [(2e-5, True, False), (5e-6, True, True), (2e-5, False, True)])
def test_an_answer_less_certain_than_a_valid_bank_is_not_accepted(sd, valid, taken):
    took, bank = answered(sd, valid)
    assert took is taken
    assert (bank.score[1] > bank.score[0]) is np.bool_(taken)


@pytest.mark.parametrize(("frame", "taken"), [(1, True), (2, False)])
def test_later_answers_of_the_same_search_are_accepted_even_if_the_bank_is_more_certain(frame, taken):
    """It has used all of the bank's readings; another search may have used the latest only."""
    now, given = track(valid=True), handover()
    for sd, of_frame, joins in ((5e-6, 1, True), (2e-5, frame, taken)):
        P = sd**2 * np.eye(SMOOTHED_N)
        answer = improvement(np.zeros(SMOOTHED_N), P, established=False, touched=TOUCHED, frame=of_frame)
        assert given.hand_over(now, 1, answer, np.zeros(SMOOTHED_N), P, nis=1.0) is joins


@pytest.mark.parametrize(("left_open_m", "taken"), [(1.0e-4, True), (1.5e-4, False)])
def test_a_new_answer_with_less_uncertainty_of_the_rig_is_accepted(left_open_m, taken):
    """Given the rig's constants, its filter is less certain than one updated from an older answer."""
    now, P = track(valid=True, left_open_m=1.2e-4), (1.2 * OWN_SD) ** 2 * np.eye(SMOOTHED_N)
    spread = np.zeros((SMOOTHED_N + RIG_CONSTANTS, SMOOTHED_N))
    np.fill_diagonal(spread[SHAPE, SHAPE], left_open_m)
    answer = improvement(np.zeros(SMOOTHED_N), P, established=False, touched=TOUCHED, spread=spread)
    assert handover().hand_over(now, 1, answer, np.zeros(SMOOTHED_N), P, nis=1.0) is taken


def test_a_bank_uses_the_rigs_uncertainty_of_an_answer_before_it_is_established():
    """With its own harmonics; until then a circle's radius stands for all of it."""
    now, random = track(valid=False), np.random.default_rng(4)
    root = 2e-6 * random.standard_normal((SMOOTHED_N, SMOOTHED_N))
    P, spread = root @ root.T, random.standard_normal((SMOOTHED_N + RIG_CONSTANTS, RIG_CONSTANTS))
    answer = improvement(np.zeros(SMOOTHED_N), P, established=False, touched=TOUCHED, spread=spread)
    assert handover().hand_over(now, 1, answer, np.zeros(SMOOTHED_N), P, nis=1.0)
    provisional_spread = now.fusion.filters.provisional_spread
    assert provisional_spread.shape == (shape_map.N + RIG_CONSTANTS, RIG_CONSTANTS)
    moved = smoother_outline(spread[:SMOOTHED_N, 0], P)[0]
    np.testing.assert_allclose(provisional_spread[: shape_map.N, 0], moved)
    np.testing.assert_array_equal(provisional_spread[shape_map.N :], spread[SMOOTHED_N:])
    vague = replace(answer, P=900.0 * P)
    assert handover().hand_over(now, 1, vague, np.zeros(SMOOTHED_N), P, nis=1.0)
    assert now.fusion.filters.provisional_spread is None, "there is no sufficient outline yet"


def test_the_outlines_sd_is_taken_over_touched_normals_only():
    """Radius ± 10 µm and first cosine ± 20 µm are ± 22 µm at θ = 0, ± 10 µm at θ = π/2."""
    P = np.zeros((SMOOTHED_N, SMOOTHED_N))
    P[SHAPE.start, SHAPE.start], P[SHAPE.start + 1, SHAPE.start + 1] = 1e-5**2, 2e-5**2
    ahead, aside, nowhere = (np.arange(NORMAL_BINS) == bin_ for bin_ in (0, NORMAL_BINS // 4, -1))
    sds = [outline_sd(improvement(np.zeros(SMOOTHED_N), P, touched=touched)) for touched in (ahead, aside, nowhere)]
    np.testing.assert_allclose(sds, [22.3e-6, 10.0e-6, np.inf], rtol=0.02)


def test_changing_the_gauge_turns_the_outline_and_keeps_the_rigs_constants():
    random = np.random.default_rng(1)
    x, spread = random.standard_normal(SMOOTHED_N), random.standard_normal((SMOOTHED_N + RIG_CONSTANTS, RIG_CONSTANTS))
    moved, _, turned = _turned(x, np.eye(SMOOTHED_N), spread, 0.3)
    assert moved[shape_map.Z.PSI] == x[shape_map.Z.PSI] + 0.3
    assert np.array_equal(turned[SMOOTHED_N:], spread[SMOOTHED_N:])
    at = slice(shape_map.Z.SHAPE, SMOOTHED_N)
    theta = np.linspace(0.0, 6.0, 50)
    assert np.allclose(shape.basis(theta + 0.3, ORDER) @ spread[at], shape.basis(theta, ORDER) @ turned[at])
