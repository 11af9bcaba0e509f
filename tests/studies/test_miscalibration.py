"""The mis-calibration study: each rig constant deviates as its table says, and the verdicts are correct."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from palmd.events import PadSample, PalmSample
from palmd.observer.criticism import CALIBRATION_SD
from palmd.rig.imperfections import PERFECT, drawn
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.rig_constants import RIG_NAMES
from tools.studies import miscalibration
from tools.studies.harness import as_line
from tools.studies.miscalibration import (
    MISCALIBRATIONS,
    STUDY,
    Miscalibration,
    MiscalibrationRow,
    MiscalibrationTask,
    draw,
    totals,
    verdict,
    with_constants,
)


def test_each_constant_is_changed_by_its_published_name_and_the_rest_stays():
    rest = drawn(RigDescription().known_to(AS_CALIBRATED), 3)
    drawn_names = [name for name, sd in zip(RIG_NAMES, CALIBRATION_SD, strict=True) if sd > 0.0]
    for number, name in enumerate(drawn_names, 1):
        value = number * 1e-3
        assert with_constants(rest, {name: value}).constants() == pytest.approx(rest.constants() | {name: value})
    assert with_constants(PERFECT, {}) == PERFECT


def test_the_table_names_existing_constants():
    assert all(set(each.constants) <= set(RIG_NAMES) for each in MISCALIBRATIONS)
    assert len({each.name for each in MISCALIBRATIONS}) == len(MISCALIBRATIONS)


def test_verdicts():
    both = Miscalibration("both zeros", {"pad1_zero_m": 1e-4, "pad2_zero_m": 1e-4})
    named = {
        (): "none",
        ("pad2_zero_m",): "right",
        ("pad1_zero_m", "pad2_zero_m"): "right",
        ("pad1_zero_m", "phi2_rad"): "with others",
        ("phi2_rad",): "wrong",
    }
    assert {each: verdict(both, each) for each in named} == named
    assert verdict(Miscalibration("nothing"), ("phi2_rad",)) == "wrong"
    assert verdict(Miscalibration("batches", as_well=("pad1_lag_s",)), ("pad1_lag_s",)) == "right"


def test_batched_readings_are_stamped_at_delivery_and_none_is_lost():
    events = [PadSample(0.001 + 0.007 * k, 1 + k % 2, 0.02 + 1e-4 * k, 1.0) for k in range(40)]
    events += [PalmSample(0.016 * k, (0.7, 1.6), (0.0, 0.0), (0.0, 0.0)) for k in range(10)]
    batched = miscalibration._in_batches(sorted(events, key=lambda event: event.t_sample), miscalibration._PACKET_S)
    assert len(batched) == len(events)
    assert [each.t_sample for each in batched] == sorted(each.t_sample for each in batched)
    before, after = ({e.s: e.t_sample for e in of if isinstance(e, PadSample)} for of in (events, batched))
    late = np.array([after[s] - t for s, t in before.items()])
    assert -miscalibration._PACKET_S < late.min() < late.max() <= miscalibration._BATCH_S
    one = [each.t_sample for each in batched if isinstance(each, PadSample) and each.pad == 1]
    assert len(set(one)) == len(one), "two readings of a pad at one time would count as one"


def test_tasks_alternate_worlds_kinds_and_seeds():
    asked = SimpleNamespace(only=["nothing"], taken_for=["exact", "calibrated"], seed=4, runs=2, seconds=9.0)
    tasks = draw(asked)
    assert [(task.taken_for, task.kind, task.seed) for task in tasks] == [
        ("exact", "friction", 4), ("exact", "rig", 5), ("calibrated", "friction", 4), ("calibrated", "rig", 5),
    ]  # fmt: skip


def test_overconfident_accepted_estimates_are_reported_with_their_seeds():
    good = MiscalibrationRow(
        "φ2 1°", "exact", "rig", 3, accepted=True, e_h_m=2e-5, h_sd_m=1e-5, z=0.5, named=("phi2_rad",),
        named_early=("phi2_rad",),
    )  # fmt: skip
    rows = [good, replace(good, seed=4, e_h_m=3.1e-5), replace(good, seed=5, accepted=False, reason="too little")]
    text = "\n".join([*totals(rows), *STUDY.remarks(rows)])
    assert "1 of 2 accepted have errors above 3 sd, 1 of 2 where touch can determine" in text
    high = replace(rows[1], off="pad 1 0.5 mm high")
    assert "2 of 3 accepted have errors above 3 sd, 1 of 2 where" in "\n".join(totals([*rows, high]))
    (line,) = [line for line in STUDY.tabled(rows).splitlines() if line.startswith("exact: φ2 1°")]
    assert line.split()[3:] == ["2", "of", "3", "25.5", "2.55", "3.1", "1", "2", "3", "0", "0", "0", "3"]
    assert "φ2 1°, rig 4: error 31 µm, sd 10 µm" in text
    assert "φ2 1°, rig 5: too little" in text
    assert "rig 3" not in text
    assert json.loads(json.dumps(as_line(rows[2]), allow_nan=False))["reason"] == "too little"


@pytest.mark.nightly
def test_a_real_runs_constant_deviates_as_its_row_says():
    row = miscalibration.run(MiscalibrationTask("φ2 1°", "exact", "friction", 3, 8.0))
    assert row.error == ""
    assert row.accepted
    assert not row.far
    assert verdict(next(each for each in MISCALIBRATIONS if each.name == row.off), row.named_early) in (
        "right",
        "with others",
    )
    assert row.z < 4.0
