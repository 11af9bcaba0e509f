"""What the page is told of the quantities, and that it makes no table of its own."""

import json
import re
from pathlib import Path

import pytest

from palmd.quantities import CHARTS, ESTIMATE
from palmd.view.files import STATIC, page_files
from palmd.view.page_quantities import page_quantities


def test_the_page_gets_the_table():
    table = json.loads(page_files()["/quantities.json"].body)
    assert table == page_quantities()
    assert table["stale_ms"]["palm/loop"] == 3000.0
    omega0 = table["shown"]["palm/estimate"]["omega0_rad_s"]
    assert (omega0["symbol"], omega0["unit"], omega0["digits"], omega0["truth"]) == ("ω₀", "°/s", 1, "rig/truth")


def test_strips_are_the_charts_that_have_an_axis():
    strips = {strip["title"]: strip for strip in page_quantities()["strips"]}
    assert list(strips) == [chart.title for chart in CHARTS if chart.span is not None]
    radii = strips["Distance of the palms from the centre of mass"]
    assert (radii["names"], radii["unit"], radii["factor"]) == (["r1_m", "r2_m"], "mm", 1e3)


def test_what_has_no_strip_is_told_as_a_number():
    told = [each["name"] for each in page_quantities()["told"]]
    assert told == ["psi_rad", "mu", "mass_kg", "f1_n", "f2_n", "com_y_m"]


@pytest.mark.parametrize("name", ["store.js", "strips.js"])
def test_what_draws_them_names_none(name):
    text = (Path(STATIC) / name).read_text()
    assert [each.name for each in ESTIMATE.quantities if re.search(rf"\b{each.name}\b", text) and each.uncertain] == []
