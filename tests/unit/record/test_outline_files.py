"""Outlines for CAD: each file read back by an independent reader and compared with the original body."""

import math
import re
import sys
import xml.etree.ElementTree as ElementTree

import ezdxf
import numpy as np
import pytest
import rig_recording
from ezdxf import units

from palmd.cli import main
from palmd.outlinefile import read_outline
from palmd.record.outline_files import SDS, SUFFIXES, as_csv, as_svg, curves_of, writer_of
from tools.studies.real_objects import real_object

A, B = 0.03, 0.02  # semi-axes of an ellipse (m): h² = a² cos² + b² sin²
SVG = "{http://www.w3.org/2000/svg}"


def ellipse(count=360, start=0.0, touched=None):
    theta = start + np.arange(count) * (math.tau / count)
    h = np.hypot(A * np.cos(theta), B * np.sin(theta))
    mask = np.ones(count, dtype=bool) if touched is None else touched(theta % math.tau)
    return curves_of("an <ellipse>", theta, h, np.full(count, 1e-4), mask, rho_m=0.018, mass_kg=0.2)


@pytest.mark.parametrize(("count", "start"), [(360, 0.0), (180, 0.7), (361, 0.0)])
def test_points_lie_on_the_body_and_the_band_beside_it(count, start):
    curves = ellipse(count, start)
    x, y = curves.outline.T
    np.testing.assert_allclose((x / A) ** 2 + (y / B) ** 2, 1e6, rtol=1e-6)
    for beside, side in ((curves.outer, 1), (curves.inner, -1)):
        away = beside - curves.outline
        np.testing.assert_allclose(np.hypot(*away.T), SDS * 0.1, rtol=1e-9)
        slope = np.stack([x / A**2, y / B**2], axis=1)  # the ellipse's own normal
        along = np.sum(away * slope, axis=1) / np.hypot(*slope.T) / np.hypot(*away.T)
        np.testing.assert_allclose(along, side, atol=1e-6)


def test_untouched_arcs_end_at_touched_points_wherever_the_circle_begins():
    curves = ellipse(touched=lambda theta: (theta > 0.5) & (theta < 2.0) | (theta > 3.0) & (theta < 6.0))
    arcs = curves.untouched
    assert len(arcs) == 2
    for arc in arcs:
        rows = [int(np.flatnonzero((curves.outline == point).all(axis=1))[0]) for point in arc]
        marks = curves.touched[rows]
        assert marks[0]
        assert marks[-1]
        assert not marks[1:-1].any()
    assert sum(len(arc) - 2 for arc in arcs) == np.sum(~curves.touched)
    assert ellipse().untouched == ()
    (whole,) = ellipse(touched=lambda theta: theta < -1).untouched
    assert (whole[0] == whole[-1]).all()
    (almost,) = ellipse(touched=lambda theta: np.abs(theta - 1.0) < 0.01).untouched
    assert len(almost) > 700


def test_csv_points_can_be_read_as_an_outline_by_palmd(tmp_path):
    path = tmp_path / "ellipse.csv"
    path.write_bytes(as_csv(ellipse()))
    back = read_outline(path)
    theta = np.radians(np.arange(360))
    np.testing.assert_allclose(back.h, np.hypot(A * np.cos(theta), B * np.sin(theta)), atol=2e-6)
    assert (back.rho, back.mass) == pytest.approx((0.018, 0.2))


def places(path):
    return np.array([[float(cell) for cell in pair.split()] for pair in re.split("[MLZ]", path.get("d")) if pair])


def test_an_svg_drawing_is_to_scale_and_upright():
    curves = ellipse(touched=lambda theta: theta < 5.0)
    root = ElementTree.fromstring(as_svg(curves))
    left, top, width, height = map(float, root.get("viewBox").split())
    assert (root.get("width"), root.get("height")) == (f"{width:.3f}mm", f"{height:.3f}mm")
    assert root.find(f"{SVG}title").text == "an <ellipse>"
    assert "units: mm" in root.find(f"{SVG}desc").text
    group = root.find(f"{SVG}g")
    assert group.get("transform") == "scale(1,-1)"
    paths = {path.get("id"): path for path in group}
    assert paths.keys() == {"outline", "band_outer", "band_inner", "untouched_1", "centre_of_mass"}
    for name, points in (("outline", curves.outline), ("band_outer", curves.outer), ("band_inner", curves.inner)):
        np.testing.assert_allclose(places(paths[name]), points, atol=1e-5)
        assert paths[name].get("d").endswith("Z")
        assert left < points[:, 0].min()
        assert points[:, 0].max() < left + width
        assert top < -points[:, 1].max()
        assert -points[:, 1].min() < top + height


def test_a_dxf_drawing_has_its_unit_and_its_layers(tmp_path):
    curves = ellipse(touched=lambda theta: theta < 5.0)
    path = tmp_path / "ellipse.dxf"
    path.write_bytes(writer_of(".dxf")(curves))
    drawing = ezdxf.readfile(path)
    assert drawing.units == units.MM
    assert not drawing.audit().errors
    lines = {"OUTLINE": [], "BAND": [], "UNTOUCHED": []}
    for line in drawing.modelspace().query("LWPOLYLINE"):
        lines[line.dxf.layer].append((line.closed, np.array(line.get_points("xy"))))
    for layer, wanted in (("OUTLINE", [curves.outline]), ("BAND", [curves.outer, curves.inner])):
        for (closed, points), curve in zip(lines[layer], wanted, strict=True):
            assert closed
            np.testing.assert_allclose(points, curve, atol=1e-9)
    ((closed, _),) = lines["UNTOUCHED"]
    assert not closed
    assert any("units: mm" in text.dxf.text for text in drawing.modelspace().query("TEXT"))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_last_valid_outline_of_a_run_is_exported(tmp_path, suffix, capsys):
    target = tmp_path / f"outline{suffix}"
    assert main(["export", str(rig_recording.path()), "-o", str(target)]) == 0
    assert capsys.readouterr().err == ""
    last = [fields for topic, fields in rig_recording.published() if topic == "palm/shape"][-1]
    if suffix == ".csv":
        rows = np.loadtxt(target, delimiter=",", skiprows=8)
        x, y, normal = rows[:, 0], rows[:, 1], np.radians(rows[:, 6])
        np.testing.assert_allclose(
            (x * np.cos(normal) + y * np.sin(normal))[:: 720 // len(last["h_m"])],
            np.array(last["h_m"]) * 1e3,
            atol=1e-3,
        )
    assert target.stat().st_size > 10_000


def test_without_ezdxf_the_error_says_what_to_install_before_reading(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    monkeypatch.delitem(sys.modules, "palmd.record.outline_dxf", raising=False)
    for command in (["export", str(rig_recording.path())], ["reconstruct", "no such log"]):
        assert main([*command, "-o", str(tmp_path / "o.dxf")]) == 1
        assert "a DXF drawing needs ezdxf, which is not installed: " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_result_without_an_outline_is_an_error(tmp_path, capsys):
    result = tmp_path / "result.json"
    result.write_text('{"converged": false, "reason": "too little", "trajectory": null}')
    assert main(["export", str(result), "-o", str(tmp_path / "o.svg")]) == 1
    assert "the reconstruction has no trajectory: too little" in capsys.readouterr().err
    assert main(["export", str(result), "-o", str(tmp_path / "o.zip")]) == 1
    assert "only the outline of a result can be exported" in capsys.readouterr().err


def test_a_straight_part_is_drawn_dashed_and_labelled():
    theta = np.arange(360) * (math.tau / 360)
    h = real_object("D-profile", np.random.default_rng(3)).body.support.sample(theta)
    curves = curves_of("D", theta, h, np.full(360, 1e-4), np.ones(360, dtype=bool))
    root = ElementTree.fromstring(as_svg(curves))
    (path,) = [each for each in root.iter(f"{SVG}path") if each.get("id", "").startswith("chord")]
    begin, end = places(path)
    assert "stroke-dasharray" in path.get("style")
    length = float(np.hypot(*(end - begin)))
    assert 15.0 < length < 25.0
    assert f"straight over {length:.2f} mm of the hull: flat side, or dent bridged" in root.find(f"{SVG}desc").text
    assert not ellipse().chords
