"""Readings of a pivoting grasp laid out for fitting: contacts, splines of the orientation over them, and rows. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solveh_banded
from scipy.sparse import csr_matrix

from palmd.events import FloatArray, PadSample
from palmd.model.pivot import INPUTS, U
from palmd.observer.pivot.arm_path import LEAST_SAMPLES, AxisPath, axis_path
from palmd.system.pivot import GripperSample, PivotEvent, PivotRig
from palmd.system.reasons import Code, Reason

IntArray = npt.NDArray[np.intp]

TAPS = 4  # spline coefficients that one instant depends on
SPACING_S = {"rigid": 0.03, "float": 0.012}
GAP_S = {"rigid": 0.15, "float": 0.5}  # gap in the readings after which the orientation is unknown
LEAST_TOUCH_S = 0.4
LEAST_READINGS = 25
LEAST_FORCE_N = 0.05
LANDING_S, HALTED_M_S2 = 0.35, 0.2  # beginning of a contact that is dropped if the gripper decelerates so much
LIFTED_M_S = 6e-3  # vertical velocity of lifting, faster than any drag


@dataclass(frozen=True, slots=True)
class Rows:
    """Readings of one kind at times t (n,): values, variances, kernel inputs, and their spline coefficients.

    first: index of the first of `TAPS` coefficients; weights (n, 3, TAPS): their weights in ψ, ω0, α0.
    """

    t: FloatArray
    value: FloatArray
    variance: FloatArray
    inputs: FloatArray
    first: IntArray
    weights: FloatArray


@dataclass(frozen=True, slots=True)
class TouchSpan:
    """One uninterrupted contact (s) and its uniform cubic spline with `count` coefficients from index `first`."""

    begin: float
    end: float
    first: int
    count: int

    @property
    def spacing(self) -> float:
        """Spacing of the spline's knots (s)."""
        return (self.end - self.begin) / (self.count - TAPS + 1)

    @property
    def coefficients(self) -> slice:
        """Its coefficients among all."""
        return slice(self.first, self.first + self.count)

    def contains(self, t: FloatArray) -> npt.NDArray[np.bool_]:
        """Which of the times t lie within the contact."""
        return (t >= self.begin) & (t <= self.end)

    def taps(self, t: FloatArray) -> tuple[IntArray, FloatArray]:
        """(first coefficient, weights (n, 3, TAPS)) at times t (n,) of the contact."""
        dt = self.spacing
        at = np.clip((t - self.begin) / dt, 0.0, self.count - TAPS + 1 - 1e-9)
        cell = np.floor(at).astype(np.intp)
        u = at - cell
        value = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], axis=1) / 6
        rate = np.stack([-((1 - u) ** 2), 3 * u**2 - 4 * u, -3 * u**2 + 2 * u + 1, u**2], axis=1) / (2 * dt)
        second = np.stack([1 - u, 3 * u - 2, 1 - 3 * u, u], axis=1) / dt**2
        return self.first + cell, np.stack([value, rate, second], axis=1)

    def through(self, t: FloatArray, values: FloatArray) -> FloatArray:
        """Coefficients of the spline through values at times t; least squares at three instants per cell."""
        at = np.linspace(self.begin, self.end, 3 * self.count)
        first, weights = self.taps(at)
        columns = first[:, None] - self.first + np.arange(TAPS)
        pattern = (columns.ravel(), np.arange(0, columns.size + 1, TAPS))
        A = csr_matrix((weights[:, 0].ravel(), *pattern), shape=(len(at), self.count))
        normal = A.T @ A
        banded = np.zeros((TAPS, self.count))
        for k in range(TAPS):
            banded[k, : self.count - k] = normal.diagonal(-k)
        banded[0] += 1e-9
        return np.asarray(solveh_banded(banded, A.T @ np.interp(at, t, values), lower=True))


@dataclass(frozen=True, slots=True)
class PivotRecord:
    """All rows of a run. torques: collocation of the slide's equation of motion; empty for a rigid gripper."""

    rig: PivotRig
    touches: tuple[TouchSpan, ...]
    readings: Rows
    heights: Rows
    forces: Rows
    torques: Rows

    @property
    def coefficients(self) -> int:
        """Number of coefficients of all splines."""
        return self.touches[-1].first + self.touches[-1].count

    def motion(self, c: FloatArray, rows: Rows) -> FloatArray:
        """(n, 3) ψ, ω0, α0 at the rows' times."""
        motion: FloatArray = np.einsum("nqk,nk->nq", rows.weights, c[rows.first[:, None] + np.arange(TAPS)])
        return motion


@dataclass(frozen=True, slots=True)
class ArmMotion:
    """Path of the pivot, x and z (used for a rigid gripper), and the measured heights at times t."""

    x: AxisPath
    z: AxisPath
    t: FloatArray
    height: FloatArray
    rig: PivotRig

    def inputs(self, t: FloatArray) -> FloatArray:
        """Kernel inputs (n, INPUTS) at times t."""
        u = np.zeros((len(t), INPUTS))
        u[:, [U.X, U.VX, U.AX]] = self.x.at(t).T
        u[:, [U.Z, U.VZ, U.AZ]] = self.z.at(t).T
        u[:, U.GRAVITY] = self.rig.gravity
        u[:, U.CARRIAGE], u[:, U.CARRIAGE_DAMPING] = self.rig.carriage_mass, self.rig.carriage_damping
        return u


class TooLittleError(Exception):
    """A record that does not determine an outline, for this `reason`."""

    def __init__(self, code: Code, text: str) -> None:
        super().__init__(text)
        self.reason = Reason(code, text)


def arm_motion(events: Sequence[PivotEvent], rig: PivotRig) -> ArmMotion:
    """Path of the pivot through its samples; raises TooLittleError."""
    samples = {each.t_sample: each for each in events if isinstance(each, GripperSample)}
    ordered = [samples[t] for t in sorted(samples)]
    if len(ordered) < LEAST_SAMPLES:
        raise TooLittleError(Code.NO_ARM_REPORTS, "the arm hardly reports the pivot's position")
    t, x = np.array([(each.t_sample, each.x) for each in ordered]).T
    heights = [each.z for each in ordered if each.z is not None]
    if len(heights) < len(ordered) or not rig.z_measured:
        text = "the pivot's height is not measured, which is needed for the size of the outline"
        raise TooLittleError(Code.NO_HEIGHT, text)
    z = np.array(heights)
    noise = rig.arm_noise
    along_x = axis_path(t, x, [each.vx for each in ordered], [each.ax for each in ordered], noise)
    along_z = axis_path(t, z, [each.vz for each in ordered], [each.az for each in ordered], noise)
    return ArmMotion(along_x, along_z, t, z, rig)


def lay_out(events: Sequence[PivotEvent], arm: ArmMotion, rig: PivotRig) -> PivotRecord:
    """Lay out a run; raises TooLittleError if no contact is long enough."""
    found = _touches(events, arm, rig)
    if not found:
        raise TooLittleError(Code.UNTOUCHED, "the pad is never touched for long enough")
    spacing = SPACING_S[rig.vertical]
    touches: list[TouchSpan] = []
    first = 0
    for samples in found:
        begin, end = samples[0].t_sample, samples[-1].t_sample
        count = max(math.ceil((end - begin) / spacing), TAPS) + TAPS - 1
        touches.append(TouchSpan(begin, end, first, count))
        first += count
    pads = [sample for samples in found for sample in samples]
    t, s = np.array([(each.t_sample, each.s) for each in pads]).T
    readings = _rows(touches, arm, t, s, np.full(len(t), rig.pad.reading_variance))
    pressed = [each for each in pads if each.force is not None]
    force = np.array([each.force for each in pressed], dtype=np.float64)
    t = np.array([each.t_sample for each in pressed])
    level = np.maximum(_running_median(force), LEAST_FORCE_N)
    forces = _rows(touches, arm, t, force, np.asarray(rig.pad.force_variance(level)))
    return PivotRecord(
        rig, tuple(touches), readings, _heights(touches, arm, rig), forces, _torques(touches, arm, rig, force)
    )


def _touches(events: Sequence[PivotEvent], arm: ArmMotion, rig: PivotRig) -> list[list[PadSample]]:
    """The pad's readings, split into contacts at gaps, without contacts that are too short."""
    pads = sorted((each for each in events if isinstance(each, PadSample)), key=lambda each: each.t_sample)
    pads = [each for each in pads if arm.t[0] <= each.t_sample <= arm.t[-1]]
    parts: list[list[PadSample]] = []
    for sample in pads:
        if not parts or sample.t_sample - parts[-1][-1].t_sample > GAP_S[rig.vertical]:
            parts.append([])
        if not parts[-1] or sample.t_sample > parts[-1][-1].t_sample:
            parts[-1].append(sample)
    parts = [landed for part in parts if (landed := _landed(part, arm))]
    return [
        part for part in parts if part[-1].t_sample - part[0].t_sample >= LEAST_TOUCH_S and len(part) >= LEAST_READINGS
    ]


def _landed(part: list[PadSample], arm: ArmMotion) -> list[PadSample]:
    """A contact without its beginning if the gripper decelerated there, and without a fast lift-off at its end.

    The splines cannot follow such fast motion.
    """
    begin = part[0].t_sample
    t = np.linspace(begin, begin + LANDING_S, 100)
    halted = max(float(np.abs(axis.at(t)[2]).max()) for axis in (arm.x, arm.z)) > HALTED_M_S2
    slow = np.flatnonzero(arm.z.at(np.array([each.t_sample for each in part]))[1] < LIFTED_M_S)
    kept = part[: slow[-1] + 1] if len(slow) else []
    return [each for each in kept if each.t_sample > begin + LANDING_S] if halted else kept


def _heights(touches: Sequence[TouchSpan], arm: ArmMotion, rig: PivotRig) -> Rows:
    if rig.vertical == "float":
        inside = np.logical_or.reduce([touch.contains(arm.t) for touch in touches])
        t, z = arm.t[inside], arm.height[inside]
        return _rows(touches, arm, t, z, np.full(len(t), rig.arm_noise**2))
    times, heights = [], []
    for touch in touches:
        fine = np.linspace(touch.begin, touch.end, 6 * touch.count)
        coefficients = touch.through(fine, arm.z.at(fine)[0])
        t = np.linspace(touch.begin, touch.end, 2 * (touch.count - TAPS) + 3)
        first, weights = touch.taps(t)
        times.append(t)
        heights.append((weights[:, 0] * coefficients[first[:, None] - touch.first + np.arange(TAPS)]).sum(axis=1))
    t = np.concatenate(times)
    return _rows(touches, arm, t, np.concatenate(heights), np.full(len(t), RIGID_SD_M**2))


# 1σ of a rigid gripper's height about the splines. Its path is smooth, whatever its error. If the splines could deviate
# by micrometres, their acceleration would follow the forces' noise, and an inertia of ten times the true one would
# explain that. Where the gripper stops faster than the splines can follow, the least-squares spline is used.
RIGID_SD_M = 2e-8

TORQUE_SD_M = 2e-5  # 1σ of the slide's residual torque over force, at each instant


def _torques(touches: Sequence[TouchSpan], arm: ArmMotion, rig: PivotRig, force: FloatArray) -> Rows:
    none: FloatArray = np.zeros(0)
    if rig.vertical == "rigid":
        return _rows(touches, arm, none, none, none)
    times = []
    for touch in touches:
        cells = touch.begin + touch.spacing * np.arange(touch.count - TAPS + 1)
        times.append(np.add.outer(cells, touch.spacing * np.array([0.2113, 0.7887])).ravel())  # Gauss's
    t = np.concatenate(times)
    weight = float(np.median(force)) if len(force) else (rig.carriage_mass + 0.08) * rig.gravity
    return _rows(touches, arm, t, np.zeros(len(t)), np.full(len(t), (TORQUE_SD_M * weight) ** 2))


def _rows(touches: Sequence[TouchSpan], arm: ArmMotion, t: FloatArray, value: FloatArray, variance: FloatArray) -> Rows:
    first, weights = np.zeros(len(t), dtype=np.intp), np.zeros((len(t), 3, TAPS))
    for touch in touches:
        mine = touch.contains(t)
        first[mine], weights[mine] = touch.taps(t[mine])
    return Rows(t, value, variance, arm.inputs(t), first, weights)


def _running_median(values: FloatArray, reach: int = 10) -> FloatArray:
    if len(values) <= 2 * reach:
        return np.full(len(values), float(np.median(values)) if len(values) else 0.0)
    padded = np.pad(values, reach, mode="edge")
    medians: FloatArray = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1), axis=1)
    return medians
