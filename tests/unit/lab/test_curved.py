"""The study of curved palms: its tables, one short run of each half, and what is refused."""

import math

from palmd.cli import main
from palmd.console.shipped import shipped
from palmd.lab.curved import CoverageRow, CoverageTask, LogRow, coverage_table, log_table, rocked


def test_the_table_tells_right_refused_and_wrong_apart():
    rows = [
        LogRow("cradle", 0, "", True, "", 5e-6, 1.0, 0.3, 1.0, 2.0),
        LogRow("cradle", 1, "", True, "", 4e-4, 9.0, 0.3, 1.0, 2.0),
        LogRow("cradle", 2, "", False, "the readings tell too little", 5e-6, 1.0, 0.3, 1.0, 2.0),
        LogRow("dome", 0, "ValueError: no"),
    ]
    head, cradle, dome, everything = (line.split("  ") for line in log_table(rows).splitlines())
    assert [cell.strip() for cell in head if cell.strip()][:4] == ["runs", "right", "refused", "wrong"]
    assert [cell.strip() for cell in cradle if cell.strip()][:5] == ["cradle", "3", "1", "1", "1"]
    assert [cell.strip() for cell in dome if cell.strip()][:5] == ["dome", "1", "0", "1", "0"]
    assert [cell.strip() for cell in everything if cell.strip()][:5] == ["all", "4", "1", "2", "1"]


def test_what_lost_a_contact_has_no_say_in_what_is_touched():
    rows = [CoverageRow(10.0, 0.25, 0, "", 0.4, 0.3), CoverageRow(10.0, 0.25, 1, lost=True)]
    told = coverage_table(rows)
    assert "cradle R 100 mm" in told
    assert "0.40" in told
    assert "1 of 2" in told


def test_a_cradle_touches_more_than_flat_palms_by_the_same_motion():
    cradle, flat = (rocked(CoverageTask(kappa, 0.25, 3, 2.0)) for kappa in (11.0, 0.0))
    assert not cradle.error
    assert not flat.error
    assert cradle.swing > flat.swing
    assert rocked(CoverageTask(60.0, 0.25, 3, 1.0)).lost, "it would lie in the palm"
    assert math.isnan(rocked(CoverageTask(60.0, 0.25, 3, 1.0)).touched)


def test_a_cylinder_is_not_evaluated_on_curved_palms(capsys):
    assert main(["calibrate", "pads", str(shipped("cradle.yaml")), "--radius-mm", "20"]) == 1
    assert "is evaluated on flat palms only, and these are curved" in capsys.readouterr().err
