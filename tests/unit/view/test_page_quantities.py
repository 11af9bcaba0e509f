"""The page gets its table of quantities from the server and has none of its own."""

import json
import re
from pathlib import Path

import pytest

from palmd.quantities import CHARTS, ESTIMATE, NIS_BAND
from palmd.view.http_guard import STATIC, page_files
from palmd.view.page_quantities import page_quantities


def test_the_page_gets_the_table():
    table = json.loads(page_files()["/quantities.json"].body)
    assert table == page_quantities()
    assert table["stale_ms"]["palm/loop"] == 3000.0
    omega0 = table["shown"]["palm/estimate"]["omega0_rad_s"]
    assert (omega0["symbol"], omega0["unit"], omega0["digits"], omega0["truth"]) == ("ω₀", "°/s", 1, "rig/truth")


def test_strips_are_the_charts_that_have_an_axis():
    strips = page_quantities()["strips"]
    titles = {chart.title for chart in CHARTS if chart.span is not None} | {"Following error, with its limit"}
    assert {strip["title"] for strip in strips} == titles
    radii, *_, in_space = [each for each in strips if each["title"] == "Distance of the palms from the centre of mass"]
    assert (radii["names"], radii["unit"], radii["factor"]) == (["r1_m", "r2_m"], "mm", 1e3)
    assert (in_space["names"], in_space["colours"]) == (["h1_m", "h2_m", "h3_m"], ["palm1", "palm2", "palm3"])
    assert len({tuple(strip["names"]) for strip in strips}) == len(strips)  # equal strips of two systems appear once


def test_quantities_without_a_strip_are_shown_as_numbers():
    shown = [each["name"] for each in page_quantities()["numbers"]]
    assert shown == ["psi_rad", "mu", "mass_kg", "com_y_m"]


def test_a_strip_has_its_group_and_its_range_of_good_values():
    strips = {strip["names"][0]: strip for strip in page_quantities()["strips"]}
    assert (strips["nis"]["group"], strips["nis"]["good"]) == ("Trust", list(NIS_BAND))
    assert strips["observability"]["good"] == [1.0, None]
    assert (strips["phi1_rad"]["group"], strips["phi1_rad"]["good"]) == ("Palms", None)
    assert all(strip["group"] for strip in strips.values())


@pytest.mark.parametrize("path", sorted(STATIC.glob("*.js")), ids=lambda path: path.name)
def test_no_script_contains_the_number_of_palms(path):
    """A quantity of one palm has its number in its name, which only `palm/info` and the table know."""
    assert re.findall(r"\b(?:palm|pad|phi|omega|touch|age|[rsf])[0-9]+(?:_\w+)?\b|\[1, 2\]", path.read_text()) == []


@pytest.mark.parametrize("name", ["store.js", "strips.js"])
def test_drawing_scripts_contain_no_names_of_quantities(name):
    text = (Path(STATIC) / name).read_text()
    assert [each.name for each in ESTIMATE.quantities if re.search(rf"\b{each.name}\b", text) and each.uncertain] == []
