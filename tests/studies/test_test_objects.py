"""The study of dice, nuts and coins: bodies repeat by seed, and counts are correct."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tools.studies import test_objects
from tools.studies.test_objects import LIVE, LOGGED, LUMP, ObjectRow, ObjectTask, body_of

THETA = np.arange(360) * (math.tau / 360)


def test_kind_and_seed_determine_the_body_and_every_third_has_an_offset_mass() -> None:
    for kind in ("coin", LUMP):
        again, once, other = (body_of(ObjectTask(kind, seed)).support.sample(THETA) for seed in (0, 0, 1))
        assert (again == once).all()
        assert np.abs(other - once).max() > 1e-5
    centred, weighted = (np.ptp(body_of(ObjectTask("coin", seed)).support.sample(THETA)) for seed in (0, 2))
    assert centred < 1e-9
    assert weighted > 1.9e-3


@pytest.mark.nightly
def test_corners_dents_and_dry_lumps_are_logs_replayed_live() -> None:
    assert LOGGED == ("corners of 3 mm", "corners of 1 mm", "dent of 4 mm", "dent of 10 mm", "dry lump")
    row = test_objects.run(ObjectTask("dent of 4 mm", 0, 1.5))
    assert not row.error
    assert row.wrong <= row.valid <= 1.0


def test_the_remarks_exclude_smooth_lumps_from_objects() -> None:
    die = ObjectRow("die", 0, valid=0.5, wrong=0.1, most_m=1e-3, refusals=3, losses=2, far=0.025)
    rows = [die, ObjectRow(LUMP, 0, valid=0.9, wrong=0.5, most_m=4e-4)]
    (together,), (wrong, _) = LIVE.totals(rows), LIVE.remarks(rows)
    assert together.startswith("all objects: runs 1, valid 50%, wrong, of all ticks 10.0%")
    assert "beyond 3 sd 2.5%" in together
    assert wrong == "die 0: wrong for 10.0%, by up to 1.00 mm"
    assert [line.split()[0] for line in LIVE.tabled(rows).splitlines()[1:]] == ["die", LUMP]
