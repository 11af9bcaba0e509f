"""Rounds of motion that turn a sticking object, checked against an emulated disc on dry palms."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from palmd.config.two_palms import LimitsConfig
from palmd.events import PalmMotion
from palmd.motion.limits import MotionLimits
from palmd.motion.provocation import CLOSED, OPEN, ROUNDS, lean, provoke, rounds, slips
from palmd.motion.segments import Angles, Move
from palmd.rig.dry_plant import DRY, DryPlant
from palmd.rig.plant import Hinge
from palmd.rig.shapes import cylinder

LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
HOME: Angles = (math.radians(45.0), math.radians(90.0))
RADIUS_M = 0.02


def contacts(opening: float) -> tuple[float, float]:
    return (RADIUS_M / math.tan(opening / 2),) * 2


def test_leaning_to_a_palm_makes_the_other_slip_sooner_as_the_palms_open() -> None:
    opening = math.radians(90.0)
    assert not slips((math.radians(45.0), opening), 0, True)
    assert slips((math.radians(70.0), opening), 0, True)
    assert not slips((math.radians(70.0), opening), 1, True)
    assert slips((math.radians(20.0), opening), 1, True)
    assert 0.0 < lean(OPEN, True) < lean(CLOSED, True)


def test_the_corners_keep_the_contacts_on_the_pads_and_go_both_ways() -> None:
    corners = rounds(contacts(HOME[1]), HOME, LIMITS)
    assert len(corners) == 2 * 4 * ROUNDS
    assert corners[0][0] < corners[len(corners) // 2][0]  # leans to palm 1 first, and to palm 2 in the other direction
    assert sorted({opening for _, opening in corners}) == pytest.approx([CLOSED, OPEN])
    large = {opening for _, opening in rounds((0.05, 0.05), HOME, LIMITS)}
    assert min(large) > math.radians(95.0)


def test_without_room_nothing_moves() -> None:
    narrow = MotionLimits.from_config(LimitsConfig(phi1_deg=(44.0, 46.0)), pad_length=0.0555)
    assert provoke(HOME, rounds(contacts(HOME[1]), HOME, narrow), narrow) is None


def test_a_sticking_disc_is_turned_as_predicted_by_each_round_and_back() -> None:
    opening = HOME[1]
    here, move_on = HOME, 2.0 * (1.0 / math.tan(CLOSED / 2) - 1.0 / math.tan(OPEN / 2)) - (OPEN - CLOSED)
    plant = DryPlant(cylinder(RADIUS_M, 0.1), Hinge("fixed"), DRY)
    plant.place(PalmMotion.at_rest(HOME), psi=0.0)
    corners = rounds(contacts(opening), HOME, LIMITS)
    one_round, way = (*corners[:4], corners[0]), len(corners) // 2
    back = (*corners[way : way + 4], corners[way])
    turned = []
    for each in (one_round, back):
        psi = []
        for corner in each:
            move = provoke(here, (corner,), LIMITS)
            assert move is not None
            _follow(plant, move)
            here = corner
            psi.append(plant.state.psi)
        turned.append(psi[-1] - psi[0])
    assert turned[0] == pytest.approx(move_on, rel=0.1)
    assert turned[1] == pytest.approx(-move_on, rel=0.1)


def _follow(plant: DryPlant, move: Move, step: float = 5e-3) -> None:
    count = math.ceil(move.duration / step)
    for begin, end in pairwise(move.duration * i / count for i in range(count + 1)):
        plant.advance(move.at((begin + end) / 2), move.at(end), move.duration / count)
