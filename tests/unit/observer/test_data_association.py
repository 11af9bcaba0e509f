"""Contact-mode segments are associated with sides and corners of an outline, and unambiguous ones are certain."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palmd.observer import data_association
from palmd.observer.data_association import Association, AssociationSearch, ModeEstimate, associated, certain
from palmd.observer.mode_model import SegmentReadings, SupportFrame
from palmd.observer.mode_segments import ModeSegment
from palmd.observer.rounded_polygon import (
    discs,
    mode_parameters,
    normal_violation,
    regular,
    side_normals,
    support,
    turned,
)

# Tour on five corners: side, opposite corner and palm, each reached by a tip or a stay.
TOUR = [(0, 4, 0), (0, 3, 0), (3, 0, 1), (3, 1, 1), (1, 4, 0), (1, 0, 0), (4, 1, 1), (4, 2, 1), (2, 0, 0), (2, 1, 0)]


def pentagon():
    """An irregular pentagon."""
    p = regular(5, 15e-3, 2e-3)
    return p + 1e-3 * np.random.default_rng(5).normal(size=len(p)) * np.repeat([1.0, 1.0, 0.1], 5)


def mode_estimates(p, tour):
    """Mode estimates of segments, with openings in the middle of the corner's range."""
    found, t = [], 0.0
    normals, count = side_normals(p), len(p) // 3
    for i, (side, corner, palm) in enumerate(tour):
        first, last = (math.remainder(normals[(corner + by) % count] - normals[side], math.tau) for by in (-1, 0))
        middle = math.pi - abs(first + math.remainder(last - first, math.tau) / 2)
        stays = i > 0 and tour[i - 1][0] == side
        start = t + (0.03 if stays else 0.3)
        t = start + 2.0
        value = mode_parameters(p, np.array([side]), np.array([corner]), [palm])[0]
        value = value + 1e-5 * np.random.default_rng(i).normal(size=4)
        segment = ModeSegment(palm, start, t, value[:2], 1e-10 * np.eye(2), excludes_disc=True)
        opening = np.array([[middle - 0.1, 0.0, 0.0], [middle + 0.1, 0.0, 0.0]])
        two = np.zeros(2)
        carried = SupportFrame(np.zeros((2, 2)), two, two, opening)
        lying = SegmentReadings(segment, two, two, two, np.array([True, False]), carried)
        found.append(ModeEstimate(value, np.diag(1.0 / np.array([3e-5, 5e-5, 1.5e-4, 1e-4])), lying))
    return found


def test_a_sides_two_corners_have_equal_height_and_support_matches_its_rows():
    p = pentagon()
    (centres, radii), normals = discs(p), side_normals(p)
    for side in range(5):
        reach = (centres * np.exp(-1j * normals[side])).real + radii
        assert reach[side] == pytest.approx(reach[(side + 1) % 5], abs=1e-12)
        assert reach[side] == pytest.approx(reach.max(), abs=1e-12)
        assert support(p, normals[side : side + 1])[0][0] == pytest.approx(reach.max(), abs=1e-12)
    theta = np.linspace(0.0, 6.0, 50)
    h, slope, rows = support(p, theta)
    assert rows @ p == pytest.approx(h)
    assert slope == pytest.approx((support(p, theta + 1e-7)[0] - support(p, theta - 1e-7)[0]) / 2e-7, abs=1e-5)
    assert support(turned(p, 0.3), theta + 0.3)[0] == pytest.approx(h)


def test_normal_violation_is_the_distance_to_the_corners_range():
    p, openings = regular(4, 10e-3, 1e-3), np.array([[0.6 * math.pi, 0.7 * math.pi]])
    side, palm = np.array([0]), np.array([0])
    assert not normal_violation(
        p, side, np.array([0]), palm, openings
    ).any()  # 54 to 72° from the side: within its range
    assert np.abs(normal_violation(p, side, np.array([3]), palm, openings)).max() == pytest.approx(0.2 * math.pi)


def test_all_segments_are_associated_and_the_number_of_corners_is_found(monkeypatch):
    monkeypatch.setattr(data_association, "CORNERS", (4, 5, 6))  # others take long
    p = pentagon()
    rivals = associated(mode_estimates(p, TOUR), 30.0)
    best = rivals[0]
    assert best.count == 5
    assert best.used.all()
    assert [(side, corner) for side, corner in zip(best.sides, best.corners, strict=True)] == [
        each[:2] for each in TOUR
    ]
    assert np.abs(best.p - turned(p, -float(np.angle(discs(p)[0][0])))).max() < 1e-4
    assert certain(rivals, np.full(len(TOUR), 2.0)).all()


def test_a_segment_that_fits_no_outline_is_left_out():
    found = mode_estimates(pentagon(), TOUR)
    wrong = replace(found[4], value=found[4].value + np.array([3e-3, 0.0, 0.0, 2e-3]))
    best = AssociationSearch([*found[:4], wrong, *found[5:]], 5).best(math.inf)[0]
    assert np.flatnonzero(best.used == 0).tolist() == [4]


def test_an_association_that_a_rival_contradicts_is_not_certain():
    p = pentagon()
    sides, corners, ones = (np.array(each) for each in ([0, 0, 3, 1], [4, 3, 0, 3], [1, 1, 1, 1]))
    best = Association(p, sides, corners, ones, 10.0)
    other = Association(p, np.array([0, 0, 3, 2]), np.array([4, 3, 0, 0]), ones, 12.0)
    assert certain([best, other], np.array([3.0, 3.0, 2.0, 2.0])).tolist() == [1, 1, 1, 0]
    assert certain([best, replace(other, used=np.array([1, 1, 1, 0]))], np.full(4, 2.0)).all()
    assert certain([best, replace(best, corners=np.array([4, 3, 1, 3]))], np.full(4, 2.0)).tolist() == [1, 1, 0, 1]
    unused = replace(best, used=np.array([0, 0, 1, 1]))  # none of its segments has the side of the longest
    assert not certain([best, unused], np.array([3.0, 3.0, 2.0, 2.0])).any()
