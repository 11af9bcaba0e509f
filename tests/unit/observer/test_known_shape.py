"""An object with a stored outline: its absolute pose is found at once, and other objects are rejected."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from campaign import nightly
from library import THETA, angle, library, run_with

from palmd import observer
from palmd.events import DECIDED, PadSample, PalmMotion
from palmd.model import shape, shape_map
from palmd.observer.object_memory import DIRECTIONS
from palmd.observer.outline_prior import FRICTIONS, MOST_STARTS, outline_covariance, stored
from palmd.observer.recogniser import BANK, Recogniser
from palmd.outlinefile import Outline
from palmd.record.replay import replay
from palmd.rig.shapes import KINDS, random_body
from palmd.system.description import RigDescription

Z = shape_map.Z
PALMS = PalmMotion.at_rest((0.75, 1.6))
RIG = RigDescription()


def outline_of(body, h_sd=2e-5):
    return Outline("it", body.support.sample(THETA), np.full(360, h_sd), body.rho, 0.02 * body.rho, math.nan, math.nan)


def body_of(kind, seed):
    return random_body(kind, np.random.default_rng([KINDS.index(kind), seed]))


# ---- the belief


def test_the_belief_has_the_files_standard_deviations():
    outline = outline_of(body_of("nominal", 3))
    band = 1e-5 * (3.0 + np.cos(THETA))
    rows = shape.basis(THETA)
    cov = outline_covariance(replace(outline, h_sd=band))
    sd = np.sqrt(np.einsum("ij,jk,ik->i", rows, cov, rows))
    assert sd == pytest.approx(np.hypot(band, 5e-6 * math.sqrt(8)), rel=0.06)


def test_truncated_harmonics_of_the_outline_widen_the_belief():
    outline = outline_of(body_of("nominal", 3))
    rough = replace(outline, h=outline.h + 5e-5 * math.sqrt(2) * np.cos(11 * THETA))
    rows = shape.basis(THETA)

    def sd(of):
        cov = outline_covariance(of)
        return np.sqrt(np.einsum("ij,jk,ik->i", rows, cov, rows))

    assert np.sqrt(sd(rough) ** 2 - sd(outline) ** 2) == pytest.approx(np.full(360, 5e-5), rel=0.02)


def test_constants_come_from_the_file_or_from_the_prior():
    body = body_of("friction", 5)
    belief = stored([outline_of(body)])
    assert belief.x[0, Z.LN_RHO] == pytest.approx(math.log(body.rho))
    assert math.sqrt(belief.P[0, Z.LN_RHO, Z.LN_RHO]) == pytest.approx(0.02)
    assert shape.basis(THETA) @ belief.x[0, Z.SHAPE :] == pytest.approx(body.support.sample(THETA), abs=1e-9)
    with pytest.raises(ValueError, match="no outline"):
        stored([])


@pytest.mark.parametrize("psi", [0.4, 2.9, 5.5])
def test_it_starts_at_the_poses_that_match_the_readings(psi):
    outlines = library("friction", 2, 6)[1]
    belief = stored(outlines)
    _, rows = shape.contact_rows(PALMS.angles[0] - psi, PALMS.angles[1])
    s1, s2 = rows @ belief.x[4, Z.SHAPE :]
    starts = belief.starts((s1, s2), PALMS, RIG, 96)
    assert len(starts.which) == len(starts.psi) == len(starts.x) == 96
    assert abs(angle(starts.psi[starts.which == 4] - psi)).min() < 2 * math.pi / DIRECTIONS
    for which in range(6):
        own = starts.which == which
        for mu, mu_sd in FRICTIONS:
            alike = own & (starts.x[:, Z.MU] == mu)
            assert alike.sum() == own.sum() / len(FRICTIONS)
            assert starts.P[alike, Z.MU, Z.MU] == pytest.approx(mu_sd**2)
            apart = abs(angle(starts.psi[alike][:, None] - starts.psi[alike][None, :]))
            assert apart[~np.eye(alike.sum(), dtype=bool)].min(initial=9.0) > 2.5 * 2 * math.pi / DIRECTIONS
    everywhere = stored(outlines[:1]).starts((s1, s2), PALMS, RIG, 1000)
    assert 0.5 * MOST_STARTS < len(everywhere.which) <= MOST_STARTS


# ---- pose and motion


@pytest.mark.parametrize(("kind", "seed"), [("friction", 12), ("odd", 14), *nightly(("nominal", 11), ("rig", 13))])
def test_pose_and_motion_of_a_known_outline(kind, seed):
    bodies, outlines = library(kind, seed, 2)
    run = run_with(bodies[0], kind, seed, 3.0)
    watcher = observer.make("shape", run.log.rig, outlines=outlines[:1])
    estimates = [tick.estimate for tick in replay(run.log, watcher)]
    valid = [e for e in estimates if e.valid]
    assert valid[0].t < 1.5
    assert len(valid) > 0.95 * sum(e.t >= valid[0].t for e in estimates)
    t = [e.t for e in valid]
    psi = angle(np.array([e.psi for e in valid]) - np.interp(t, run.t, run.psi))
    assert np.sqrt(np.mean(psi**2)) < 0.03
    assert np.sqrt(np.mean((psi / [e.sd["psi"] for e in valid]) ** 2)) < 3.0
    for name in ("r1", "r2"):
        error = np.array([getattr(e, name) for e in valid]) - np.interp(t, run.t, run.truth[f"{name}_m"])
        assert np.sqrt(np.mean(error**2)) < 1.5e-4
        assert np.sqrt(np.mean((error / [e.sd[name] for e in valid]) ** 2)) < 3.0
    assert valid[-1].mass == pytest.approx(run.truth["mass_kg"], rel=0.03)
    drawn = watcher.shape(valid[-1].t)
    assert drawn.h == pytest.approx(bodies[0].support.sample(drawn.theta), abs=1e-4), "in the file's own frame"


def test_a_symmetric_object_has_two_orientations():
    body = next(b for b in (body_of("odd", seed) for seed in range(20)) if b.shape == "ellipse")
    run = run_with(body, "odd", 3, 2.5)
    estimates = [t.estimate for t in replay(run.log, observer.make("shape", run.log.rig, outlines=[outline_of(body)]))]
    assert estimates[-1].valid
    assert estimates[-1].sd["psi"] > 1.0
    assert estimates[-1].sd["r1"] < 2e-4
    assert abs(angle(2 * (estimates[-1].psi - np.interp(estimates[-1].t, run.t, run.psi)))) < 0.1


@pytest.mark.parametrize(("kind", "seed"), [("rig", 13), ("friction", 15), *nightly(("friction", 12), ("rig", 16))])
def test_another_object_is_never_valid(kind, seed):
    bodies, outlines = library(kind, seed, 2)
    run = run_with(bodies[0], kind, seed, 3.0)
    watcher = observer.make("shape", run.log.rig, outlines=outlines[1:])
    assert not any(tick.estimate.valid for tick in replay(run.log, watcher))
    assert watcher.identify(3.0).none > DECIDED


def test_a_similar_ellipse_is_distinguished_within_a_second():
    """Largest radii of 18.6 and 18.9 mm; with friction known to 2 % this takes a second."""
    bodies, outlines = library("odd", 18, 2)
    run = run_with(bodies[0], "odd", 18, 3.0)
    watcher = observer.make("shape", run.log.rig, outlines=outlines[1:])
    valid = [tick.t for tick in replay(run.log, watcher) if tick.estimate.valid]
    assert all(t < 1.0 for t in valid)
    assert watcher.identify(3.0).none > DECIDED


def test_a_much_larger_object_is_not_identified():
    body = body_of("friction", 7)
    outline = outline_of(body)
    small = replace(outline, h=outline.h * 0.8, rho=outline.rho * 0.8)
    run = run_with(body, "friction", 7, 2.5)
    watcher = observer.make("shape", run.log.rig, outlines=[small])
    ticks = [(tick, watcher.identify(tick.t)) for tick in replay(run.log, watcher)]
    assert not any(tick.estimate.valid for tick, _ in ticks)
    assert all(identification is None or not identification.best for _, identification in ticks)


# ---- robustness


def test_late_readings_change_little():
    """Just after the bank was thinned out, a late reading is dropped instead of being fused at its own time."""
    bodies, outlines = library("friction", 12, 2)
    run = run_with(bodies[0], "friction", 12, 3.0)
    events = list(run.log.events[:600])
    late, swapped = events.copy(), 0
    for i in range(40, len(late) - 2, 7):
        one, two = late[i], late[i + 1]
        if isinstance(one, PadSample) and isinstance(two, PadSample) and one.t_sample < two.t_sample:
            late[i], late[i + 1] = two, one
            swapped += 1
    assert swapped > 20
    answers = []
    for order in (events, late):
        watcher = observer.make("shape", run.log.rig, outlines=outlines)
        for i, event in enumerate(order):
            watcher.feed(event)
            if i % 10 == 9:
                watcher.estimate(max(e.t_sample for e in order[: i + 1]))
        t = events[-1].t_sample
        answers.append((watcher.estimate(t), watcher.identify(t).probability))
    assert watcher.late_dropped < 0.2 * swapped
    (one, p), (other, q) = answers
    assert one.valid
    assert other.valid
    assert (one.r1, one.psi) == pytest.approx((other.r1, other.psi), abs=5e-4)
    assert p == pytest.approx(q, abs=0.01)


def test_the_banks_size_is_limited():
    outlines = library("friction", 2, 6)[1]
    rig = run_with(library("friction", 12, 2)[0][0], "friction", 12, 3.0).log.rig
    assert Recogniser(outlines[:1], rig).filters.bank.full_size == MOST_STARTS
    assert Recogniser(outlines, rig).filters.bank.full_size == BANK
