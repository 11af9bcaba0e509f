"""What every peer is given: readings with the motion between them, the truth, and where to start. Pure."""

# ruff: noqa: N806 -- matrices keep their capital letters
from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from palmd.events import Event, FloatArray, PadSample, PalmMotion, PalmSample
from palmd.model import shape, shape_map
from palmd.model.outputs import rig_inputs
from palmd.observer import prior
from palmd.observer.filters.base import LONGEST_STEP_S
from palmd.observer.fusion import EARLY_NOISE, EARLY_S
from palmd.observer.palms import PalmTracker
from palmd.system.description import RigDescription
from palmd.system.mechanism import normal_directions

StartName = Literal["good", "blind"]
GOOD = 0.1
"""One-sigma of a good start, in those of the prior."""

_BINS = 72  # of normals, each touched or not
_PSI_SD = 1e-6  # rad; the gauge fixes ψ, but an unscented filter takes no singular covariance


class LostError(Exception):
    """A peer has no answer any more; says why."""


@dataclass(frozen=True, slots=True)
class PeerReading:
    """One contact reading `value` (m) at `t` (s), and the integration steps that lead to it from the one before.

    moves: last inputs of `shape_map.predict_function`, first dt (s). palms: φ1 … α2 at `t`. forces: what each pad
    last said (N), NaN for nothing.
    """

    t: float
    pad: int
    value: float
    variance: float
    palms: FloatArray
    moves: tuple[FloatArray, ...]
    forces: tuple[float, float]


@dataclass(frozen=True, slots=True)
class PeerTask:
    """A run as every peer gets it; `s1`, `s2` (m) and `palms` are those at `t_start`, when both pads have spoken."""

    rig: RigDescription
    t_start: float
    s1: float
    s2: float
    palms: PalmMotion
    readings: tuple[PeerReading, ...]


@dataclass(frozen=True, slots=True)
class PeerTruth:
    """What was really there, SI: time series on `t`, h on evenly spaced normals from 0."""

    t: FloatArray
    psi: FloatArray
    omega0: FloatArray
    r1: FloatArray
    r2: FloatArray
    phi1: FloatArray
    phi2: FloatArray
    h: FloatArray
    rho: float
    mu: float
    dither: float
    damping: float
    mass: float

    @classmethod
    def from_fields(cls, fields: dict[str, Any]) -> PeerTruth:
        """From the fields of a `*.truth.json`; raises KeyError, TypeError or ValueError for what is none."""

        def series(name: str) -> FloatArray:
            return np.array(fields[name], dtype=np.float64)

        truth = cls(
            t=series("t"),
            psi=series("psi_rad"),
            omega0=series("omega0_rad_s"),
            r1=series("r1_m"),
            r2=series("r2_m"),
            phi1=series("phi1_rad"),
            phi2=series("phi2_rad"),
            h=series("h_m"),
            rho=float(fields["rho_m"]),
            mu=float(fields["mu"]),
            dither=float(fields["dither_m_s"] or prior.DITHER),  # nothing to tell without friction
            damping=float(fields["damping_m2_s"]),
            mass=float(fields["mass_kg"]),
        )
        lengths = {len(each) for each in (truth.psi, truth.omega0, truth.r1, truth.r2, truth.phi1, truth.phi2)}
        if lengths != {len(truth.t)} or not truth.t.size or not truth.h.size:
            raise ValueError("series of different lengths, or of none")
        return truth

    def radii(self, t: float) -> FloatArray:
        """(r1, r2) at `t` (m)."""
        return np.array([np.interp(t, self.t, self.r1), np.interp(t, self.t, self.r2)])

    def touched(self, theta: FloatArray) -> npt.NDArray[np.bool_]:
        """Which of the normals `theta` (rad) lie in a bin that either palm has touched."""
        bins = np.zeros(_BINS, dtype=np.bool_)
        for angle in normal_directions((self.phi1, self.phi2), self.psi):
            bins[_bin(angle)] = True
        return bins[_bin(theta)]


@dataclass(frozen=True, slots=True)
class PeerStart:
    """Mean and covariance of the shape map's state (`shape_map.Z`) at the task's `t_start`."""

    name: StartName
    x: FloatArray
    P: FloatArray


class Peer(Protocol):
    """One estimator on one run."""

    def step(self, reading: PeerReading) -> bool:
        """Predict to the reading and fuse it; False if this was not a whole step, and its time does not count."""

    def radii(self, reading: PeerReading) -> FloatArray:
        """(r1, r2) at the reading just taken (m)."""

    def outline(self) -> FloatArray | None:
        """Coefficients of h (m), None from a method without an outline."""


def task_from(rig: RigDescription, events: Iterable[Event]) -> PeerTask:
    """The events of a run as readings, cut as `observer.fusion` cuts them; ValueError if nothing is touched."""
    tracker, rig_values = PalmTracker(rig.palm_angle_noise), rig_inputs(rig)
    variances = rig.reading_variances
    last: dict[int, PadSample] = {}
    readings: list[PeerReading] = []
    t = t_start = math.inf
    first: tuple[float, float, PalmMotion] | None = None
    for event in sorted(events, key=lambda event: event.t_sample):
        if isinstance(event, PalmSample):
            tracker.feed(event)
        elif isinstance(event, PadSample):
            last[event.pad] = event
            if first is None:
                if len(last) == 2 and math.isfinite(tracker.t):
                    t = t_start = event.t_sample
                    first = (last[1].s, last[2].s, tracker.motion(t))
                continue
            moves = _moves(t, event.t_sample, tracker, rig_values)
            t = event.t_sample
            inflation = 1.0 + EARLY_NOISE * math.exp(-(t - t_start) / EARLY_S)
            forces = (_force(last[1]), _force(last[2]))
            variance = inflation * float(variances[event.pad - 1])
            readings.append(PeerReading(t, event.pad, event.s, variance, tracker.at(t), moves, forces))
    if first is None or not readings:
        raise ValueError("both pads and the palms must have been read for there to be anything to estimate")
    return PeerTask(rig, t_start, *first, tuple(readings))


def blind(task: PeerTask) -> PeerStart:
    """The prior itself: the circle that would give the first two readings, and all that is believed about it."""
    x, sd = _prior(task)
    return PeerStart("blind", x, np.diag(sd**2))


def good(task: PeerTask, truth: PeerTruth, random: np.random.Generator) -> PeerStart:
    """The truth, off by a draw with one-sigma of `GOOD` priors, and that as its covariance."""
    sd = GOOD * _prior(task)[1]
    theta: FloatArray = np.arange(len(truth.h), dtype=np.float64) * (math.tau / len(truth.h))
    x = np.zeros(shape_map.N)
    Z = shape_map.Z
    x[Z.PSI], x[Z.OMEGA0] = (np.interp(task.t_start, truth.t, series) for series in (truth.psi, truth.omega0))
    x[Z.LN_RHO], x[Z.MU] = math.log(truth.rho), truth.mu
    x[Z.LN_DITHER], x[Z.DAMPING] = math.log(truth.dither), truth.damping
    x[Z.SHAPE :] = np.linalg.lstsq(shape.basis(theta), truth.h, rcond=None)[0]
    return PeerStart("good", x + sd * random.standard_normal(shape_map.N), np.diag(sd**2))


def radii(x: FloatArray, reading: PeerReading) -> FloatArray:
    """(r1, r2) of a shape map at a reading's palms (m)."""
    Z = shape_map.Z
    # the rows are for ψ = 0: turn the palms instead of the body
    rows, _ = shape.contact_rows(float(reading.palms[0] - x[Z.PSI]), float(reading.palms[1]))
    return rows @ x[Z.SHAPE :]


def _prior(task: PeerTask) -> tuple[FloatArray, FloatArray]:
    belief = prior.blind_start((task.s1, task.s2), task.palms, 1, True, np.random.default_rng(0))
    Z = shape_map.Z
    x, sd = np.zeros(shape_map.N), np.zeros(shape_map.N)
    x[Z.LN_RHO], x[Z.MU] = math.log(prior.GYRATION * belief.mean_radius), prior.FRICTION
    x[Z.LN_DITHER], x[Z.DAMPING], x[Z.SHAPE] = math.log(prior.DITHER), prior.DAMPING, belief.mean_radius
    sd[Z.PSI], sd[Z.OMEGA0], sd[Z.LN_RHO] = _PSI_SD, prior.SPIN_AT_REST_SD, prior.GYRATION_SD
    sd[Z.MU], sd[Z.LN_DITHER], sd[Z.DAMPING] = prior.FRICTION_SD, prior.LN_DITHER_SD, prior.DAMPING_SD
    sd[Z.SHAPE :] = belief.shape_sd
    return x, sd


def _moves(t: float, t_next: float, tracker: PalmTracker, rig: FloatArray) -> tuple[FloatArray, ...]:
    steps = max(1, math.ceil((t_next - t) / LONGEST_STEP_S))
    dt = (t_next - t) / steps
    return tuple(np.concatenate([[dt], tracker.at(t + k * dt), tracker.jerk, rig]) for k in range(steps))


def _force(sample: PadSample) -> float:
    return math.nan if sample.force is None else sample.force


def _bin(angle: FloatArray) -> npt.NDArray[np.intp]:
    return (np.floor(angle / (math.tau / _BINS)) % _BINS).astype(np.intp)
