"""Simulated logs of three palms in space: reports of pads and joints while bodies move, with the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from palmd.events import FloatArray
from palmd.rig.three_palms.bodies import Bodies, random_bodies, random_rotation, spread_directions
from palmd.rig.three_palms.plant import BodyOnPalms, FrictionParameters, palm_rows
from palmd.rig.three_palms.world import REST_POSE, SETTLING_DRAG, SETTLING_S
from palmd.system.three_palms import MECHANISM, PALMS, SYSTEM, ThreePalmsRig, palms_at, readings_of

STEP_S = 2e-3
EASE_S = 1.0  # duration of a motion's smooth start
SINES = 3
REPORT_S = 0.016
PAD_INTERVAL_S, PAD_JITTER_S, LEAST_INTERVAL_S = 0.01, 0.003, 0.004
TRUTH_EVERY = 10  # steps


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of run: ranges of μ and drag (m²/s), the joints' amplitude (rad) and highest frequency (Hz).

    spin: 1σ of the initial spin (rad/s), of a body that is not in equilibrium; 0: it starts at rest. vibration_hz:
    range of the palms' frequencies if their vibration is resolved; else it is averaged.
    """

    mu: tuple[float, float]
    drag: tuple[float, float]
    amplitude: float = 0.3
    frequency: float = 0.5
    spin: float = 0.0
    vibration_hz: tuple[float, float] | None = None


KINDS: Mapping[str, Kind] = {
    "friction": Kind((0.05, 0.2), (0.0, 0.0)),
    "vibrating": Kind((0.05, 0.2), (0.0, 0.0), vibration_hz=(200.0, 280.0)),
    "large": Kind((0.05, 0.2), (0.0, 0.0), amplitude=0.55, frequency=0.3),
    "drag": Kind((0.0, 0.0), (1e-4, 4e-4)),
    "free": Kind((0.0, 0.0), (0.0, 0.0)),
    "released": Kind((0.0, 0.0), (0.0, 0.0), spin=1.0),
}


@dataclass(frozen=True, slots=True)
class SimulatedBody:
    """One body's run: the log's lines, the truth, and how long all palms kept contact (s)."""

    lines: list[dict[str, Any]]
    truth: dict[str, Any]
    held: float


class _Joints:
    """Joint angles of B rigs: sines about the rest pose with a smooth start."""

    def __init__(self, kind: Kind, count: int, random: np.random.Generator) -> None:
        shares = random.dirichlet(np.ones(SINES), (count, 3))
        self._amplitude = kind.amplitude * shares * random.uniform(0.75, 1.0, (count, 3, 1))
        self._speed = 2 * np.pi * random.uniform(0.2 * kind.frequency, kind.frequency, (count, 3, SINES))
        self._phase = random.uniform(0, 2 * np.pi, (count, 3, SINES))

    def along(self, t: FloatArray) -> list[FloatArray]:
        """Angles, rates, accelerations (T, B, 3) at times t (T,)."""
        x = np.clip(t / EASE_S, 0.0, 1.0)
        window = np.array([10 * x**3 - 15 * x**4 + 6 * x**5, 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)])
        e0, e1, e2 = (each[:, None, None] / EASE_S**k for k, each in enumerate(window))
        angle = self._speed * t[:, None, None, None] + self._phase
        waves = [
            (self._amplitude * wave).sum(-1)
            for wave in (np.sin(angle), self._speed * np.cos(angle), -(self._speed**2) * np.sin(angle))
        ]
        return [
            REST_POSE + e0 * waves[0],
            e1 * waves[0] + e0 * waves[1],
            e2 * waves[0] + 2 * e1 * waves[1] + e0 * waves[2],
        ]


def simulate(kind: str, count: int, seconds: float, seed: int) -> list[SimulatedBody]:
    """`count` runs of one kind, each with its own body and motion; deterministic for a seed."""
    described, ranges = ThreePalmsRig(), KINDS[kind]
    random = np.random.default_rng([seed, sum(map(ord, kind))])
    bodies = random_bodies(count, random)
    joints = _Joints(ranges, count, random)
    rubbing = FrictionParameters(
        random.uniform(*ranges.mu, count), random.uniform(8e-3, 1.2e-2, count), random.uniform(*ranges.drag, count)
    )
    steps = round(seconds / STEP_S)
    halves: FloatArray = np.asarray(0.5 * STEP_S * np.arange(2 * steps + 1), np.float64)
    motion = joints.along(halves)
    points, forces = np.empty((count, steps + 1, 3, 3)), np.empty((count, steps + 1, 3))
    states = np.empty((count, steps + 1, 18))
    for b, start in enumerate(initial_states(bodies, rubbing, ranges, random, described.gravity)):
        frequencies = None if ranges.vibration_hz is None else tuple(random.uniform(*ranges.vibration_hz, len(PALMS)))
        plant = _alone(bodies, rubbing, b, described.gravity, frequencies)
        palms = palm_rows(palms_at(*(each[:, b] for each in motion)))
        plant.state[:] = start
        for k in range(steps + 1):
            plant.advance(palms[2 * k - 2 : 2 * k + 1] if k else palms[[0, 0, 0]], STEP_S if k else 0.0)
            points[b, k], forces[b, k], states[b, k] = plant.point, plant.force, plant.state
    whole = [each[::2] for each in motion]
    return _logs(described, bodies, rubbing, whole, points, forces, states[:, ::TRUTH_EVERY], random, (kind, seed))


def _alone(
    bodies: Bodies,
    rubbing: FrictionParameters,
    which: int,
    gravity: float,
    frequencies: tuple[float, ...] | None = None,
) -> BodyOnPalms:
    one = np.array([which])
    rubs = FrictionParameters(*(getattr(rubbing, name)[one] for name in FrictionParameters.__dataclass_fields__))
    return BodyOnPalms(bodies.select(one), rubs, gravity, frequencies=frequencies)


def initial_states(
    bodies: Bodies, rubbing: FrictionParameters, kind: Kind, random: np.random.Generator, gravity: float
) -> FloatArray:  # fmt: skip
    """Initial states (B, 18): at rest in a stable pose reached with strong drag, or out of equilibrium with a spin."""
    count = len(bodies.ball)
    R = random_rotation(random, count)
    still = np.zeros((1, 3))
    at = palms_at(REST_POSE[None], still, still)
    normal = at.normal[0]
    h, x, _ = bodies.support(-np.einsum("bji,nj->bni", R, normal))
    centre = np.linalg.solve(normal, h[..., None])[..., 0]
    spin = velocity = np.zeros((count, 3))
    if kind.spin > 0.0:
        spin = random.normal(0.0, kind.spin, (count, 3))
        r = np.einsum("bij,bnj->bni", R, x)
        lift = (r * np.cross(spin[:, None], normal)).sum(-1)
        velocity = np.linalg.solve(normal, lift[..., None])[..., 0]
    states: FloatArray = np.concatenate([centre, velocity, R.reshape(count, 9), spin], axis=1)
    if kind.spin == 0.0:
        slow = FrictionParameters(0 * rubbing.mu, rubbing.dither, np.full(count, SETTLING_DRAG))
        palms = np.tile(palm_rows(at), (3, 1))
        for b, state in enumerate(states):
            plant = _alone(bodies, slow, b, gravity)
            plant.state[:] = state
            for _ in range(round(SETTLING_S / STEP_S)):
                plant.advance(palms, STEP_S)
            state[:] = plant.state
        states[:, 3:6] = states[:, 15:] = 0.0
    return states


def _logs(
    rig: ThreePalmsRig, bodies: Bodies, rubbing: FrictionParameters, motion: list[FloatArray],
    points: FloatArray, forces: FloatArray, kept: FloatArray, random: np.random.Generator, drawn: tuple[str, int],
) -> list[SimulatedBody]:  # fmt: skip
    """Readings and truth from all bodies' contacts, forces and states; motion of the joints: (T, B, 3) each.

    drawn: kind and seed.
    """
    count, steps = len(bodies.ball), points.shape[1] - 1
    t: FloatArray = np.asarray(STEP_S * np.arange(steps + 1), np.float64)
    truth_t = t[::TRUTH_EVERY]
    runs = []
    for b in range(count):
        lost = np.flatnonzero((forces[b] <= 0.0).any(-1) | ~np.isfinite(forces[b]).all(-1))
        held = float(t[lost[0]]) if len(lost) else float(t[-1])
        mass = float(random.uniform(0.03, 0.15))
        mine = [each[:, b] for each in motion]
        palms = palms_at(*mine)
        lines = _joint_lines(rig, t, mine, random)
        read = readings_of(palms, points[b])
        for pad in range(len(PALMS)):
            lines += _pad_lines(rig, pad, t, read[:, pad], mass * forces[b, :, pad], random)
        lines = sorted((line for line in lines if line["t"] < held), key=lambda line: line["t"])
        R = kept[b, :, 6:15].reshape(-1, 3, 3)
        normals = palms.normal[::TRUTH_EVERY]
        directions = spread_directions(2000)
        truth = {
            "kind": drawn[0], "seed": drawn[1], "body": b, "held_s": held,
            "directions": directions.tolist(),
            "h_m": bodies.select(np.array([b])).support(directions[None])[0][0].tolist(),
            "inertia_m2": bodies.inertia[b].tolist(), "mass_kg": mass,
            "mu": float(rubbing.mu[b]), "dither_m_s": float(rubbing.dither[b]),
            "vibration_m_s": float(2.0 / np.pi * rubbing.dither[b]), "drag_m2_s": float(rubbing.drag[b]),
            "t": truth_t.tolist(),
            "rotation": R.tolist(),
            "omega_rad_s": kept[b, :, 15:].tolist(),
            "com_m": kept[b, :, :3].tolist(),
            "normals_body": (-np.einsum("tji,tnj->tni", R, normals)).tolist(),
        }  # fmt: skip
        runs.append(SimulatedBody([header(rig), *lines], truth, held))
    return runs


def header(rig: ThreePalmsRig) -> dict[str, Any]:
    """Line 1 of a log of this exactly known rig."""
    names = ("zero_m", "scale", "angle_rad", "standoff_m", "lag_s", "gravity_rad", "sagitta_m")
    return {
        "palmd_log": 1,
        "rig": {
            "system": SYSTEM,
            "mechanism": MECHANISM,
            "gravity_m_s2": rig.gravity,
            "pad": {"side_m": rig.pad.side, "noise_m": rig.pad.noise, "resolution_m": rig.pad.resolution},
            "palm_angle_noise_rad": rig.angle_noise,
            "force_scale_std": rig.pad.force_scale_std,
            "calibration_sd": dict.fromkeys(names, 0.0),
            "vibration": {"relation": "independent"},
        },
    }


def _joint_lines(
    rig: ThreePalmsRig, t: FloatArray, motion: list[FloatArray], random: np.random.Generator
) -> list[dict[str, Any]]:
    every = round(REPORT_S / STEP_S)
    angle, rate, acceleration = (each[::every] for each in motion)
    measured = angle + rig.angle_noise * random.normal(size=angle.shape)
    return [
        {"t": float(at), "joints": {"angle_rad": a.tolist(), "rate_rad_s": r.tolist(), "acc_rad_s2": c.tolist()}}
        for at, a, r, c in zip(t[::every], measured, rate, acceleration, strict=True)
    ]


def _pad_lines(
    rig: ThreePalmsRig, pad: int, t: FloatArray, read: FloatArray, force: FloatArray, random: np.random.Generator
) -> list[dict[str, Any]]:
    gaps = PAD_INTERVAL_S + PAD_JITTER_S * random.normal(size=round(t[-1] / PAD_INTERVAL_S) + 50)
    times = np.cumsum(np.maximum(gaps, LEAST_INTERVAL_S))
    times = times[times < t[-1]]
    resolution = rig.pad.resolution
    value = np.stack([np.interp(times, t, read[:, k]) for k in range(2)], axis=1)
    value = resolution * np.round((value + rig.pad.noise * random.normal(size=value.shape)) / resolution)
    measured = np.interp(times, t, force) * (1.0 + rig.pad.force_scale_std * random.normal(size=times.shape))
    return [
        {"t": float(at), "pad": pad + 1, "a_m": float(a), "b_m": float(b), "force_n": float(f)}
        for at, (a, b), f in zip(times, value, measured, strict=True)
    ]
