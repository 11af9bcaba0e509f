"""Curved palms from a blind start: accurate within the error bars, or rejected with the reason."""

import json
import math
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from campaign import nightly
from curved_logs import simulate_curved_log
from library import library
from plain_shape_filters import corrected

from palmd import observer
from palmd.cli import main
from palmd.events import PadSample
from palmd.model import shape
from palmd.model.arcs import contacts_on_arcs
from palmd.model.outputs import NAMED
from palmd.model.smoothing import R
from palmd.observer.coverage import NORMAL_BINS, Coverage, contact_bins
from palmd.observer.initialiser import attempts_for
from palmd.observer.reconstruct import most_lying, reconstruct
from palmd.observer.rig_error import RigError
from palmd.observer.search import Search
from palmd.record.eventlog import read_log
from palmd.record.recognition import NONE_OF_THESE, verdict
from palmd.record.replay import replay
from palmd.score import score_outline, score_shape
from palmd.system.arcs import joints_of
from palmd.system.description import PadSensor, RigDescription
from palmd.system.reasons import Code

SECONDS = 6.0
reconstruct_module = sys.modules["palmd.observer.reconstruct"]  # the package has a function of the same name
ENOUGH_S = 4.0


@pytest.fixture(scope="module")
def cradle(tmp_path_factory):
    """A log's path, the log, and its truth."""
    lines, truth = simulate_curved_log("cfriction", 5, SECONDS)
    path = tmp_path_factory.mktemp("cradle") / "run.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path, read_log(path), truth


@pytest.fixture(scope="module")
def few(cradle):
    """The events of the first seconds, what they determine, and how many blind searches that took."""
    _, log, _ = cradle
    events = [event for event in log.events if event.t_sample < ENOUGH_S]
    return events, *reconstructed_and_searches(events, log.rig)


def reconstructed_and_searches(events, rig):
    blind, searches = Search.blind, []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Search, "blind", lambda *given: searches.append(given) or blind(*given))
        return reconstruct(events, rig), len(searches)


def test_a_log_of_a_cradle_is_reconstructed_from_a_blind_start(cradle):
    _, log, truth = cradle
    answer = reconstruct(log.events, log.rig)
    assert answer.converged, answer.reason
    score = score_outline(answer.theta, answer.h, answer.touched, np.array(truth["h_m"]))
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    assert score.e_h < max(3e-5, 3 * band)
    assert abs(answer.mass / truth["mass_kg"] - 1) < 0.02
    assert abs(answer.rho - truth["rho_m"]) < 4 * answer.rho_sd
    r1 = np.interp(answer.t, truth["t"], truth["r1_m"])
    assert np.sqrt(np.mean((answer.radii[0] - r1) ** 2)) < 1e-4, "evaluated at the tangents' normals"


def test_with_flat_palms_assumed_it_is_not_accepted(cradle, few):
    _, log, _ = cradle
    flat = replace(log.rig, pads=tuple(replace(pad, curvature=0.0) for pad in log.rig.pads))
    events, found, _ = few
    assert found.converged
    assert not reconstruct(events, flat).converged


def test_a_fit_that_contradicts_the_rig_is_searched_for_again(cradle, few, monkeypatch):
    """Dome 2042 of `python -m tools.studies curved`: a worse minimum with a contradicted rig was accepted."""
    _, log, _ = cradle
    refined, (events, found, searches) = reconstruct_module._refined, few
    assert (found.converged, searches) == (True, 1)
    monkeypatch.setattr(reconstruct_module, "_refined", lambda *given: replace(refined(*given), as_described=False))
    answer, searches = reconstructed_and_searches(events, log.rig)
    assert answer.converged
    assert searches > 1


@pytest.mark.parametrize("one_search", [True, *nightly(False)])
def test_palms_described_as_far_too_concave_give_a_rejection_with_the_reason(cradle, monkeypatch, one_search):
    _, log, _ = cradle
    if one_search:
        monkeypatch.setattr(reconstruct_module, "attempts_on", lambda search: [(0, attempts_for(search.rig)[0])])
    strong = replace(log.rig, pads=tuple(replace(pad, curvature=2 * pad.curvature) for pad in log.rig.pads))
    answer = reconstruct([event for event in log.events if event.t_sample < 2.5], strong)
    assert not answer.converged
    assert re.search(r"palms as concave as these \(\d\d.* 1/m\) may be too concave for it", answer.reason)
    assert answer.reason.code in (Code.UNEXPLAINED, Code.NOT_CONVERGED)


def test_an_object_nearly_as_flat_as_its_palm_is_rejected_with_the_reason(cradle, few, monkeypatch):
    """An object with single contacts never has this curvature, so only the test of the limit is exercised."""
    _, log, _ = cradle
    monkeypatch.setattr(reconstruct_module, "MOST_LYING", 0.3)
    answer = reconstruct(few[0], log.rig)
    assert not answer.converged
    assert re.match(r"the palms are too concave for the object: kappa v reaches 0\.\d\d at a contact", answer.reason)
    assert answer.reason.code == Code.TOO_CONCAVE


def test_the_live_observer_converges_to_the_truth(cradle):
    _, log, truth = cradle
    watcher = observer.make("shape", log.rig, smoothing=observer.Simulated(log.rig))
    ticks = list(replay(replace(log, events=[event for event in log.events if event.t_sample < 5.0]), watcher))
    last = ticks[-1].estimate
    assert last.valid
    assert last.object_count == 1
    t, r1 = truth["t"], truth["r1_m"]
    off = [tick.estimate.r1 - np.interp(tick.t, t, r1) for tick in ticks if tick.estimate.valid and tick.t > 4.0]
    assert np.sqrt(np.mean(np.square(off))) < 1e-4
    drawn = next(tick.shape for tick in reversed(ticks) if tick.shape is not None)
    result = {"theta_rad": drawn.theta, "h_m": drawn.h, "touched": drawn.touched}
    assert score_shape(result, truth["h_m"], all_normals=False).e_h < 1e-4


@pytest.mark.parametrize("stored", [True, False])
def test_a_stored_outline_is_recognised_on_a_cradle_and_others_are_not(stored, tmp_path):
    bodies, outlines = library("friction", 22, 8)
    lines, truth = simulate_curved_log("cfriction", 22, 4.0, body=bodies[6])
    path = tmp_path / "run.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    log = read_log(path)
    known = outlines if stored else [each for each in outlines if each is not outlines[6]]
    recogniser, identifications, off = observer.make("shape", log.rig, outlines=known), [], []
    for tick in replay(log, recogniser):
        identifications.append(recogniser.identify(tick.t))
        if tick.estimate.valid:
            assert identifications[-1].best, "no estimate is valid before the decision"
            off.append(tick.estimate.r1 - np.interp(tick.t, truth["t"], truth["r1_m"]))
    found = verdict(each for each in identifications if each is not None)
    assert found.decision == (outlines[6].name if stored else NONE_OF_THESE)
    assert bool(off) is stored
    assert not stored or np.sqrt(np.mean(np.square(off))) < 1e-4


@pytest.mark.parametrize("name", ["extended", "quasistatic"])
def test_observers_for_flat_palms_refuse_curved_ones(cradle, tmp_path, capsys, name):
    path, log, _ = cradle
    assert main(["estimate", str(path), "-o", str(tmp_path / "out"), "--observer", name]) == 1
    message = capsys.readouterr().err
    assert f"the observer {name} supports flat palms only" in message
    with pytest.raises(ValueError, match="supports flat palms only"):
        observer.make(name, log.rig)


def test_coverage_uses_the_contact_tangents():
    curvatures = (14.0, -9.0)
    h = np.zeros(shape.COEFFICIENTS)
    h[0] = 0.02
    joints = joints_of(0.02, (0.7, 1.7), curvatures)
    s = contacts_on_arcs(h, *(np.array([each]) for each in joints), np.zeros(1), curvatures)[:, 0]
    y = np.zeros(len(NAMED))
    for name, value in zip(("phi1", "phi2", "s1", "s2"), (*joints, *s), strict=True):
        y[NAMED.index(name)] = value
    wanted = [
        math.floor(theta / math.tau * NORMAL_BINS) % NORMAL_BINS for theta in (0.7 - math.pi / 2, 2.4 - 1.5 * math.pi)
    ]
    assert contact_bins(y, curvatures) == wanted
    coverage = Coverage(curvatures=curvatures)
    coverage.mark(0.0, 0, y, lambda: np.zeros(1))
    assert set(np.flatnonzero(coverage.marks)) == set(wanted)


def test_most_lying_is_the_largest_ratio_of_curvatures():
    h = np.zeros(25)
    h[0], h[3] = 0.02, -0.001  # v = a0 − 3 a2 cos 2θ
    assert most_lying(h, [np.array([[0.0, math.pi / 2]])], (40.0, 0.0)) == pytest.approx(40 * 0.023)
    assert most_lying(h, [np.array([[0.0, math.pi / 2]])], (0.0, 0.0)) == 0.0


def test_the_standoff_correction_of_readings_on_an_arc():
    curvatures = (14.0, 11.0)
    rig = RigDescription(pads=tuple(PadSensor(curvature=kappa) for kappa in curvatures))
    h, off = np.zeros(shape.COEFFICIENTS), 2e-4
    h[0] = 0.02
    joints = joints_of(0.02, (0.7, 1.7), curvatures)
    palms = tuple(np.array([each]) for each in joints)
    on_the_line = contacts_on_arcs(h, *palms, np.zeros(1), curvatures)[:, 0]
    h[0] += off  # both pads stand off as if the object were larger
    there = contacts_on_arcs(h, *palms, np.zeros(1), curvatures)[:, 0]
    error = RigError(tuple(pad.length for pad in rig.pads), rig.curvatures)
    error.values[[R.STANDOFF, R.STANDOFF + 1]] = off
    for _ in range(2):  # each correction uses the other pad's place
        on_time = [corrected(error, PadSample(0.0, pad, there[pad - 1]), joints[1], 0.02) for pad in (1, 2)]
    assert on_time == pytest.approx(on_the_line, abs=0.05 * abs(there - on_the_line).max())
