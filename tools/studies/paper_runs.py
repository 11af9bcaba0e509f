"""The simulation of CMU-CS-01-107, section 3.4, by its own method: an object in balance, felt exactly. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from palmd.events import FloatArray
from palmd.model import quasistatic as qs
from palmd.model.stable_poses import TouchedPoint, touch
from palmd.observer.multi_start import BLOCKS, MultiStart, Spread
from tools.studies.paper_poses import follow

READINGS = 270
# An elongated body whose centre of mass is off its middle, radii of 12 to 24 mm: the Fourier series of h (m).
OUTLINE = np.array([18.0, 1.6, -1.0, 4.2, 0.0, 0.3, 0.6, *[0.0] * 8]) * 1e-3
# Palms nearly level at first; then they squeeze, turn together, open, and so on (φ1, φ2 in rad).
CORNERS = np.array([[0.25, 2.4], [0.25, 0.92], [1.86, 0.83], [0.39, 2.39], [0.7, 0.87], [1.9, 0.99], [0.54, 1.21]])
FIRST_PSI = 0.12
ROUNDS = 6
_MEAN_WIDTH, _BALANCE_WIDTH_M = 0.3, 2e-3  # of the first set of beginnings: of the circle's radius; m
_NARROWED, _LEAST_WIDTH_M = 3.0, 3e-5
VALLEY = 0.12  # of the true mean radius, on both sides
ASTRAY = 0.06  # as far as the paper's radii are off


@dataclass(frozen=True, slots=True)
class Trace:
    """What a method says over time: (n,) each, in m, rad, rad/s; e_f and e_c NaN where a method has none."""

    t: FloatArray
    r1: FloatArray
    r2: FloatArray
    psi: FloatArray
    omega0: FloatArray
    e_f: FloatArray
    e_c: FloatArray


@dataclass(frozen=True, slots=True)
class Valley:
    """Errors (m, RMS over the run) of beginnings in balance, against the mean radius (m) they begin with."""

    mean: FloatArray
    observable: FloatArray  # e_f and e_c, all that the paper minimises
    conflict: FloatArray  # radii and offsets about one outline


@dataclass(frozen=True, slots=True)
class PaperSimulation:
    """The paper's simulated run, and what (3.33)–(3.35) make of it.

    found: from the beginning with the least conflict. astray: from one in balance whose mean radius is `ASTRAY` too
    large, which e_f and e_c cannot tell from the right one.
    """

    run: BalancedRun
    found: Trace
    astray: Trace
    valley: Valley
    circle: float  # the radius (m) that a circle would have, where the search begins


def paper_simulation() -> PaperSimulation:
    """Some two seconds of work."""
    t = np.linspace(0.0, 1.0, READINGS)
    path = eased_path(t, CORNERS)
    run = balanced_run(OUTLINE, FIRST_PSI, t, path[:, 0], path[:, 1])
    first = run.felt[0]
    circle = float((first.s1 + first.s2) / 2 * math.tan(float(first.phi2) / 2))
    spread = Spread(circle, _MEAN_WIDTH * circle, 0.0, _BALANCE_WIDTH_M)
    for _ in range(ROUNDS):
        beginnings, states = _integrated(run, spread, circle)
        weights = beginnings.weights()
        best = int(np.argmax(weights))
        spread = _narrower(beginnings, weights)
    true = float(run.contacts.r1[0] + run.contacts.r2[0]) / 2
    astray, valley = _valley(run, true, circle)
    return PaperSimulation(run, _trace(run, states[:, :, best]), astray, valley, circle)


def _integrated(run: BalancedRun, spread: Spread, circle: float) -> tuple[MultiStart, FloatArray]:
    """A set of beginnings carried through the run and judged, and their states (n, 5, beginnings)."""
    step_s = float(run.t[1] - run.t[0])
    beginnings = MultiStart(spread, run.felt[0], float(run.psi[0]), circle, step_s, softening=0.0)
    states = [beginnings.state.copy()]
    for here, there in pairwise(run.felt):
        beginnings.step(here, there)
        states.append(beginnings.state.copy())
    for _ in range(BLOCKS):
        beginnings.judge()
    return beginnings, np.array(states)


def _narrower(beginnings: MultiStart, weights: FloatArray) -> Spread:
    centres_widths = []
    for values in (beginnings.mean, beginnings.balance):
        centre = float(weights @ values)
        width = _NARROWED * math.sqrt(float(weights @ (values - centre) ** 2))
        centres_widths += [centre, max(width, _LEAST_WIDTH_M)]
    return Spread(*centres_widths)


def _trace(run: BalancedRun, states: FloatArray) -> Trace:
    """Of one beginning: `states` (n, 5)."""
    each = list(zip(run.felt, states, strict=True))
    return Trace(
        t=run.t,
        r1=states[:, 0],
        r2=states[:, 1],
        psi=states[:, 2],
        omega0=np.array([float(qs.turning_rate(felt, y[0], y[1])) for felt, y in each]),
        e_f=np.array([float(qs.balance_error(felt, y[0], y[1])) for felt, y in each]),
        e_c=np.array([float(np.hypot(*qs.closure_error(felt, y))) for felt, y in each]),
    )


def _valley(run: BalancedRun, true: float, circle: float) -> tuple[Trace, Valley]:
    """Beginnings in exact balance, about the true mean radius; and the trace of one of them, led astray."""
    beginnings, states = _integrated(run, Spread(true, VALLEY * true, 0.0, 1e-9), circle)
    balanced = np.flatnonzero(np.abs(beginnings.balance) < 1e-12)
    traces = [_trace(run, states[:, :, number]) for number in balanced]
    observable = np.array([math.sqrt(float(np.mean(trace.e_f**2 + trace.e_c**2))) for trace in traces])
    mean = beginnings.mean[balanced]
    astray = int(np.argmin(np.abs(mean - (1 + ASTRAY) * true)))
    return traces[astray], Valley(mean, observable, beginnings.conflict[balanced])


def relative_radius_error(run: BalancedRun, trace: Trace) -> float:
    """RMS of r1 and r2's errors over their true RMS: as the paper's 6 % was read off its figure 3.10(b)."""
    errors = np.concatenate([trace.r1 - run.contacts.r1, trace.r2 - run.contacts.r2])
    return float(np.sqrt(np.mean(errors**2) / np.mean(np.concatenate([run.contacts.r1, run.contacts.r2]) ** 2)))


def psi_error(run: BalancedRun, trace: Trace) -> float:
    """RMS of ψ's error (rad)."""
    return float(np.sqrt(np.mean((trace.psi - run.psi) ** 2)))


# ------------------------------------------------------------------------------------------- always in balance


@dataclass(frozen=True, slots=True)
class BalancedRun:
    """Times t (s), palm angles and ψ (rad) along a run, both contacts, and what is felt, rates included: n instants."""

    t: FloatArray
    phi1: FloatArray
    phi2: FloatArray
    psi: FloatArray
    contacts: TouchedPoint
    felt: tuple[qs.QuasistaticReadings, ...]
    jumps: int


def balanced_run(
    coefficients: FloatArray, psi: float, t: FloatArray, phi1: FloatArray, phi2: FloatArray
) -> BalancedRun:
    """The object with this outline (m, about its centre of mass) put down near `psi` (rad), palms on a path (n).

    Rates are those of cubic splines through the exact values. Raises ValueError as `model.stable_poses.follow` does.
    """
    followed = follow(coefficients, np.array([psi]), phi1, phi2)
    turned = followed.psi[:, 0]
    contacts = touch(coefficients, phi1, phi2, turned)
    values = np.stack([contacts.s1, contacts.s2, phi1, phi2])
    rates = CubicSpline(t, values, axis=1)(t, 1)
    felt = tuple(qs.QuasistaticReadings(*column) for column in np.concatenate([values, rates]).T.tolist())
    return BalancedRun(t, phi1, phi2, turned, contacts, felt, int(followed.jumped.sum()))


def eased_path(t: FloatArray, corners: FloatArray) -> FloatArray:
    """A path (n, k) through `corners` (m, k) in equal times, at rest in each: minimum jerk between them."""
    u = np.clip((t - t[0]) / (t[-1] - t[0]) * (len(corners) - 1), 0.0, len(corners) - 1)
    leg = np.minimum(u.astype(np.intp), len(corners) - 2)
    w = (u - leg)[:, None]
    path: FloatArray = corners[leg] + (corners[leg + 1] - corners[leg]) * w**3 * (10 - 15 * w + 6 * w**2)
    return path
