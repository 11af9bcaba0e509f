"""The study of dice, nuts and coins: the same bodies for the same seeds, counted as they are."""

from __future__ import annotations

import math

import numpy as np

from tools.studies import things
from tools.studies.things import KINDS, LOGGED, LUMP, ThingRow, ThingTask, body_of, tasks_of

THETA = np.arange(360) * (math.tau / 360)


def test_each_kind_and_seed_is_one_body_and_every_third_has_its_mass_off_centre() -> None:
    for kind in ("coin", LUMP):
        again, once, other = (body_of(ThingTask(kind, seed)).support.sample(THETA) for seed in (0, 0, 1))
        assert (again == once).all()
        assert np.abs(other - once).max() > 1e-5
    centred, weighted = (np.ptp(body_of(ThingTask("coin", seed)).support.sample(THETA)) for seed in (0, 2))
    assert centred < 1e-9
    assert weighted > 1.9e-3


def test_all_kinds_have_the_same_seeds() -> None:
    tasks = tasks_of(KINDS, 5, 2, 3.0, "none")
    assert {(task.kind, task.seed) for task in tasks} == {(kind, seed) for kind in KINDS for seed in (5, 6)}


def test_corners_dents_and_dry_lumps_are_logs_replayed_live() -> None:
    assert LOGGED == ("corners of 3 mm", "corners of 1 mm", "dent of 4 mm", "dent of 10 mm", "dry lump")
    row = things.run(ThingTask("dent of 4 mm", 0, 1.5))
    assert not row.error
    assert row.wrong <= row.valid <= 1.0


def test_what_raises_becomes_a_row_that_says_so() -> None:
    row = things.run(ThingTask("teapot", 0))
    assert row.error.startswith("ValueError")
    assert things.remarks([row]) == [f"teapot 0: {row.error}"]


def test_the_table_leaves_smooth_lumps_out_of_things() -> None:
    rows = [ThingRow("die", 0, "", 0.5, 0.1, 1e-3, 1e-4, 3, 2, far=0.025), ThingRow(LUMP, 0, "", 0.9, 0.5, 4e-4, 1e-5)]
    told = things.table(rows)
    last = told.splitlines()[-1]
    assert last.startswith("all things")
    assert "10.0%" in last
    assert "2.5%" in last
    assert "50.0%" not in last
    assert things.remarks(rows)[0] == "die 0: wrong for 10.0%, by up to 1.00 mm"
