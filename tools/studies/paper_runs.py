"""The simulation of CMU-CS-01-107, section 3.4, by the paper's method: an object in balance, exact readings. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palmd.events import FloatArray
from palmd.model import quasistatic as qs
from palmd.observer.multi_start import BLOCKS, MultiStart, Spread
from tools.studies.paper_poses import BalancedRun, balanced_run

READINGS = 270
# Fourier series of h (m) of an elongated body with an eccentric centre of mass and radii of 12 to 24 mm.
OUTLINE = np.array([18.0, 1.6, -1.0, 4.2, 0.0, 0.3, 0.6, *[0.0] * 8]) * 1e-3
# Palms start nearly level; then they squeeze, turn together, open, and so on (φ1, φ2 in rad).
CORNERS = np.array([[0.25, 2.4], [0.25, 0.92], [1.86, 0.83], [0.39, 2.39], [0.7, 0.87], [1.9, 0.99], [0.54, 1.21]])
FIRST_PSI = 0.12
ROUNDS = 6
_MEAN_WIDTH, _BALANCE_WIDTH_M = 0.3, 2e-3  # half-widths of the first set: relative to the circle's radius; e_f (m)
_NARROWED, _LEAST_WIDTH_M = 3.0, 3e-5  # half-width of a narrower set: in 1σ of the weighted set, and at least (m)
VALLEY = 0.12  # half-width of the examined range of mean radii, relative to the true one
RADIUS_ERROR = 0.06  # relative error of the paper's radii


@dataclass(frozen=True, slots=True)
class Trace:
    """Estimates over time: (n,) each, in m, rad, rad/s; e_f and e_c NaN if a method has none."""

    t: FloatArray
    r1: FloatArray
    r2: FloatArray
    psi: FloatArray
    omega0: FloatArray
    e_f: FloatArray
    e_c: FloatArray


@dataclass(frozen=True, slots=True)
class Valley:
    """Errors (m, RMS over the run) of initial conditions in balance, by their initial mean radius (m)."""

    mean: FloatArray
    observable: FloatArray  # e_f and e_c, which the paper minimises
    conflict: FloatArray  # disagreement of radii and offsets about one outline


@dataclass(frozen=True, slots=True)
class PaperSimulation:
    """The paper's simulated run, and its estimates by (3.33)–(3.35).

    found: from the initial condition with the least conflict. wrong_radius: from one in balance whose mean radius is
    too large by `RADIUS_ERROR`, which e_f and e_c cannot distinguish from the right one.
    """

    run: BalancedRun
    found: Trace
    wrong_radius: Trace
    valley: Valley
    circle: float  # radius (m) of a circle with the first readings, from which the search starts


def paper_simulation() -> PaperSimulation:
    """Simulate the paper's run and estimate it; takes some two seconds."""
    t = np.linspace(0.0, 1.0, READINGS)
    path = minimum_jerk_path(t, CORNERS)
    run = balanced_run(OUTLINE, FIRST_PSI, t, path[:, 0], path[:, 1])
    first = run.readings[0]
    circle = float((first.s1 + first.s2) / 2 * math.tan(float(first.phi2) / 2))
    spread = Spread(circle, _MEAN_WIDTH * circle, 0.0, _BALANCE_WIDTH_M)
    for _ in range(ROUNDS):
        starts, states = _integrated(run, spread, circle)
        weights = starts.weights()
        best = int(np.argmax(weights))
        spread = _narrower(starts, weights)
    true = float(run.contacts.r1[0] + run.contacts.r2[0]) / 2
    wrong_radius, valley = _valley(run, true, circle)
    return PaperSimulation(run, _trace(run, states[:, :, best]), wrong_radius, valley, circle)


def _integrated(run: BalancedRun, spread: Spread, circle: float) -> tuple[MultiStart, FloatArray]:
    """A set of initial conditions integrated through the run and judged, and their states (n, 5, starts)."""
    step_s = float(run.t[1] - run.t[0])
    starts = MultiStart(spread, run.readings[0], float(run.psi[0]), circle, step_s, softening=0.0)
    states = [starts.state.copy()]
    for here, there in pairwise(run.readings):
        starts.step(here, there)
        states.append(starts.state.copy())
    for _ in range(BLOCKS):
        starts.judge()
    return starts, np.array(states)


def _narrower(starts: MultiStart, weights: FloatArray) -> Spread:
    centres_widths = []
    for values in (starts.mean, starts.balance):
        centre = float(weights @ values)
        width = _NARROWED * math.sqrt(float(weights @ (values - centre) ** 2))
        centres_widths += [centre, max(width, _LEAST_WIDTH_M)]
    return Spread(*centres_widths)


def _trace(run: BalancedRun, states: FloatArray) -> Trace:
    """The trace of one initial condition with `states` (n, 5)."""
    each = list(zip(run.readings, states, strict=True))
    return Trace(
        t=run.t,
        r1=states[:, 0],
        r2=states[:, 1],
        psi=states[:, 2],
        omega0=np.array([float(qs.turning_rate(readings, y[0], y[1])) for readings, y in each]),
        e_f=np.array([float(qs.balance_error(readings, y[0], y[1])) for readings, y in each]),
        e_c=np.array([float(np.hypot(*qs.closure_error(readings, y))) for readings, y in each]),
    )


def _valley(run: BalancedRun, true: float, circle: float) -> tuple[Trace, Valley]:
    """Errors of initial conditions in exact balance by mean radius, and the trace of one with a wrong radius."""
    starts, states = _integrated(run, Spread(true, VALLEY * true, 0.0, 1e-9), circle)
    balanced = np.flatnonzero(np.abs(starts.balance) < 1e-12)
    traces = [_trace(run, states[:, :, number]) for number in balanced]
    observable = np.array([math.sqrt(float(np.mean(trace.e_f**2 + trace.e_c**2))) for trace in traces])
    mean = starts.mean[balanced]
    wrong_radius = int(np.argmin(np.abs(mean - (1 + RADIUS_ERROR) * true)))
    return traces[wrong_radius], Valley(mean, observable, starts.conflict[balanced])


def relative_radius_error(run: BalancedRun, trace: Trace) -> float:
    """RMS of the errors of r1 and r2 over their true RMS, as the 6 % from the paper's figure 3.10(b)."""
    errors = np.concatenate([trace.r1 - run.contacts.r1, trace.r2 - run.contacts.r2])
    return float(np.sqrt(np.mean(errors**2) / np.mean(np.concatenate([run.contacts.r1, run.contacts.r2]) ** 2)))


def psi_error(run: BalancedRun, trace: Trace) -> float:
    """RMS of ψ's error (rad)."""
    return float(np.sqrt(np.mean((trace.psi - run.psi) ** 2)))


# ------------------------------------------------------------------------------------------- always in balance


def minimum_jerk_path(t: FloatArray, corners: FloatArray) -> FloatArray:
    """A minimum-jerk path (n, k) through `corners` (m, k) in equal times, at rest in each corner."""
    u = np.clip((t - t[0]) / (t[-1] - t[0]) * (len(corners) - 1), 0.0, len(corners) - 1)
    leg = np.minimum(u.astype(np.intp), len(corners) - 2)
    w = (u - leg)[:, None]
    path: FloatArray = corners[leg] + (corners[leg + 1] - corners[leg]) * w**3 * (10 - 15 * w + 6 * w**2)
    return path
