"""`python -m tools.studies observability`: what it prints, refuses and draws, and the numbers behind it."""

from __future__ import annotations

import math
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from palmd.console.extras import install_line
from palmd.events import PalmMotion
from palmd.model.outputs import rig_inputs
from palmd.observer import prior
from palmd.observer.observability import SAMPLE_S, Observability
from palmd.rig.friction import plant_on
from palmd.rig.plant import FrictionSurface, Hinge, stable_poses
from palmd.rig.shaker import drawn_shaking
from palmd.rig.shapes import random_body
from palmd.system.description import RigDescription
from palmd.system.vibration import Vibration
from tools.studies import codistributions, last_second, observability_maps
from tools.studies.commands import main
from tools.studies.equations.paper import CASES, POINT, codistribution

STEP_S = 5e-4


def told(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(["observability", *argv]) == 0
    return capsys.readouterr().out


# ------------------------------------------------------------------------------------------- command


def test_the_table_says_which_cases_are_observable(capsys: pytest.CaptureFixture[str]) -> None:
    lines = told(capsys, "--states", "200").splitlines()
    assert lines[0].split()[:4] == ["case", "equations", "size", "rank"]
    rows = {case: line[len(case) :].split() for case, line in zip(CASES, lines[1:], strict=False)}
    ranks = {case: (int(cells[-5]), cells[-4]) for case, cells in rows.items()}
    assert ranks == {
        "general": (10, "yes"),
        "equal rates": (6, "yes"),
        "palm 1 fixed": (6, "yes"),
        "palms fixed": (4, "no"),
        "palms fixed, with inputs": (5, "yes"),
    }
    assert rows["palms fixed"][-1] == "∞"


def test_a_seed_gives_the_same_table_again(capsys: pytest.CaptureFixture[str]) -> None:
    tables = [told(capsys, "--states", "50", "--seed", seed).splitlines()[: 1 + len(CASES)] for seed in ("3", "3", "4")]
    assert tables[0] == tables[1] != tables[2]


@pytest.mark.parametrize(("argv", "told_of"), [(["--states", "0"], "less than 1"), (["--seed", "-1"], "negative")])
def test_usage_errors(argv: list[str], told_of: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["observability", *argv])
    assert caught.value.code == 2
    assert told_of in capsys.readouterr().err


@pytest.mark.parametrize("folder", ["file/maps", "taken"])
def test_a_place_that_cannot_be_written_is_refused_in_one_line(
    folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "taken" / "observability.svg").mkdir(parents=True)
    assert main(["observability", "--states", "5", "-o", str(tmp_path / folder)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith(f"{tmp_path / folder / 'observability.svg'}: cannot be written")


def test_without_matplotlib_only_the_figure_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "tools.studies.observability_maps")
    monkeypatch.delattr("tools.studies.observability_maps")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["observability", "--states", "5", "-o", str(tmp_path)]) == 1
    expected = f"-o needs matplotlib, which is not installed: {install_line('matplotlib', 'studies')}\n"
    assert capsys.readouterr().err == expected
    assert told(capsys, "--states", "5")


def test_the_figure_is_drawn_and_always_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(last_second, "told", lambda one, two: math.nan if one > 0.5 else one**2 + two)
    written = []
    for name in ("a", "b"):
        assert told(capsys, "--states", "5", "-o", str(tmp_path / name)).endswith(f"{name}/observability.svg\n")
        written.append((tmp_path / name / "observability.svg").read_bytes())
    assert written[0] == written[1]
    assert len(written[0]) < 400_000
    assert ET.fromstring(written[0]).tag.endswith("svg")


# ------------------------------------------------------------------------------------------- numbers


def test_random_states_are_touched_by_both_palms_and_in_motion() -> None:
    states = dict(zip(POINT, codistributions.random_states(500, 0).T, strict=True))
    for s in (states["s1"], states["s2"]):
        assert (s > 0.002).all()
        assert (s < 0.0555).all()
    assert (states["phi1"] + states["phi2"] <= math.radians(172.0) + 1e-12).all()
    assert np.std(states["omega0"]) > 1.0


@pytest.mark.parametrize("case", CASES)
def test_units_do_not_decide(case: str) -> None:
    """The same states in millimetres and milliseconds, beside a table in those units: the same singular values."""
    points = codistributions.random_states(20, 1)
    values = codistributions.singular_values(case, points)
    units = np.array([1e3 if name in ("r1", "r2", "s1", "s2", "rho") else 1.0 for name in POINT])
    units[[i for i, name in enumerate(POINT) if name.startswith("omega")]] = 1e-3
    units[POINT.index("mass")], units[POINT.index("gravity")] = 1e3, 1e-3
    rows = codistribution(case, points * units)
    names = {
        "general": POINT[:10],
        "equal rates": (*POINT[:5], "phi1"),
        "palm 1 fixed": (*POINT[:5], "phi2"),
    }.get(case, POINT[:5])
    length_mm, time_ms = 20.0, math.sqrt(0.02 / 9.81) * 1e3
    columns = [1.0 if n.startswith("phi") else 1 / time_ms if n.startswith("omega") else length_mm for n in names]
    rows = rows * np.array(columns)
    length = np.linalg.norm(rows, axis=2, keepdims=True)
    rows = np.where(length < 1e-9 * length.max(axis=1, keepdims=True), 0.0, rows / length)
    assert np.linalg.svd(rows, compute_uv=False)[:, :4] == pytest.approx(values[:, :4], rel=1e-6)
    if case != "palms fixed":
        assert np.linalg.svd(rows, compute_uv=False)[:, -1] == pytest.approx(values[:, -1], rel=1e-4)


def test_where_the_equations_divide_by_zero_there_is_no_number() -> None:
    points = observability_maps.states(omega0=np.array([0.5, 0.7]), omega1=np.array([0.5, 0.5]))
    values = codistributions.singular_values("equal rates", points)
    assert np.isnan(values[0]).all()
    assert np.isfinite(values[1]).all()


def test_the_smallest_singular_value_falls_towards_the_determinants_zeros() -> None:
    omega0 = np.array([1.0, 1e-1, 1e-2])
    near = codistributions.singular_values(
        "equal rates", observability_maps.states(omega0=omega0, omega1=np.array(1.7))
    )
    assert (np.diff(np.log10(near[:, -1])) < -1.0).all()
    assert near[-1, -1] > 0.0
    at_zero = observability_maps.states(omega0=np.array([0.0]), omega1=np.array([1.0]))
    assert observability_maps.determinants("equal rates", at_zero)[0] == 0.0


# ------------------------------------------------------------------------------------------- last second


def _along_the_plant(omega1: float, omega2: float) -> float:
    """The same figure along the motion of the emulated rig's plant."""

    def at(t: float) -> PalmMotion:
        phi1 = last_second.PHI1_RAD + omega1 * (t - 0.5)
        return PalmMotion((phi1, last_second.PHI2_RAD + omega2 * (t - 0.5)), (omega1, omega2), (0.0, 0.0))

    body = random_body("nominal", np.random.default_rng(1))
    body = body.turned(stable_poses(body, at(0.0))[0])
    known = Vibration(frequency=2500.0, speed=2.0 / math.pi * prior.DITHER, speed_sd=0.0)  # so fast: it follows nothing
    shaking = drawn_shaking(known, np.random.default_rng(3), speed=0.0, pure=True)
    surface = FrictionSurface(prior.FRICTION, prior.DITHER, prior.DAMPING)
    plant = plant_on(body, Hinge("fixed", base=(0.0, 0.0)), surface, shaking=shaking)
    plant.place(at(0.0), psi=0.0)
    rig = RigDescription(hinge="fixed")
    follower = Observability(rig_inputs(rig), rig.reading_variances)
    one, two = plant.contacts()
    start = prior.blind_start((one.s, two.s), at(0.0), 1, True, np.random.default_rng(0))
    follower.begin(0.0, prior.shape_map_sd(start))
    x = last_second._object_at(at(0.0), 1)
    for k in range(2001):
        t = k * STEP_S
        x[:2] = plant.state.psi, plant.mean_omega0
        if k % round(SAMPLE_S / STEP_S) == 0:
            palms = at(t)
            follower.sample(t, x, np.array([*palms.angles, omega1, omega2, 0.0, 0.0]), np.zeros(2))
        if k % 20 == 0:
            follower.count(1)
            follower.count(2)
        plant.advance(at(t + STEP_S / 2), at(t + STEP_S), STEP_S)
    assert all(plant.touching)
    return follower.value()


@pytest.mark.parametrize("rates", [(-0.5, 0.1), (0.4, 0.3)])
def test_the_last_second_is_that_of_the_plant(rates: tuple[float, float]) -> None:
    assert last_second.told(*rates) == pytest.approx(_along_the_plant(*rates), rel=0.03)


def test_at_rest_a_second_tells_nothing() -> None:
    assert last_second.told(0.0, 0.0) < 0.02


def test_an_object_that_leaves_the_palms_has_no_figure() -> None:
    assert math.isnan(last_second.told(0.5, 1.5))
