"""Simulated event logs of the pivoting grasp with their truth: an object turning freely in a gripper over one pad.

tilt   the gripper is rigid; each side of the dead centre is touched once, with a detour of the arm in between
float  the gripper moves vertically in a slide, loaded by its weight, while the arm drags it back and forth
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from palmd.events import FloatArray
from palmd.rig.pivot import GRAVITY, Axis, Grasp, Slide
from palmd.rig.shapes import random_body

Line = dict[str, Any]
Span = tuple[float, float]
PivotKind = Literal["tilt", "float"]
PIVOT_KINDS: tuple[PivotKind, ...] = get_args(PivotKind)

STEP_S = 5e-4
_ROW_S, _COARSE_S = 2e-3, 4e-2
_ARM_PERIOD_S = 0.016
_PAD_M = 0.0555
_MARGIN_M = 3.5e-3
_BANDS_S, _WEIGHTS = (0.00625, 0.0125, 0.01875), (0.55, 0.30, 0.15)
_LEAST_N, _MOST_N = 0.05, 2.5
_GAP_S = 0.2  # silence of the pad
_ROUND_S = 1.0  # duration of the arm's detour from one touch to the next
LEAST_S = 2.0  # shortest run: shorter drags cannot be tracked
_COLUMNS = ("t", "psi_rad", "omega0_rad_s", "s1_m", "z_m", "e_m", "f1_n", "touch")


@dataclass(frozen=True, slots=True)
class PivotImperfections:
    """Differences of a run's readings from the rig described in line 1; none by default.

    outliers: share of readings at a random position on the pad. gaps: number of times the pad is silent for `_GAP_S`.
    noise, force_noise: factors on the noise. coulomb: friction without vibration, by tanh(u/u_d).
    """

    outliers: float = 0.0
    gaps: int = 0
    noise: float = 1.0
    force_noise: float = 1.0
    coulomb: bool = False


AS_DESCRIBED = PivotImperfections()


@dataclass(frozen=True, slots=True)
class SimulatedPivot:
    """A grasp, the arm's plan along x and z (z: rigid only), and the true history."""

    kind: PivotKind
    grasp: Grasp
    x: Callable[[float], Axis]
    z: Callable[[float], Axis] | None
    history: FloatArray  # rows of _COLUMNS


def simulate_pivot_log(
    kind: PivotKind,
    seed: int,
    duration_s: float = 12.0,
    flaws: PivotImperfections = AS_DESCRIBED,
) -> tuple[list[Line], Line]:
    """A run as event-log lines (header first), and its truth; the same seed gives the same run.

    Runs that wedge, lift off, press harder than
    `_MOST_N` or leave the pad are drawn again. Raises ValueError for less than `LEAST_S`.
    """
    if not LEAST_S <= duration_s < math.inf:
        raise ValueError(f"a run must last at least {LEAST_S:g} s, not {duration_s:g} s")
    rng = np.random.default_rng([7, PIVOT_KINDS.index(kind), seed])
    while True:
        run = _tilt(rng, duration_s, flaws) if kind == "tilt" else _float(rng, duration_s, flaws)
        if run is not None:
            return _log(run, flaws, rng), _truth(run)


def _grasp(rng: np.random.Generator, flaws: PivotImperfections, least: float, most: float, mu: Span) -> Grasp:
    body = random_body("friction", rng)
    body = replace(body, mass=float(rng.uniform(0.04, 0.12)))
    far, angle = float(rng.uniform(least, most)), float(rng.uniform(0.0, math.tau))
    pivot = (far * math.cos(angle), far * math.sin(angle))
    friction = float(rng.uniform(*mu))
    dither, damping = float(rng.uniform(8e-3, 20e-3)), float(rng.uniform(1e-5, 4e-5))
    return Grasp(body, pivot, friction, dither, damping, coulomb=flaws.coulomb)


# ------------------------------------------------------------------------------------------------------ rigid


def _tilt(rng: np.random.Generator, duration: float, flaws: PivotImperfections) -> SimulatedPivot | None:
    grasp = _grasp(rng, flaws, 5e-3, 9e-3, (0.05, 0.2))
    angles = np.linspace(-math.pi, math.pi, 1441)
    heights = np.array([grasp.height(a) for a in angles])
    top, bottom = heights.max(), heights.min()
    high = top - float(rng.uniform(0.10, 0.24)) * (top - bottom)
    low = bottom + float(rng.uniform(0.05, 0.20)) * (top - bottom)
    each = (duration - _ROUND_S) / 2
    drags = [_dragged(rng, each) for _ in range(2)]
    z = _lowered(high, low, each)
    offsets = np.array([grasp.offset(a) for a in angles])
    order = [1.0, -1.0] if rng.random() < 0.5 else [-1.0, 1.0]
    rows: list[tuple[float, ...]] = []
    turned = 0.0
    for side, drag in enumerate(drags):
        wanted = np.flatnonzero((np.diff(np.sign(heights - high)) != 0) & (np.sign(offsets[1:]) == order[side]))
        if not len(wanted):
            return None
        psi = float(angles[wanted[0]])
        begin = side * (each + _ROUND_S)
        if side == 0:
            turned = psi
        elif rows:
            rows += [(begin - _ROUND_S + k * 1e-2, rows[-1][1], 0, math.nan, high, 0, 0, 0) for k in range(1, 100)]
        start = (begin, psi, order[side])
        # most draws fail somewhere: check with coarse steps first
        if _touched(grasp, drag, z, each, start, _COARSE_S) is None:
            return None
        touched = _touched(grasp, drag, z, each, start, _ROW_S)
        if touched is None:
            return None
        rows += touched
    history = np.array(rows)
    history[:, 1] -= turned
    turned_grasp = replace(grasp, body=grasp.body.turned(turned), pivot=grasp.arm(turned))

    def both(plan: list[Callable[[float], Axis]]) -> Callable[[float], Axis]:
        def at(t: float) -> Axis:
            if t <= each:
                return plan[0](t)
            if t >= each + _ROUND_S:
                return plan[1](min(t - each - _ROUND_S, each))
            begin, end = plan[0](each)[0], plan[1](0.0)[0]
            w, dw, ddw = _smooth_step((t - each) / _ROUND_S)
            return begin + (end - begin) * w, (end - begin) * dw / _ROUND_S, (end - begin) * ddw / _ROUND_S**2

        return at

    return SimulatedPivot("tilt", turned_grasp, both(drags), both([z, z]), history)


def _touched(
    grasp: Grasp,
    x: Callable[[float], Axis],
    z: Callable[[float], Axis],
    duration: float,
    start: tuple[float, float, float],
    step: float,
) -> list[tuple[float, ...]] | None:
    """Rows of `_COLUMNS` of one touch; `start`: its time, orientation and side of the dead centre; None if it fails."""
    begin, psi, side = start
    rows: list[tuple[float, ...]] = []
    for k in range(round(duration / step) + 1):
        t = k * step
        at_x, at_z = x(t), z(t)
        for _ in range(20):
            e = grasp.offset(psi)
            if e * side < 1e-3:
                return None
            error = at_z[0] - grasp.height(psi)
            psi -= error / e  # dz/dψ = −e
            if abs(error) < 1e-13:
                break
        e = grasp.offset(psi)
        omega = -at_z[1] / e
        h2 = grasp.body.support.at(-0.5 * math.pi - psi)[2] - grasp.arm(psi)[1]
        alpha = (h2 * omega * omega - at_z[2]) / e
        force = grasp.rigid_contact_force(psi, omega, alpha, at_x, at_z)
        s = at_x[0] + e
        if not (_LEAST_N < force < _MOST_N and _MARGIN_M < s < _PAD_M - _MARGIN_M):
            return None
        rows.append((begin + t, psi, omega, s, at_z[0], e, force, 1.0))
    return rows


def _lowered(high: float, low: float, each: float) -> Callable[[float], Axis]:
    """A motion from `high` to `low` and back, at rest at both ends and in the middle."""
    return _in_two_legs(each, (high, low - high), (low, high - low))


def _dragged(rng: np.random.Generator, each: float) -> Callable[[float], Axis]:
    """A motion in two legs, to a random point and from there to another."""
    start = float(rng.uniform(0.008, 0.047))
    ways = [float(rng.uniform(-0.032, 0.032)) for _ in range(2)]
    return _in_two_legs(each, (start, ways[0]), (start + ways[0], ways[1]))


def _in_two_legs(each: float, *legs: tuple[float, float]) -> Callable[[float], Axis]:
    """A motion along two legs, each a start and a way, that lasts `each` (s)."""
    half = each / 2

    def at(t: float) -> Axis:
        first = t <= half
        w, dw, ddw = _smooth_step((t if first else t - half) / half)
        begin, way = legs[0] if first else legs[1]
        return begin + way * w, way * dw / half, way * ddw / half**2

    return at


def _smooth_step(u: float) -> Axis:
    """The smooth step on 0…1, its first and second derivative."""
    u = min(max(u, 0.0), 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u * u), 30.0 * u * u * (1.0 - u) ** 2, 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)


# ------------------------------------------------------------------------------------------------------ sliding


def _float(rng: np.random.Generator, duration: float, flaws: PivotImperfections) -> SimulatedPivot | None:
    grasp = _grasp(rng, flaws, 0.5e-3, 3e-3, (0.25, 0.4))
    carriage = grasp.body.mass * float(rng.uniform(0.8, 2.0))
    grasp = replace(grasp, carriage=carriage, carriage_damping=carriage * float(rng.uniform(1.0, 2.0)))
    f1, f2 = float(rng.uniform(0.12, 0.3)), float(rng.uniform(0.25, 0.45))
    a1, a2 = float(rng.uniform(0.010, 0.020)), float(rng.uniform(0.004, 0.010))
    p1, p2 = (float(rng.uniform(0.0, math.tau)) for _ in range(2))

    def x(t: float) -> Axis:
        w, dw, ddw = _smooth_step(t)
        value = rate = acceleration = 0.0
        for a, f, p in ((a1, f1, p1), (a2, f2, p2)):
            k = math.tau * f
            s, c = math.sin(k * t + p) - math.sin(p), math.cos(k * t + p)
            value += a * w * s
            rate += a * (dw * s + w * k * c)
            acceleration += a * (ddw * s + 2 * dw * k * c - w * k * k * (s + math.sin(p)))
        return 0.0277 + value, rate, acceleration

    psi = float(rng.uniform(-math.pi, math.pi))
    grasp = replace(grasp, body=grasp.body.turned(psi), pivot=grasp.arm(psi))
    slide, rows = Slide(grasp, 0.0), list[tuple[float, ...]]()
    for k in range(round(duration / STEP_S) + 1):
        t = k * STEP_S
        now = x(t)
        if k % 4 == 0:  # each _ROW_S
            e, force = grasp.offset(slide.psi), grasp.motion(slide.psi, slide.omega, now)[1]
            s = now[0] + e
            if not (force > _LEAST_N and _MARGIN_M < s < _PAD_M - _MARGIN_M):
                return None
            rows.append((t, slide.psi, slide.omega, s, grasp.height(slide.psi), e, force, 1.0))
        if math.isnan(slide.advance(now, x(t + STEP_S), STEP_S, x(t + STEP_S / 2))):
            return None
    return SimulatedPivot("float", grasp, x, None, np.array(rows))


# ------------------------------------------------------------------------------------------------------ the log


def _log(run: SimulatedPivot, flaws: PivotImperfections, rng: np.random.Generator) -> list[Line]:
    grasp, history = run.grasp, run.history
    end = float(history[-1, 0])
    gripper: Line = {"vertical": "rigid" if run.z else "float", "z_measured": True}
    if run.z is None:
        gripper |= {"carriage_mass_kg": round(grasp.carriage, 5), "damping_n_s_m": round(grasp.carriage_damping, 5)}
    rig: Line = {
        "system": "pivot",
        "gravity_m_s2": GRAVITY,
        "gripper": gripper,
        "pad": {"length_m": _PAD_M, "noise_m": 1e-4, "resolution_m": 1.27e-4},
        "arm_noise_m": 2e-5,
        "force_scale_std": 0.05,
        "calibration_sd": dict.fromkeys(("zero_m", "scale", "angle_rad", "standoff_m", "lag_s", "gravity_rad"), 0.0),
        "vibration": {"relation": "none" if grasp.coulomb else "independent"},
    }
    events: list[Line] = []
    for t in np.arange(int(end / _ARM_PERIOD_S)) * _ARM_PERIOD_S:
        x, z = run.x(t), run.z(t) if run.z else (float(np.interp(t, history[:, 0], history[:, 4])), 0.0, 0.0)
        noise = rng.normal(0.0, 2e-5, 2)
        arm = {"x_m": x[0] + noise[0], "z_m": z[0] + noise[1], "vx_m_s": x[1], "ax_m_s2": x[2]}
        if run.z:
            arm |= {"vz_m_s": z[1], "az_m_s2": z[2]}
        events.append({"t": round(float(t), 6), "arm": {name: round(float(value), 7) for name, value in arm.items()}})
    count = int(end / 0.005)
    steps = np.maximum(rng.choice(_BANDS_S, count, p=_WEIGHTS) + rng.normal(0.0, 2e-3, count), 1e-4)
    times = float(rng.uniform(0.0, 0.01)) + np.cumsum(steps) - steps[0]
    times = times[times < end - 0.02]
    for begin in rng.uniform(0.0, end, flaws.gaps):
        times = times[(times < begin) | (times > begin + _GAP_S)]
    touch = np.interp(times, history[:, 0], history[:, 7])
    times = times[touch > 0.999]
    s, force = (np.interp(times, history[:, 0], history[:, i]) for i in (3, 6))
    s = s + rng.normal(0.0, 1e-4 * flaws.noise, len(s))
    thrown = rng.random(len(s)) < flaws.outliers
    s[thrown] = rng.uniform(0.0, _PAD_M, int(thrown.sum()))
    s = np.round(s / 1.27e-4) * 1.27e-4
    force = np.maximum(np.round(force * (1 + rng.normal(0, 0.05 * flaws.force_noise, len(s))) / 0.02) * 0.02, 0.0)
    for t, s_m, force_n in zip(times.tolist(), s.tolist(), force.tolist(), strict=True):
        events.append({"t": round(t, 6), "pad": 1, "s_m": round(s_m, 6), "force_n": round(force_n, 2)})
    return [{"palmd_log": 1, "rig": rig}, *sorted(events, key=_time_of)]


def _time_of(line: Line) -> float:
    return float(line["t"])


def _truth(run: SimulatedPivot) -> Line:
    grasp, history = run.grasp, run.history
    theta: FloatArray = np.arange(360, dtype=np.float64) * (math.tau / 360)
    h = grasp.body.support.sample(theta)
    px, py = grasp.pivot
    return {
        "kind": run.kind,
        "shape": grasp.body.shape,
        "rho_m": grasp.body.rho,
        "mass_kg": grasp.body.mass,
        "mu": grasp.mu,
        "dither_m_s": grasp.dither,
        "vibration_m_s": None if grasp.coulomb else grasp.vibration,
        "pivot_damping_m2_s": grasp.damping,
        "carriage_ratio": grasp.carriage / grasp.body.mass or None,
        "pivot_m": [px, py],
        "theta_rad": theta.tolist(),
        "h_m": h.tolist(),
        "hP_m": (h - px * np.cos(theta) - py * np.sin(theta)).tolist(),
    } | dict(zip(_COLUMNS, history[::5].T.tolist(), strict=True))
