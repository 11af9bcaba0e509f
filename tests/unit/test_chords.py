"""Straight parts of outlines: flat sides and bridged dents are marked, smooth bodies are not; the page agrees."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import palmd.view
from palmd.chords import chords_of
from palmd.rig.shapes import Support, random_body
from tools.studies.real_objects import real_object
from tools.studies.sharp_shapes import FLAT_RAD, ChordSupport

THETA = np.arange(360) * (math.tau / 360)
EVERYWHERE = np.ones(360, dtype=bool)


def outline_of_a_real_object(name: str) -> tuple[np.ndarray, tuple[float, ...]]:
    made = real_object(name, np.random.default_rng(3))
    return made.body.support.sample(THETA), made.size_m


def test_a_nut_has_six_sides_and_a_coin_none() -> None:
    h, (across,) = outline_of_a_real_object("nut")
    chords = chords_of(THETA, h, EVERYWHERE)
    assert sorted(round(math.degrees(each.normal)) % 360 for each in chords) == [30, 90, 150, 210, 270, 330]
    assert {round(each.length, 5) for each in chords} == {round(chords[0].length, 5)}
    assert 0.8 < chords[0].length / (across * math.tan(math.pi / 6)) < 1.0  # its corners are rounded
    for each in chords:
        for x, y in (each.begin, each.end):
            away = x * math.cos(each.normal) + y * math.sin(each.normal)
            assert away == pytest.approx(across / 2, abs=5e-5)
    assert chords_of(THETA, outline_of_a_real_object("coin")[0], EVERYWHERE) == ()


@pytest.mark.parametrize("normal", [0.0, 1.2, -3.1415, 0.0087])
def test_a_bridged_dent_is_one_chord_wherever_it_lies(normal: float) -> None:
    lump = Support.from_coefficients((18e-3 + 0j, 0j, 8e-4 + 0j, 2e-4 + 0j))
    hull = ChordSupport(lump, normal, 10e-3, FLAT_RAD)
    (chord,) = chords_of(THETA, hull.sample(THETA), EVERYWHERE)
    assert chord.length == pytest.approx(10e-3, abs=1e-3)
    assert math.remainder(chord.normal - normal, math.tau) == pytest.approx(0.0, abs=0.02)


def test_untouched_parts_are_not_marked() -> None:
    h, _ = outline_of_a_real_object("die")
    touched = np.abs((THETA + 1.0) % math.tau - 1.0) < 0.5
    (chord,) = chords_of(THETA, h, touched)
    assert chord.normal == pytest.approx(0.0, abs=1e-6)
    assert chords_of(THETA, h, ~EVERYWHERE) == ()


@pytest.mark.parametrize("kind", ["nominal", "friction", "rig", "odd"])
def test_smooth_bodies_have_no_chords(kind: str) -> None:
    for seed in range(20):
        h = random_body(kind, np.random.default_rng(seed)).support.sample(THETA)  # type: ignore[arg-type]
        assert chords_of(THETA, h, EVERYWHERE) == ()


@pytest.mark.skipif(shutil.which("node") is None, reason="no node to run the page's script")
@pytest.mark.parametrize("name", ["nut", "D-profile", "block", "ellipse"])
def test_the_page_marks_the_same_chords(name: str, tmp_path: Path) -> None:
    h, _ = outline_of_a_real_object(name)
    touched = THETA < 4.0
    script = tmp_path / "geometry.mjs"
    script.write_bytes((Path(palmd.view.__file__).parent / "static/geometry.js").read_bytes())
    arguments = json.dumps([THETA.tolist(), h.tolist(), touched.astype(int).tolist()])
    code = f"import {{ chords }} from '{script}'; console.log(JSON.stringify(chords(...{arguments})))"
    run = subprocess.run(["node", "--input-type=module", "-e", code], capture_output=True, text=True, check=True)
    ours = [[each.begin, each.end] for each in chords_of(THETA, h, touched)]
    assert np.array(json.loads(run.stdout)) == pytest.approx(np.array(ours), abs=1e-9)
