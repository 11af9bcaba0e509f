"""Contact-mode segments on different sides are joined by shared corners and by the readings in between."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from palmd.events import Event, FloatArray, PadSample, PalmSample
from palmd.model import sharp
from palmd.model.sharp import LENGTHS, NORMALS, WIDTH
from palmd.model.smoothing import C
from palmd.observer.data_segment import longest_segment
from palmd.observer.factor import Prior
from palmd.observer.flat_side_search import FlatSideSearch, _neighbours, _split_where_uncertain
from palmd.observer.mode_initialisation import palm_turn, rotated
from palmd.observer.mode_segments import ModeSegment, combined_corner, find_mode_segments, group_by_mode
from palmd.observer.normal_equations import Guess, Residuals
from palmd.observer.outline import directions, normal_angles, touched_by, touched_within
from palmd.observer.palm_path import smoothed_path
from palmd.observer.record import Record, lay_out
from palmd.observer.search import Search
from palmd.observer.side_alignment import (
    SideContact,
    bridged,
    candidate_turns,
    initial_outline,
    moved_to_outline,
    side_between,
    side_contact,
    slope_of,
    supporting_palm,
    updated_contact,
)
from palmd.observer.side_merging import Part, SideMerger
from palmd.score import score_outline
from palmd.system.description import RigDescription
from palmd.system.mechanism import normal_directions

# a polygon lies on palm 2 with one side, tips over both corners, and lies on palm 1 with the next side
LOWER = SideContact(1, -2.3527, 17.21e-3, 0.0, 13.47e-3 - 11.30e-3j, 2.97e-3, (-1.08, -0.70))
UPPER = SideContact(0, -1.2653, 17.85e-3, 0.0, -15.57e-3 - 4.51e-3j, 3.00e-3, (-3.02, -2.67))
POSES = [(0.0, 47.0, 94.0), (0.8, 45.0, 89.0), (1.8, 25.0, 89.0), (2.8, 25.0, 104.7), (3.2, 25.0, 104.7),
         (4.3, 34.0, 87.6), (4.8, 34.0, 90.0), (5.5, 34.5, 95.0), (6.6, 58.0, 97.0)]  # fmt: skip
END = 6.4  # s
RIG = RigDescription(hinge="fixed")
NOISE_M = 1e-4


def pose(t: FloatArray) -> FloatArray:
    """φ1, φ2 (rad) on minimum-jerk moves between the `POSES` (s, deg)."""
    knots = np.array(POSES)
    i = np.clip(np.searchsorted(knots[:, 0], t, side="right") - 1, 0, len(knots) - 2)
    u = np.clip((t - knots[i, 0]) / (knots[i + 1, 0] - knots[i, 0]), 0.0, 1.0)
    along = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    way: FloatArray = np.radians(knots[i, 1:] + (knots[i + 1, 1:] - knots[i, 1:]) * along[..., None])
    return way


def palms() -> list[PalmSample]:
    t, step = np.arange(0.0, END, 0.016), 1e-4
    before, now, after = (pose(t + by) for by in (-step, 0.0, step))
    rates, bends = (after - before) / (2 * step), (after - 2 * now + before) / step**2
    return [
        PalmSample(float(a), *(tuple(each.tolist()) for each in rest))
        for a, *rest in zip(t, now, rates, bends, strict=True)
    ]


def constants() -> FloatArray:
    p = np.zeros(sharp.CONSTANTS)
    p[C.SHAPE], p[C.LN_RHO], p[C.DRAG], p[C.SATURATION] = 0.017, math.log(0.0129), 10.0, 2500.0
    p[NORMALS:LENGTHS] = LOWER.normal, UPPER.normal, 2.0, 3.0
    p[LENGTHS : LENGTHS + 2], p[WIDTH] = 0.018, math.log(5e-4)
    return initial_outline(p, [UPPER, LOWER], Prior(p, np.full(len(p), 5e-3), 1.0), 2)


class Tipped:
    """A tipped polygon's readings; its motion follows the smoother's model."""

    def __init__(self) -> None:
        random = np.random.default_rng(3)
        self.p = constants()
        t = np.sort(random.uniform(0.0, END - 0.02, 900))
        silent = [PadSample(float(at), 1 + k % 2, 0.0, None) for k, at in enumerate(t)]
        self.record = lay_out(silent, smoothed_path(palms(), 2e-4), RIG, 0.0, END - 0.02, 0.001)
        first = normal_directions(tuple(self.record.palms[0, :2]), 0.0)[1] - LOWER.normal
        residuals = Residuals(sharp.library_for(2), self.record)
        self.guess = residuals.completed(Guess(np.array([[first, 0.0]]), self.p))
        read = -residuals.residuals(self.guess) * np.sqrt(self.record.contact_variance)
        read += random.normal(0.0, NOISE_M, len(read))
        pads = [replace(sample, s=float(s)) for sample, s in zip(silent, read, strict=True)]
        both: list[Event] = [*palms(), *pads]
        self.events = sorted(both, key=lambda event: event.t_sample)
        self.search = Search(longest_segment(self.events), RIG)

    def gap(self, start: float, end: float) -> tuple[Record, FloatArray]:
        """A record of readings from `start` to `end` (s), and ψ at its nodes."""
        record = FlatSideSearch(self.search).record.within([(start, end)])
        return record, np.interp(record.t, self.record.t, self.guess.x[:, 0])


@pytest.fixture(scope="module")
def tipped() -> Tipped:
    return Tipped()


def test_contacts_whose_corners_end_each_others_sides_have_one_rotation():
    (turn,) = candidate_turns(LOWER, UPPER)
    assert turn == pytest.approx(0.0, abs=0.01)
    (again,) = candidate_turns(LOWER.turned(0.4), UPPER.turned(-0.3))
    assert again == pytest.approx(turn + 0.7, abs=1e-9)
    assert candidate_turns(LOWER, replace(UPPER, height=UPPER.height + 5e-4)) == []


def test_a_shared_corner_or_side_gives_one_rotation():
    next_side = replace(UPPER, normal=UPPER.normal - 0.8, height=UPPER.height + 5e-4).turned(0.2)
    assert candidate_turns(UPPER, next_side) == [pytest.approx(-0.2)]
    assert candidate_turns(UPPER, replace(next_side, radius=next_side.radius + 1e-3)) == []
    other_corner = replace(LOWER, corner=LOWER.corner * 0.93, radius=1e-3, palm=0)
    assert candidate_turns(LOWER, other_corner.turned(0.2)) == [pytest.approx(-0.2)]
    assert candidate_turns(LOWER, replace(other_corner, height=LOWER.height - 1e-3)) == []


def test_a_corner_beyond_a_side_is_excluded():
    at = 0.9 * cmath.exp(1j * LOWER.normal)
    inside = replace(LOWER, corner=at * (LOWER.height - LOWER.radius))
    beyond = replace(inside, corner=at * (LOWER.height + 2e-3))
    assert [len(candidate_turns(LOWER, each)) for each in (inside, beyond)] == [1, 0]


def test_the_initial_outline_passes_through_sides_and_corners():
    p = constants()
    for each, other in ((LOWER, UPPER), (UPPER, LOWER)):
        touched = np.linspace(*each.touched, 9)
        assert sharp.support(touched, p) == pytest.approx(
            (each.corner * np.exp(-1j * touched)).real + each.radius, abs=2e-5
        )
        assert sharp.support(np.array([each.normal]), p) == pytest.approx([each.height], abs=5e-5)
        away = math.copysign(9.0 * math.exp(p[WIDTH]), math.remainder(other.touched[0] - each.normal, math.tau))
        end = np.array([each.normal + away])
        assert slope_of(end, p) == pytest.approx((other.corner * np.exp(-1j * end)).imag, abs=2e-4)


def test_contacts_stay_in_place_on_a_side_of_another_width(tipped):
    record, psi = tipped.gap(0.5, 2.0)
    other = tipped.p.copy()
    other[WIDTH] += 0.7
    x = np.stack([psi, np.gradient(psi, record.t)], axis=1)
    moved = moved_to_outline(record, x, tipped.p, other, [LOWER.normal])
    before, after = (normal_angles(record.palms, each[:, 0])[:, 1] for each in (x, moved))
    assert slope_of(after, other) == pytest.approx(slope_of(before, tipped.p), abs=2e-5)
    assert 1e-5 < np.abs(after - before).max() < 5e-3
    assert supporting_palm(record, Guess(moved, other), 50, 2) == 1


def test_readings_between_two_segments_lead_from_one_to_the_other(tipped):
    gap, psi = tipped.gap(2.4, 4.6)
    before, after = (palm_turn(gap, palm)[:, 0] for palm in (1, 0))
    ways = psi[0] + before, psi[-1] + after - after[-1]
    found = bridged(gap, tipped.p, *ways)
    assert found is not None
    assert np.abs(found - psi).max() < 0.08  # in the impact; elsewhere the grid's steps
    assert np.median(np.abs(found - psi)) < 5e-3
    once_round = bridged(gap, tipped.p, ways[0], ways[1] + math.tau)
    assert once_round == pytest.approx(found)
    assert bridged(gap, tipped.p, ways[0], ways[1] + 0.1) is None
    stray = np.where(np.arange(len(gap.contact_value)) % 5 == 0, 4e-3, 0.0)
    assert bridged(replace(gap, contact_value=gap.contact_value + stray), tipped.p, *ways) is None
    assert bridged(gap, rotated(Guess(np.zeros((1, 2)), tipped.p), 0.1).p, *ways) is None


@pytest.fixture(scope="module")
def parts(tipped) -> tuple[SideMerger, Part, Part]:
    search = FlatSideSearch(tipped.search)
    groups = [
        segments
        for segments in group_by_mode(find_mode_segments(search.record))
        if any(segment.excludes_disc for segment in segments)
    ]
    assert _neighbours(groups) == {0, 1}
    one, other = (Part.of(search.fits.on_one_side(segments)[0], segments) for segments in groups[:2])
    return SideMerger(search.fits), one, other


def band(search, both):
    """One-sigma (m) of the outline in each of `directions`."""
    p, step = both.fit.guess.p, 1e-6
    covariance = FlatSideSearch(search).fits.posterior(both).covariance[: len(p), : len(p)]
    ends = [[sharp.support(directions(), p + side * d) for side in (1, -1)] for d in step * np.eye(len(p))]
    rows = np.array([after - before for after, before in ends]) / (2 * step)
    return np.sqrt(np.einsum("in,ij,jn->n", rows, covariance, rows))


def test_segments_on_two_sides_are_joined_to_one_outline(tipped, parts):
    sides, one, other = parts
    both = sides.merged([other, one])
    assert both is not None
    assert len(both.sides) == 2
    record, guess = both.record, both.fit.guess
    assert both.fit.chi2 < 1.15
    touched = touched_within(record, guess.x[:, 0])
    assert touched.sum() > 35  # degrees
    estimated, true = (sharp.support(directions(), p) for p in (guess.p, tipped.p))
    error = score_outline(directions(), estimated, touched, true).e_h
    assert error < 1e-4
    assert error < 3 * band(tipped.search, both)[touched.astype(bool)].mean()
    turned = np.diff(guess.p[NORMALS : NORMALS + 2])[0]
    assert abs(turned) == pytest.approx(UPPER.normal - LOWER.normal, abs=5e-3)


def test_segments_without_a_connecting_motion_are_not_joined(parts, monkeypatch):
    sides, one, other = parts
    for each in ("bridged", "followed_motion"):
        monkeypatch.setattr(f"palmd.observer.side_merging.{each}", lambda *_: None)
    assert sides.merged([one, other]) is None


def test_an_inaccurate_connecting_motion_is_left_out_of_the_fit(parts, monkeypatch):
    sides, one, other = parts
    monkeypatch.setattr("palmd.observer.side_merging.bridged", lambda *_: None)
    both = sides.merged([one, other])
    assert len(both.sides) == 2
    assert len(both.record.gap_steps) == 1
    assert both.fit.chi2 < 1.15


def test_no_motion_is_connected_over_a_lost_contact(tipped, monkeypatch):
    segment, tried = tipped.search.segment, list[int]()
    monkeypatch.setattr("palmd.observer.side_merging.bridged", lambda *_: tried.append(1))
    first, second = (Search(each, RIG) for each in (segment.until(3.0), segment.since(3.3)))
    for search, ways in ((FlatSideSearch(tipped.search), 1), (FlatSideSearch(first, 0, [second]), 0)):
        record = search.record.within([(0.5, 2.4), (4.6, 6.0)])
        guess = Guess(np.zeros((len(record.t), 2)), tipped.p)
        assert list(SideMerger(search.fits).bridges(record, guess, 2, record.spans[:1])) == []
        assert len(tried) == ways
        tried.clear()


@pytest.mark.parametrize(("explaining", "joined"), [(0, False), (1, True), (2, False)])
def test_parts_are_joined_only_if_exactly_one_rotation_explains_both(tipped, monkeypatch, explaining, joined):
    sides = SideMerger(FlatSideSearch(tipped.search).fits)
    whole = Part(None, (LOWER,))  # type: ignore[arg-type]
    monkeypatch.setattr("palmd.observer.side_merging.candidate_turns", lambda *_: [0.1, 0.105, 0.5, 0.9])
    monkeypatch.setattr(sides, "merged_with_turn", lambda one, _, turn: one if turn < 0.4 * explaining else None)
    assert (sides.merged_pair(whole, whole) is whole) is joined


def test_only_normals_touched_within_the_parts_count(tipped):
    record = FlatSideSearch(tipped.search).record
    torn = record.within([(0.5, 2.0), (5.0, 7.0)])
    psi = np.interp(torn.t, tipped.record.t, tipped.guess.x[:, 0])
    parts = [record.within([span]) for span in torn.spans]
    alone = [touched_by(normal_angles(part.palms, np.interp(part.t, torn.t, psi))[1:-1]) for part in parts]
    assert np.array_equal(touched_within(torn, psi), np.logical_or(*alone))
    assert touched_within(torn, psi).sum() < touched_by(normal_angles(torn.palms, psi)).sum() - 10


def test_a_side_contact_follows_from_an_outline(tipped):
    record, psi = tipped.gap(4.6, 7.5)
    p = tipped.p.copy()
    p[[NORMALS, NORMALS + 1]], p[[LENGTHS, LENGTHS + 1]] = p[[NORMALS + 1, NORMALS]], p[[LENGTHS + 1, LENGTHS]]
    contact = side_contact(record, Guess(np.stack([psi, np.zeros_like(psi)], axis=1), p), 0)
    assert contact.normal == pytest.approx(UPPER.normal)
    assert abs(contact.corner - UPPER.corner) < 1e-4
    assert (contact.height, contact.radius) == pytest.approx((UPPER.height, UPPER.radius), abs=1e-4)


def test_a_side_lies_between_two_corners_touched_in_succession():
    """Corners of 3 mm at 16 mm from the middle, at ± 30° from the side between them."""
    high = 16e-3 * math.cos(math.pi / 6) + 3e-3
    segment = ModeSegment(1, 0.0, 2.0, np.array([0.018, 0.003]), 1e-10 * np.eye(2), True)
    corners = [
        (2.0 - math.pi / 6, (1.2, 1.9), segment),
        (2.0 + math.pi / 6, (2.1, 2.8), replace(segment, start=2.03, end=3.0)),
    ]
    first, last = (
        SideContact(1, -0.2, high, 0.0, cmath.rect(16e-3, at), 3e-3, touched_range, (mine,))
        for at, touched_range, mine in corners
    )
    assert first.stays_with(last)
    assert last.stays_with(first)
    assert not first.stays_with(replace(last, palm=0))
    assert not first.stays_with(replace(last, segments=(replace(segment, start=2.2, end=3.0),)))
    for side, corner in zip(side_between(first, last), (first, last), strict=True):
        assert (side.normal, side.height) == pytest.approx((2.0, high))
        assert (side.palm, side.corner, side.segments) == (0, corner.corner, ())
        assert corner.ends_side_of(side)


def test_a_side_contact_is_updated_from_a_better_outline(tipped):
    contact = updated_contact(
        tipped.p, 2, replace(UPPER, normal=UPPER.normal + 0.02, height=1e-2, corner=0j, radius=0.0)
    )
    assert contact.normal == pytest.approx(UPPER.normal)
    assert abs(contact.corner - UPPER.corner) < 1e-4
    assert (contact.height, contact.radius) == pytest.approx((UPPER.height, UPPER.radius), abs=1e-4)


def test_uncertain_segments_are_split_since_sides_may_be_similar():
    segment = ModeSegment(0, 0.0, 1.0, np.array([0.032, 0.002]), 1e-8 * np.eye(2), True)
    rough = [segment, replace(segment, start=9.0, end=10.0)]
    sharply = [replace(each, covariance=1e-10 * np.eye(2)) for each in rough]
    assert _split_where_uncertain([rough, sharply]) == [sharply, [rough[0]], [rough[1]]]


def test_segments_on_one_corner_are_combined_by_their_information():
    sharp_one, vague = np.diag([1e-10, 1e-8]), np.diag([1e-8, 1e-6])
    one = ModeSegment(0, 0.0, 1.0, np.array([0.016, 0.002]), sharp_one, True)
    combined = combined_corner([one, replace(one, corner=np.array([0.0171, 0.003]), covariance=vague)])
    assert combined == pytest.approx([0.016 + 0.0011 / 101, 0.002 + 0.001 / 101])


@pytest.mark.parametrize("explains", [True, False])
def test_a_segment_that_is_not_explained_as_a_whole_is_fitted_in_parts(tipped, monkeypatch, explains):
    segment = ModeSegment(0, 1.0, 14.5, np.array([0.016, 0.002]), 1e-10 * np.eye(2), True)
    search, asked = FlatSideSearch(tipped.search), list[tuple[float, float]]()
    found = SimpleNamespace(explains=explains)
    monkeypatch.setattr("palmd.observer.flat_side_search.find_mode_segments", lambda _: [segment])
    monkeypatch.setattr(
        search.fits, "on_one_side", lambda segments: asked.append((segments[0].start, segments[0].end)) or [found]
    )
    assert len(list(search.segment_fits())) == len(asked)
    assert asked == [(1.0, 14.5), *([] if explains else [(1.0, 7.0), (7.0, 13.0)])]
