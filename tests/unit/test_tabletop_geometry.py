"""The tabletop rig's geometry has one source: configuration, `palmd init`, drawing, OpenSCAD and MuJoCo model agree."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest

from palmd.cli.init import configuration, questions
from palmd.config.pads import StripConfig
from palmd.config.tabletop import STRIP_COUNTS
from palmd.config.two_palms import RigConfig
from palmd.devices.strip import POSITION_MAX
from palmd.yamlfile import load_config
from tools.tabletop.drawing import drawing
from tools.tabletop.geometry import TABLETOP
from tools.tabletop.loads import LARGEST_RADIUS_MM
from tools.tabletop.mjcf import mjcf
from tools.tabletop.parameters import parameters

ROOT = Path(__file__).parents[2]
SHIPPED = load_config(ROOT / "config/tabletop.yaml")
OTHER = replace(TABLETOP, strip_start=3.0, strip_length=73.5, palm_length=89.0, palm_width=18.0, axis_height=75.0)
"""Another rig, to test that the results follow the geometry."""


def usual_answers() -> dict[str, object]:
    answers: dict[str, object] = {}
    for key, prompt in questions(answers):
        answers[key] = prompt.read(prompt.default)
    return answers


def constants(pad: StripConfig) -> tuple[float, float, float]:
    return pad.zero_mm, pad.length_mm, pad.counts_per_mm


def test_configuration_defaults_are_the_drawn_rig():
    strip = (TABLETOP.strip_start, TABLETOP.strip_start + TABLETOP.strip_length, TABLETOP.counts_per_mm)
    assert strip == (2.5, 62.5, 273.05)
    assert constants(StripConfig(kind="strip", port="p")) == strip
    assert [constants(pad) for pad in SHIPPED.pads.each()] == [strip, strip]
    assert SHIPPED.rig.palm_lengths_mm == (TABLETOP.palm_length,) * 2 == (75.0, 75.0)
    assert STRIP_COUNTS == POSITION_MAX


def test_a_fixed_hinge_has_the_drawn_palms_by_default():
    assert RigConfig(hinge="fixed").palm_lengths_mm == (75.0, 75.0)
    assert RigConfig(hinge="fixed", palm1_length_mm=90.0).palm_lengths_mm == (90.0, 75.0)
    assert RigConfig().palm_lengths_mm == (120.0, 120.0)


def test_init_writes_the_drawn_rig_on_enter():
    written = configuration(usual_answers())
    for pad in written["pads"].values():
        assert (pad["zero_mm"], pad["length_mm"], pad["counts_per_mm"]) == constants(SHIPPED.pads.palm1)
    lengths = [written["rig"][f"palm{palm}_length_mm"] for palm in (1, 2)]
    assert lengths == list(SHIPPED.rig.palm_lengths_mm)


@pytest.mark.parametrize("geometry", [TABLETOP, OTHER])
def test_the_drawing_shows_the_geometry(geometry):
    shown = re.findall(r'data-name="(\w+)">[^<]*?([\d.]+)</text>', drawing(geometry))
    needed = {"palm_length", "strip_length", "strip_start", "palm_width", "axis_height"}
    assert needed | {"carrier_thickness", "foam_thickness", "motor_diameter", "motor_thickness"} <= {
        name for name, _ in shown
    }
    assert all(float(value) == getattr(geometry, name) for name, value in shown)


@pytest.mark.parametrize("geometry", [TABLETOP, OTHER])
def test_layers_under_the_axis_and_the_motor_beyond_the_strip(geometry):
    g = geometry
    layers = g.skin_thickness + g.strip_thickness + g.carrier_thickness + g.foam_thickness
    assert g.surface == pytest.approx(layers)
    assert g.foam_first + (g.foam_pads - 1) * g.foam_pitch + g.foam_length == pytest.approx(g.strip_end + g.strip_edge)
    assert g.foam_pitch > g.foam_length, "pads do not overlap"
    assert g.surface > g.motor_depth > g.carrier_under, "the motor's force goes through the foam"
    top = g.motor_diameter / 2 - g.motor_depth  # over the surface, where the largest object curves away from it
    reach = (LARGEST_RADIUS_MM**2 - (LARGEST_RADIUS_MM - top) ** 2) ** 0.5
    assert g.strip_end + reach < g.motor_start, "the object does not touch the motor"


@pytest.mark.parametrize("geometry", [TABLETOP, OTHER])
def test_openscad_is_given_the_geometry(geometry):
    given = dict(re.findall(r"^(\w+) = ([\d.]+);$", parameters(geometry), re.MULTILINE))
    for name in geometry.__slots__:
        assert float(given[name]) == getattr(geometry, name)
    program = (ROOT / "tools/tabletop/palmd-tabletop.scad").read_text()
    used = set(re.findall(r"\b[a-z]\w*_\w+\b", re.sub(r"//.*", "", program)))
    own = set(re.findall(r"(?:module|function) (\w+)|^\s*(\w+) = ", program, re.MULTILINE))
    own = {name for pair in own for name in pair if name} | {"linear_extrude"}
    assert used - own <= set(given), "every dimension of the parts is in the geometry"


@pytest.mark.parametrize("geometry", [TABLETOP, OTHER])
def test_the_mujoco_model_has_the_geometry(geometry):
    model = ET.fromstring(mjcf(geometry))

    def span(kind, name):
        each = next(one for one in model.iter(kind) if one.get("name") == name)
        middle, half = (list(map(float, each.get(key).split())) for key in ("pos", "size"))
        return [(1e3 * (m - h), 1e3 * (m + h)) for m, h in zip(middle, half, strict=True)]

    for number in (1, 2):
        along, normal, axis = span("geom", f"carrier{number}")
        assert along == pytest.approx((geometry.palm_start, geometry.palm_length), abs=1e-3)
        assert min(map(abs, normal)) == pytest.approx(0.0, abs=1e-3), "the surface goes through the axis"
        assert max(map(abs, normal)) == pytest.approx(geometry.carrier_under, abs=1e-3)
        assert axis[1] - axis[0] == pytest.approx(geometry.carrier_width, abs=1e-3)
        along, normal, axis = span("geom", f"plate{number}")
        assert along == pytest.approx((geometry.palm_start, geometry.palm_length), abs=1e-3)
        assert min(map(abs, normal)) == pytest.approx(geometry.surface, abs=1e-3)
        assert axis[1] - axis[0] == pytest.approx(geometry.palm_width, abs=1e-3)
        assert span("site", f"pad{number}")[0] == pytest.approx((geometry.strip_start, geometry.strip_end), abs=1e-3)


def test_the_mujoco_model_carries_an_object_between_its_palms():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(TABLETOP))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 2000)
    pads = [data.sensor(f"pad{number}").data[0] for number in (1, 2)]
    assert pads == pytest.approx([0.1 * 9.81 / 2**0.5] * 2, rel=0.02)
