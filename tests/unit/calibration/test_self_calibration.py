"""`palmd calibrate self`: runs on a mis-calibrated rig determine the settings that correct it."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import recorded
import yaml

from palmd.calibration.self_calibration import RigFit, applied, combined, fitted, proposed_settings
from palmd.cli import main
from palmd.config.any_config import config_hash
from palmd.config.two_palms import rig_description
from palmd.events import PadSample
from palmd.model.smoothing import RIG_CONSTANTS, R
from palmd.motion.kinematics import RigGeometry
from palmd.observer.criticism import RigBelief
from palmd.record.eventlog import event_line, header_line, line_text, read_log
from palmd.rig.imperfections import Imperfections, PadImperfection
from palmd.rig.simulate import simulate_log
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.rig_constants import RIG_NAMES
from palmd.yamlfile import load_config


def priors_of(rig):
    """Priors as in a reconstruction: small, but not zero, where a constant is known."""
    return RigBelief.of(rig).described_sd


PRIORS = priors_of(RigDescription().known_to(AS_CALIBRATED))
BIAS_M, TILT = (4e-4, -3e-4), math.radians(0.8)
TRUTH = {"pad1_zero_m": BIAS_M[0], "pad2_zero_m": BIAS_M[1], "phi1_rad": TILT}


def fit_of(left, **values):
    """A fit whose constants have this share of their prior sds left."""
    found = np.zeros(RIG_CONSTANTS)
    for name, value in values.items():
        found[RIG_NAMES.index(name)] = value
    return RigFit(found, np.diag((left * PRIORS) ** 2), PRIORS)


def test_the_information_of_runs_adds_up_and_the_prior_counts_once():
    random = np.random.default_rng(1)
    sensitivities = [random.normal(size=(20, RIG_CONSTANTS)) / PRIORS for _ in range(3)]
    truth = PRIORS * random.normal(size=RIG_CONSTANTS)
    wide = PRIORS * np.where(np.arange(RIG_CONSTANTS) == R.ZERO, 10.0, 1.0)

    def posterior(rows, prior):
        covariance = np.linalg.inv(np.diag(prior**-2) + rows.T @ rows)
        return covariance @ (rows.T @ (rows @ truth)), covariance

    mean, covariance = posterior(np.vstack(sensitivities), PRIORS)
    fit = combined(
        [(*posterior(rows, sds), sds) for rows, sds in zip(sensitivities, (PRIORS, wide, PRIORS), strict=True)], PRIORS
    )
    assert fit.values / PRIORS == pytest.approx(mean / PRIORS, abs=1e-9)
    assert fit.covariance / np.outer(PRIORS, PRIORS) == pytest.approx(covariance / np.outer(PRIORS, PRIORS), abs=1e-9)


def test_a_constant_contradicted_by_all_runs_together_gets_a_wide_prior():
    """A zero with an error of 5.4 one-sigmas, of which each run determines a fifth of the prior information."""
    covariance, rig = np.diag(PRIORS**2), RigDescription().known_to(AS_CALIBRATED)
    covariance[R.ZERO, R.ZERO] /= 1.2
    off = np.where(np.arange(RIG_CONSTANTS) == R.ZERO, 0.9 * PRIORS, 0.0)
    each = SimpleNamespace(rig_by_prior=(off, covariance), rig_prior_sd=PRIORS)
    alone, together = fitted([each], rig), fitted([each] * 30, rig)
    assert alone.values[R.ZERO] == pytest.approx(0.9 * PRIORS[R.ZERO])
    assert alone.priors == pytest.approx(PRIORS)
    assert together.priors[R.ZERO] > 4.0 * PRIORS[R.ZERO]
    assert together.values[R.ZERO] == pytest.approx(5.4 * PRIORS[R.ZERO], rel=0.02)


def test_settings_that_the_runs_do_not_determine_are_unchanged():
    config = load(TEXT)
    assert proposed_settings(fit_of(0.7, pad1_zero_m=3e-4, phi1_rad=0.01), config) == {}
    only = fit_of(0.7, pad1_zero_m=3e-4, pad2_zero_m=-2e-4)
    only.covariance[R.ZERO + 1, R.ZERO + 1] = (0.2 * PRIORS[R.ZERO + 1]) ** 2
    assert proposed_settings(only, config) == {"pads.palm2": {"zero_mm": 28.2, "zero_sd_mm": 0.02}}


def test_independent_sds_contain_no_more_information_than_the_runs():
    fit = fit_of(0.1)
    one, other = R.ZERO, R.SCALE
    fit.covariance[one, other] = fit.covariance[other, one] = 0.9 * fit.sds[one] * fit.sds[other]
    independent = np.diag(fit.independent_sds**2)
    assert np.linalg.eigvalsh((independent - fit.covariance) / np.outer(PRIORS, PRIORS)).min() > -1e-12


@pytest.mark.parametrize("sign", [1, -1])
def test_a_pad_with_the_proposed_settings_reads_the_true_place(sign):
    zero, scale, counts = 3e-4, 0.02, 57.0
    config = load(TEXT.replace("port: p2", f"port: p2, sign: {sign}"))
    before = config.pads.palm2
    fit = fit_of(0.1, pad2_zero_m=zero, pad2_scale=scale)
    after = applied(config, proposed_settings(fit, config)).pads.palm2
    reads = before.zero_mm + sign * counts / before.counts_per_mm
    touched = (reads - zero * 1e3) / (1.0 + scale)
    assert after.zero_mm + sign * counts / after.counts_per_mm == pytest.approx(touched, abs=1e-3)
    assert (after.zero_sd_mm, after.scale_sd) == (0.01, 3e-4)


def test_the_proposed_settings_give_the_true_palm_angles():
    config = load(TEXT)
    pose = RigGeometry.from_config(config).arm_pose((0.8, 1.6))
    after = applied(config, proposed_settings(fit_of(0.1, phi1_rad=0.01), config))
    phi1, phi2 = RigGeometry.from_config(after).palm_angles(*pose[:2])
    assert (phi1, phi2) == pytest.approx((0.81, 1.6), abs=1e-5)
    assert after.rig.gravity_sd_deg == pytest.approx(0.1 * math.degrees(PRIORS[R.TILT]), rel=0.05)


# ---- end to end -------------------------------------------------------------------------------------------

TEXT = """\
rig: {{palm1_length_mm: {length}}}
pads:
  palm1: {{port: p1, zero_sd_mm: 0.5, map_sd_mm: 0}}
  palm2: {{port: p2, zero_sd_mm: 0.5, map_sd_mm: 0}}
arm: {{port: a}}
"""
FOUND = "calibration/self.yaml"


def load(text):
    values = yaml.safe_load(text.format(length=120.0))
    return recorded.Config.model_validate(values)


def written(path, lines):
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


@pytest.fixture(scope="module")
def misjudged(tmp_path_factory):
    """A configuration, and a run on a rig with other zeros and another yaw."""
    folder = tmp_path_factory.mktemp("self")
    zeros = Imperfections(tuple(PadImperfection(zero=zero) for zero in BIAS_M))
    lines, _ = simulate_log("rig", 1, 20.0, imperfections=zeros)
    length_mm = lines[0]["rig"]["hinge"]["palm1_length_m"] * 1e3
    for line in lines:
        if "palms" in line:
            line["palms"]["phi1_rad"] -= TILT
    config = folder / "palmd.yaml"
    config.write_text(TEXT.format(length=length_mm))
    return config, written(folder / "run.jsonl", lines)


@pytest.fixture(scope="module")
def proposed(misjudged):
    """The proposal for it."""
    config, run = misjudged
    assert main(["calibrate", "self", str(config), str(run)]) == 0
    return yaml.safe_load((config.parent / FOUND).read_text())


def read_again(event, before, after):
    """The event that palmd would have read from the same bytes with the configuration `after`."""
    if isinstance(event, PadSample):
        old, new = before.pads.of(event.pad), after.pads.of(event.pad)
        counts = (event.s * 1e3 - old.zero_mm) * old.counts_per_mm
        return replace(event, s=(new.zero_mm + counts / new.counts_per_mm) * 1e-3)
    x, y, _ = RigGeometry.from_config(before).arm_pose(event.angles)
    return replace(event, angles=RigGeometry.from_config(after).palm_angles(x, y))


def test_errors_of_the_configuration_are_found(proposed):
    found = proposed["found"]
    for name, value in TRUTH.items():
        assert found[name]["told"], name
        assert abs(found[name]["value"] - value) < 2 * found[name]["sd"] < abs(value), name


def test_degenerate_directions_keep_their_prior(misjudged, proposed):
    """Readings determine neither the overall scale about the hinge nor the pads' standoff."""
    config = load_config(misjudged[0])
    priors = priors_of(rig_description(config))
    proposed_priors = priors_of(rig_description(applied(config, proposed["configuration"])))
    magnification, standoff = np.zeros(RIG_CONSTANTS), np.zeros(RIG_CONSTANTS)
    magnification[R.SCALE : R.SCALE + 2] = standoff[R.STANDOFF : R.STANDOFF + 2] = math.sqrt(0.5)
    for direction in (magnification, standoff):
        assert direction @ ((priors / proposed_priors) ** 2 * direction) == pytest.approx(1.0)
    names = {"pad1_scale", "pad2_scale", "pad1_standoff_m", "pad2_standoff_m"}
    assert {name for name in names if proposed["found"][name]["determined"]} == set()
    assert all(each["told"] == each["determined"] for each in proposed["found"].values()), "until 2.0"


def test_after_applying_the_proposal_no_error_is_left(misjudged, proposed, tmp_path):
    before = load_config(misjudged[0])
    after = applied(before, proposed["configuration"])
    assert proposed["settings_sha256"] == config_hash(after)
    config, run = tmp_path / "palmd.yaml", tmp_path / "run.jsonl"
    config.write_text(yaml.safe_dump(after.model_dump(mode="json", include={"rig", "pads", "arm"})))
    log = read_log(misjudged[1])
    again = [event_line(read_again(event, before, after)) for event in log.events]
    run.write_text("".join(map(line_text, [header_line(log.rig), *again])))
    assert main(["calibrate", "self", str(config), str(run)]) == 0
    again = yaml.safe_load((tmp_path / FOUND).read_text())["found"]
    for name in TRUTH:
        assert again[name]["told"], name
        assert abs(again[name]["value"]) < 2 * again[name]["sd"], name


# ---- refused input ----------------------------------------------------------------------------------------


def refused(capsys, *arguments):
    assert main(["calibrate", "self", *map(str, arguments)]) == 1
    return capsys.readouterr().err.splitlines()[-1]


def test_a_run_given_twice_is_refused(misjudged, capsys):
    config, run = misjudged
    assert "a run is given twice" in refused(capsys, config, run, run)


def test_a_log_of_another_rig_is_refused(misjudged, tmp_path, capsys):
    config = tmp_path / "palmd.yaml"
    config.write_text(TEXT.format(length=130.0))
    message = refused(capsys, config, misjudged[1])
    assert message.startswith(f"{misjudged[1]}: was recorded with rig.palm1_length_mm ")
    assert f"but {config} has 130.0" in message


def test_a_recording_with_other_values_is_refused(tmp_path, capsys):
    file, _ = recorded.begun(tmp_path)
    file.finish()
    run = file.path
    config = tmp_path / "palmd.yaml"
    config.write_text(TEXT.format(length=120.0).replace("port: p2", "port: p2, zero_mm: 27.7"))
    assert f"{run}: was recorded with pads.palm2.zero_mm 28.0, but {config} has 27.7" in refused(capsys, config, run)
    config.write_text(TEXT.format(length=120.0))
    assert "no run was reconstructed" in refused(capsys, config, run)  # it holds five ticks


def test_runs_without_a_reconstruction_are_refused_and_nothing_is_stored(misjudged, tmp_path, capsys):
    config, run = (Path(shutil.copy(path, tmp_path)) for path in misjudged)
    short = written(tmp_path / "short.jsonl", map(json.loads, run.read_text().splitlines()[:60]))
    assert "no run was reconstructed" in refused(capsys, config, short)
    assert not (tmp_path / FOUND).exists()
    assert "no such file" in refused(capsys, config, tmp_path / "none.jsonl").lower()
