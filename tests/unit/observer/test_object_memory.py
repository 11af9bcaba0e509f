"""Memory of an object: orientations that match the readings, recognition, and recall of maps."""

from __future__ import annotations

import math
from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.model import shape, shape_map
from palmd.observer.coverage import NORMAL_BINS, Coverage
from palmd.observer.fixed_mode_test import FixedModeTest
from palmd.observer.hypotheses import Verdict
from palmd.observer.mass import MassEstimator, resting_forces
from palmd.observer.object_memory import DIRECTIONS, INFLATION, KnownObject, ObjectMemory
from palmd.observer.returning_object import ReturningObject
from palmd.system.description import PadSensor, RigDescription

Z = shape_map.Z
PALMS = PalmMotion.at_rest((0.75, 1.6))


def _known(sd: float = 2e-5, mass: float = 0.2) -> KnownObject:
    random = np.random.default_rng(8)
    x = np.zeros(shape_map.N)
    x[Z.SHAPE :] = random.standard_normal(shape.COEFFICIENTS) * shape.prior_sd(0.02)
    x[Z.SHAPE], x[Z.LN_RHO] = 0.02, math.log(0.014)
    weighed = MassEstimator((PadSensor(), PadSensor()))
    weighed.feed(1, mass * 5.0, 5.0)
    return KnownObject(x, np.eye(shape_map.N) * sd**2, Coverage().marks, weighed)


@pytest.mark.parametrize("psi", [0.3, 2.0, 4.4])
def test_orientations_that_match_the_readings_come_first(psi: float) -> None:
    known = _known()
    _, rows = shape.contact_rows(PALMS.angles[0] - psi, PALMS.angles[1])
    s1, s2 = rows @ known.x[Z.SHAPE :]
    chosen = known.orientations((s1, s2), PALMS, RigDescription(), 24)
    assert len(set(chosen)) == 24
    apart = np.abs(np.angle(np.exp(1j * (chosen[:, None] - chosen[None, :]))))
    assert apart[~np.eye(24, dtype=bool)].min() > 2.5 * 2 * math.pi / DIRECTIONS
    off = np.abs(np.angle(np.exp(1j * (chosen[:8] - psi))))
    assert off.min() < 1.5 * 2 * math.pi / DIRECTIONS


def test_outlines_match_within_their_uncertainty() -> None:
    known = _known()
    strayed = known.x.copy()
    sd = math.sqrt(known.prior_covariance()[-1, -1])
    assert sd > math.sqrt(INFLATION) * 2e-5
    strayed[-1] += 4 * sd
    assert known.matches_outline(strayed)
    strayed[-1] += 2 * sd
    assert not known.matches_outline(strayed)
    strayed = known.x.copy()
    strayed[[Z.PSI, Z.OMEGA0, Z.MU]] += 1.0
    assert known.matches_outline(strayed), "pose and motion are not part of the outline"


def test_objects_match_by_their_mass_at_rest() -> None:
    known = _known(mass=0.2)
    assert known.matches_mass(0.195)
    assert not known.matches_mass(0.23)
    assert known.matches_mass(math.nan)
    f1, f2 = resting_forces(9.81, np.array([0.7, 1.5]))
    # balance in world axes: f1 n1 + f2 n2 carries the weight
    n1, n2 = (-math.sin(0.7), math.cos(0.7)), (math.sin(2.2), -math.cos(2.2))
    assert f1 * n1[0] + f2 * n2[0] == pytest.approx(0.0, abs=1e-12)
    assert f1 * n1[1] + f2 * n2[1] == pytest.approx(9.81)


def test_the_second_last_map_is_recalled() -> None:
    memory, maps = ObjectMemory(), [_known(), _known(), _known()]
    assert memory.recall() is None
    assert memory.due(0.0)
    for t, known in enumerate(maps):
        memory.keep(float(t), known)
    assert memory.recall() is maps[1]
    assert not memory.due(2.4)
    assert memory.due(2.6)
    memory.forget()
    assert memory.recall() is None


def test_coverage_marks_turn_with_the_leaders_gauge() -> None:
    named = np.zeros(18)
    named[[5, 7]] = 0.8, 1.6  # φ1, φ2
    marks = Coverage()
    marks.mark(1.0, 0, named, lambda: np.zeros(2))
    before = marks.marks.copy()
    assert before.sum() == 2
    step = 2 * math.pi / NORMAL_BINS
    named[10] = 6 * step  # ψ of the other filter for the same pose
    marks.mark(2.0, 1, named, lambda: np.array([0.0, 6 * step]))
    assert marks.fraction == pytest.approx(2 / NORMAL_BINS)
    assert (marks.marks == np.roll(before, -6)).all()


def test_all_normals_between_two_ticks_are_marked_and_counted_as_a_share() -> None:
    named, marks, step = np.zeros(18), Coverage(), 2 * math.pi / NORMAL_BINS
    named[[5, 7]] = 0.8, 1.6
    for turned in (0, 0, 3, 3, -2):
        named[10] = turned * step
        marks.mark(1.0, 0, named, lambda: np.zeros(2))
        assert marks.fraction == np.count_nonzero(marks.marks) / NORMAL_BINS
    assert np.count_nonzero(marks.marks) == 2 * (3 + 1 + 2)
    marks.renumber(np.array([5]))  # the leader is gone, so that marks in its gauge are invalid
    marks.mark(2.0, 0, named, lambda: np.zeros(1))
    assert marks.fraction == np.count_nonzero(marks.marks) / NORMAL_BINS == 2 / NORMAL_BINS


def test_the_fixed_mode_test_is_restored_with_the_object() -> None:
    """Otherwise a confirmed object would have to roll again before it is valid."""
    rig, track = RigDescription(), MagicMock()
    before, hypotheses = FixedModeTest(rig), ReturningObject(rig, MagicMock())
    hypotheses.candidate = replace(_known(), flat_side_test=before)
    hypotheses.accept(track)
    assert track.flat_side_test is before


@pytest.mark.parametrize(
    ("prior_age_s", "age_s", "verdict"),
    [(0.0, 0.4, Verdict.OPEN), (0.0, 0.6, Verdict.REJECTED), (4.0, 0.6, Verdict.OPEN), (4.0, 3.1, Verdict.REJECTED)],
)
def test_a_bank_with_one_kind_of_filter_left_decides(prior_age_s: float, age_s: float, verdict: Verdict) -> None:
    """Pruning may leave only blind filters, or only such that started from the stored object."""
    hypotheses, track = ReturningObject(RigDescription(), MagicMock()), MagicMock()
    known = replace(_known(), spread=np.zeros((1, 1)))  # confirmed, but touched nowhere yet where it is touched now
    hypotheses.candidate, hypotheses._rough_mass = known, MagicMock(value=math.nan)
    fusion = track.fusion
    fusion.palms.at.return_value = np.array([0.7, 1.5])
    fusion.forgetting.prior_age_s = np.full(8, prior_age_s)
    fusion.bank.best.return_value, fusion.bank.score = 0, np.zeros(8)
    fusion.named.return_value, fusion.curvatures = np.zeros((8, 18)), (0.0, 0.0)
    fusion.filters.belief.return_value = known.x, known.P
    track.age.return_value = age_s
    assert hypotheses.decide(track, 1.0, settled=True) is verdict
