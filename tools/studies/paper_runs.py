"""The runs behind the figures of CMU-CS-01-107, chapter 3, again: its own method, and palmd's beside it. Pure.

Its simulation (section 3.4) is an object that is always in balance, felt exactly 270 times. Its experiment (section
3.5) is an object with friction under noisy, irregular readings, here from the emulated plant or any log with its truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from palmd.events import FloatArray
from palmd.model import quasistatic as qs
from palmd.observer.multi_start import BLOCKS, MultiStart, Spread
from palmd.observer.quasistatic import QuasistaticObserver
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import EventLog
from palmd.record.replay import replay
from palmd.score import OutlineScore
from tools.studies.balanced import BalancedRun, balanced_run, eased_path
from tools.studies.scoring import Bools, score_where_known

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


# -------------------------------------------------------------------------------------- as in the experiment


@dataclass(frozen=True, slots=True)
class Method:
    """What one method makes of a log: its trace, outline, and its errors; psi_rms after the gauge is taken out."""

    trace: Trace
    theta: FloatArray
    h: FloatArray
    touched: Bools
    score: OutlineScore
    r_rms: float
    psi_rms: float


@dataclass(frozen=True, slots=True)
class SideBySide:
    """The paper's quasistatic observer and `reconstruct` on one log; None for a method without an answer."""

    name: str
    told: dict[str, Any]  # the truth
    psi_still: float  # RMS (rad) that saying "it does not turn" would have
    quasistatic: Method | None
    smoother: Method | None


def side_by_side(name: str, log: EventLog, told: dict[str, Any]) -> SideBySide:
    """Both methods on `log`, against the truth that was `told` in the fields of a `*.truth.json`."""
    psi = np.array(told["psi_rad"])
    return SideBySide(name, told, float(np.std(psi)), _quasistatic(log, told), _smoother(log, told))


def _quasistatic(log: EventLog, told: dict[str, Any]) -> Method | None:
    observer = QuasistaticObserver(log.rig)
    ticks = [tick.estimate for tick in replay(log, observer)]
    outline = observer.shape(ticks[-1].t)
    valid = [e for e in ticks if e.valid]
    if outline is None or not valid:
        return None
    columns = np.array([(e.t, e.r1, e.r2, e.psi, e.omega0, e.e_f, e.e_c) for e in valid]).T
    return _method(Trace(*columns), outline.theta, outline.h, outline.touched, told)


def _smoother(log: EventLog, told: dict[str, Any]) -> Method | None:
    answer = reconstruct(log.events, log.rig)
    if not answer.converged or answer.h is None or answer.touched is None:
        return None
    none = np.full(len(answer.t), math.nan)
    one, two = answer.radii
    trace = Trace(answer.t, one, two, answer.psi, answer.omega0, none, none)
    return _method(trace, answer.theta, answer.h, answer.touched, told)


def _method(trace: Trace, theta: FloatArray, h: FloatArray, touched: Bools, told: dict[str, Any]) -> Method | None:
    score = score_where_known(theta, h, touched, np.array(told["h_m"]))
    if score is None:
        return None
    true = {name: np.interp(trace.t, told["t"], told[name]) for name in ("r1_m", "r2_m", "psi_rad")}
    r_errors = np.stack([trace.r1 - true["r1_m"], trace.r2 - true["r2_m"]])
    return Method(
        trace, theta, h, touched, score,
        r_rms=float(np.sqrt(np.mean(r_errors**2))),
        psi_rms=float(np.std(trace.psi - true["psi_rad"])),
    )  # fmt: skip


def relative_radius_error(run: BalancedRun, trace: Trace) -> float:
    """RMS of r1 and r2's errors over their true RMS: as the paper's 6 % was read off its figure 3.10(b)."""
    errors = np.concatenate([trace.r1 - run.contacts.r1, trace.r2 - run.contacts.r2])
    return float(np.sqrt(np.mean(errors**2) / np.mean(np.concatenate([run.contacts.r1, run.contacts.r2]) ** 2)))


def psi_error(run: BalancedRun, trace: Trace) -> float:
    """RMS of ψ's error (rad)."""
    return float(np.sqrt(np.mean((trace.psi - run.psi) ** 2)))
