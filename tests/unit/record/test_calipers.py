"""Outlines against calipers: widths, the table of a bundle, and the comparison."""

import math

import numpy as np
import pytest

from palmd.record.calipers import CaliperError, Measured, as_csv, extremes_mm, read_table, scored, widths_mm

THETA = np.arange(360) * math.tau / 360
A_M, B_M = 0.022, 0.018
ELLIPSE = np.hypot(A_M * np.cos(THETA), B_M * np.sin(THETA))
OFF_CENTRE = ELLIPSE + 0.003 * np.cos(THETA - 0.4)


def stone(**changes):
    return Measured(**{"name": "stone", "run": "runs/1.mcap", "photo": "", "largest_mm": 44.0, "smallest_mm": 36.0,
                       "sd_mm": 0.05, "mass_g": 100.0} | changes)  # fmt: skip


def result(h=OFF_CENTRE, sd=5e-5, touched=(1,) * 360, mass=0.1):
    return {"h_m": list(h), "h_sd_m": [sd] * 360, "touched": list(touched), "mass_kg": mass, "mass_sd_kg": 0.001}


def test_widths_do_not_depend_on_the_position_of_the_centre():
    assert widths_mm(OFF_CENTRE) == pytest.approx(widths_mm(ELLIPSE))
    assert extremes_mm(OFF_CENTRE) == pytest.approx((2e3 * A_M, 2e3 * B_M))
    with pytest.raises(ValueError, match="even number"):
        widths_mm(ELLIPSE[:-1])


def test_a_whole_outline_is_compared_both_ways():
    scores = scored(result(), stone(largest_mm=44.3))
    assert scores["largest_mm"].sigmas == pytest.approx(-0.3 / math.hypot(0.1, 0.05))
    assert scores["smallest_mm"].sigmas == pytest.approx(0.0, abs=1e-6)
    assert scores["mass_g"].sigmas == pytest.approx(0.0, abs=1e-6)
    assert all(score.whole for score in scores.values())


def test_of_a_partial_outline_only_contradicting_widths_count():
    touched = [int(60 <= i < 120 or 240 <= i < 300) for i in range(360)]  # around the smallest width only
    scores = scored(result(touched=touched), stone())
    assert not scores["largest_mm"].whole
    assert scores["largest_mm"].estimate < 43.0
    assert scores["largest_mm"].sigmas == 0.0
    assert scored(result(touched=touched), stone(largest_mm=37.0))["largest_mm"].sigmas > 3.0
    assert scored(result(touched=touched), stone(smallest_mm=36.5))["smallest_mm"].sigmas < -3.0


def test_a_single_side_has_no_width():
    assert set(scored(result(touched=[1] * 180 + [0] * 180), stone())) == {"mass_g"}
    assert set(scored({"h_m": None}, stone(mass_g=math.nan))) == set()


def bundle(folder, text):
    (folder / "runs").mkdir(exist_ok=True)
    (folder / "runs/1.mcap").write_bytes(b"")
    (folder / "truth.csv").write_text(text)
    return folder


def test_a_table_is_read_back_unchanged(tmp_path):
    rows = [stone(), stone(name="nut", photo="nut.jpg")]
    assert read_table(bundle(tmp_path, as_csv(rows))) == rows


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("44,36", "wide,36"), "truth.csv:2: largest_mm must be a number, got 'wide'"),
        (("44,36", "34,36"), "truth.csv:2: needs 0 < smallest_mm ≤ largest_mm"),
        (("0.05,100", "inf,100"), "truth.csv:2: needs 0 < smallest_mm ≤ largest_mm and sd_mm > 0, all finite"),
        (("0.05,100", "0.05,inf"), "truth.csv:2: mass_g must be more than 0"),
        (("0.05,100", "0.05,-5"), "truth.csv:2: mass_g must be more than 0"),
        (("runs/1.mcap", "../1.mcap"), "truth.csv:2: run must lie in the bundle"),
        (("runs/1", "runs/2"), "truth.csv:2: there is no recording"),
        (("mass_g", "mass"), "truth.csv:2: column mass_g is missing"),
        (("stone,runs/1.mcap,,44,36,0.05,100\n", ""), "no objects listed"),
    ],
)
def test_a_bad_table_is_reported_with_its_place(tmp_path, change, said):
    text = as_csv([stone()])
    assert change[0] in text
    with pytest.raises(CaliperError, match=said.replace("(", r"\(")):
        read_table(bundle(tmp_path, text.replace(*change)))


def test_a_missing_table_is_reported(tmp_path):
    with pytest.raises(CaliperError, match="No such file"):
        read_table(tmp_path)
