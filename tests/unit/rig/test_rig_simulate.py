"""Simulated event logs: format, noise, sampling, truth, and departures from the model."""

import json
import math

import numpy as np
import pytest

from palmd.rig.imperfections import Imperfections, PadImperfection
from palmd.rig.plant import PlantOptions
from palmd.rig.shapes import KINDS
from palmd.rig.simulate import Rock, main, simulate_log


def column(lines, pad, name):
    return np.array([line[name] for line in lines if line.get("pad") == pad])


@pytest.fixture(scope="module")
def runs():
    return {kind: simulate_log(kind, 0, 3.0) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_form(runs, kind):
    lines, truth = runs[kind]
    header, events = lines[0], lines[1:]
    assert header["palmd_log"] == 1
    assert header["rig"]["hinge"]["mode"] == ("arc" if kind == "rig" else "fixed")
    assert header["rig"]["pad"] == {"length_m": 0.0555, "noise_m": 1e-4, "resolution_m": 1.27e-4}
    times = [event["t"] for event in events]
    assert times == sorted(times)
    assert times[0] == 0.0
    assert "palms" in events[0]
    assert set(events[0]["palms"]) == {
        *("phi1_rad", "phi2_rad", "omega1_rad_s", "omega2_rad_s", "alpha1_rad_s2", "alpha2_rad_s2")
    }
    assert len(truth["t"]) == len(truth["psi_rad"]) == 301
    assert len(truth["h_m"]) == len(truth["theta_rad"]) == 360
    assert truth["psi_rad"][0] == 0.0
    assert min(*truth["f1_n"], *truth["f2_n"]) > 0.0
    assert json.loads(json.dumps(truth)) == truth


@pytest.mark.parametrize("kind", KINDS)
def test_truth_obeys_the_contact_geometry(runs, kind):
    """s1 = (r1 cos φ2 + r2)/sin φ2 − d1 with r1, d1 from the listed outline: the gauge of h and ψ agree."""
    _, truth = runs[kind]
    h = np.fft.rfft(truth["h_m"]) / 180.0
    h[0] /= 2.0
    k = np.arange(len(h))
    for i in (0, 137, 300):
        phi1, phi2, psi = truth["phi1_rad"][i], truth["phi2_rad"][i], truth["psi_rad"][i]
        theta1 = phi1 - psi - math.pi / 2
        wave = h * np.exp(1j * k * theta1)
        assert truth["r1_m"][i] == pytest.approx(wave.sum().real, abs=1e-7)
        d1 = -(1j * k * wave).sum().real
        s1 = (truth["r1_m"][i] * math.cos(phi2) + truth["r2_m"][i]) / math.sin(phi2) - d1
        assert truth["s1_m"][i] == pytest.approx(s1, abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_noise_and_rounding(runs, kind):
    lines, truth = runs[kind]
    for pad in (1, 2):
        t, s, force = (column(lines, pad, name) for name in ("t", "s_m", "force_n"))
        error = s - np.interp(t, truth["t"], truth[f"s{pad}_m"])
        assert abs(error.mean()) < 3e-5
        assert 0.85e-4 < error.std() < 1.3e-4
        np.testing.assert_allclose(s / 1.27e-4, np.round(s / 1.27e-4), atol=1e-2)
        relative = force / np.interp(t, truth["t"], truth[f"f{pad}_n"]) - 1.0
        assert 0.035 < relative.std() < 0.075
    palms = [line for line in lines if "palms" in line]
    phi1 = np.array([line["palms"]["phi1_rad"] for line in palms])
    error = phi1 - np.interp([line["t"] for line in palms], truth["t"], truth["phi1_rad"])
    assert 1.4e-4 < error.std() < 2.7e-4


def test_sampling():
    regular = np.diff(column(simulate_log("nominal", 1, 3.0)[0], 1, "t"))
    assert regular == pytest.approx(np.full(len(regular), 0.01), abs=2e-6)
    banded = np.diff(column(simulate_log("friction", 1, 10.0)[0], 1, "t"))
    assert banded.mean() == pytest.approx(0.010, abs=0.0006)
    assert banded.std() == pytest.approx(0.005, abs=0.0006)


def test_kinds_differ_in_friction_and_start(runs):
    for kind in KINDS:
        truth = runs[kind][1]
        assert (truth["mu"] == 0.0) == (kind == "nominal")
        assert (truth["damping_m2_s"] > 0.0) == (kind == "nominal")
        away = abs(truth["omega0_rad_s"][1])
        assert away > 0.1 if kind == "nominal" else away < 0.05


def test_the_same_seed_gives_the_same_run():
    assert simulate_log("rig", 4, 1.0) == simulate_log("rig", 4, 1.0)
    assert simulate_log("rig", 4, 1.0)[0] != simulate_log("rig", 5, 1.0)[0]


def test_model_departures_are_visible_in_the_log():
    biased_pad = Imperfections((PadImperfection(), PadImperfection(zero=1e-3)))
    biased, truth = simulate_log("rig", 4, 3.0, imperfections=biased_pad)
    error = column(biased, 2, "s_m") - np.interp(column(biased, 2, "t"), truth["t"], truth["s2_m"])
    assert error.mean() == pytest.approx(1e-3, abs=3e-5)
    lagging, truth = simulate_log("rig", 4, 3.0, PlantOptions(lag_s=0.05))
    palms = [line for line in lagging if "palms" in line]
    plan_rate = [line["palms"]["omega1_rad_s"] for line in palms]
    rate = np.gradient(truth["phi1_rad"], truth["t"])
    later = np.interp([line["t"] + 0.05 for line in palms[:-10]], truth["t"], rate)
    np.testing.assert_allclose(later, plan_rate[:-10], atol=3e-3)


def test_rock_rates_are_derivatives():
    rock = Rock(0.7, 0.5, 0.3, 1.1)
    for t in (0.2, 0.7, 1.5):
        _, rate, acceleration = rock.at(t)
        after, before = rock.at(t + 1e-4), rock.at(t - 1e-4)
        assert rate == pytest.approx((after[0] - before[0]) / 2e-4, abs=1e-6)
        assert acceleration == pytest.approx((after[1] - before[1]) / 2e-4, abs=1e-5)
    assert rock.at(-1.0) == (0.7, 0.0, 0.0)


def test_command_line_writes_log_and_truth(tmp_path):
    out = tmp_path / "run.jsonl"
    assert main(["--kind", "odd", "--seed", "3", "--seconds", "0.5", "-o", str(out)]) == 0
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    truth = json.loads((tmp_path / "run.truth.json").read_text())
    assert (lines, truth) == simulate_log("odd", 3, 0.5)


def test_a_palm_eases_out_and_back_around_every_rest():
    rock = Rock(0.7, 0.5, 0.3, 0.1, ((2.0, 4.0), (7.0, 9.0)))
    t, step = np.arange(1.5, 11.0, 0.01), 1e-5
    angle, rate, acceleration = np.array([rock.at(each) for each in t]).T
    before, after = (np.array([rock.at(each + off) for each in t]).T for off in (-step, step))
    assert rate == pytest.approx((after[0] - before[0]) / (2 * step), abs=1e-6)
    assert acceleration == pytest.approx((after[1] - before[1]) / (2 * step), abs=1e-3)
    resting = ((t > 3.01) & (t < 3.99)) | ((t > 8.01) & (t < 8.99))
    assert (angle[resting] == 0.7).all()
    assert (np.abs(angle[~resting] - 0.7)).max() > 0.4
