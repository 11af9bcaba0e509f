"""Scenes for engines, drawn by a seed: a body on two flat palms that rock and vibrate; and event logs of their results.

Kinds: `vibrating` (independent), `in_phase`, `antiphase` (dry friction on vibrating palms), `slick` (no friction),
`dry` (friction on palms without vibration, whose plan has a dither of 0.1° at 10 Hz). SI units.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, Protocol, get_args

import numpy as np

from palmd.config.two_palms import DrawnImperfections
from palmd.events import FloatArray, PalmMotion
from palmd.rig.ellipses import Ellipse, ellipse_of
from palmd.rig.imperfections import drawn
from palmd.rig.plant import PAD_LENGTH, BodyState, FrictionSurface, Hinge, Plant, palm_frame, stable_poses
from palmd.rig.shaker import STILL, drawn_shaking
from palmd.rig.shapes import Body, ellipse, uniform_body_of, with_slug
from palmd.rig.simulate import (
    CALIBRATION,
    STEP_S,
    Line,
    Rocking,
    SimulatedRun,
    draw_rock,
    log_lines,
    smooth_step,
    smoothed,
    truth_of,
)
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS
from palmd.system.vibration import Relation, Vibration

EngineKind = Literal["vibrating", "in_phase", "antiphase", "slick", "dry"]
ENGINE_KINDS: tuple[EngineKind, ...] = get_args(EngineKind)
_RELATIONS: Mapping[EngineKind, Relation] = {
    "vibrating": "independent", "in_phase": "in_phase", "antiphase": "antiphase", "slick": "independent", "dry": "none",
}  # fmt: skip
_MU, _SPEED_M_S = (0.05, 0.3), (0.010, 0.020)
_DITHER_RAD, _DITHER_HZ = math.radians(0.1), 10.0
_RELEASE_RAD = (0.12, 0.5)
_MEAN_RADIUS_M, _RATIO = (16e-3, 24e-3), (0.75, 0.92)
_MASS_KG = (0.06, 0.25)
_STREAM = 0x656E67  # random stream, distinct from that of `rig.simulate`
_MARGIN_M, _LEAST_N = 3e-3, 1e-3
_LOST_ROWS = 10  # without any contact


@dataclass(frozen=True, slots=True)
class DitheredRocking(Rocking):
    """Both palms' motion with a plan's dither of both angles, which grows during the first second."""

    def at(self, t: float) -> PalmMotion:
        """Angles, rates, accelerations of both palms at t (s)."""
        palms, (w, dw, ddw), k = Rocking.at(self, t), smooth_step(t), math.tau * _DITHER_HZ
        s, c = _DITHER_RAD * math.sin(k * t), _DITHER_RAD * math.cos(k * t)
        more = (w * s, dw * s + w * k * c, ddw * s + 2.0 * dw * k * c - w * k * k * s)
        return PalmMotion(*(tuple(each + m for each in mine) for mine, m in zip(
            (palms.angles, palms.rates, palms.accelerations), more, strict=True)))  # fmt: skip


@dataclass(frozen=True, slots=True)
class EngineScene:
    """A run to simulate, which begins at rest at `start`; `ellipse` is the body's outline as an engine's primitive."""

    kind: EngineKind
    run: SimulatedRun
    ellipse: Ellipse
    start: BodyState

    def palms_at(self, t: float) -> PalmMotion:
        """True motion of the palms at t (s)."""
        return self.run.palms_at(t)

    @property
    def frictions(self) -> tuple[float, float]:
        """Of both palms."""
        asymmetry, mu = self.run.imperfections.friction, self.run.surface.mu
        return mu * (1.0 + asymmetry), mu * (1.0 - asymmetry)

    @property
    def heights(self) -> tuple[float, ...]:
        """Of both palms over the hinge (m)."""
        return tuple(pad.standoff for pad in self.run.imperfections.pads)


class EngineRun(NamedTuple):
    """Columns of a run, a row each `STEP_S` from t = 0, the engine's body, and its deepest penetration (m).

    x, y, psi, omega0: of the body; f1, f2: normal forces (N), means over the previous step.
    """

    body: Body
    x: FloatArray
    y: FloatArray
    psi: FloatArray
    omega0: FloatArray
    f1: FloatArray
    f2: FloatArray
    penetration: float


class PalmStep(NamedTuple):
    """One palm in a step of an engine: direction (rad) and outward displacement (m) at the start of the step.

    rate (rad/s) and speed (m/s, outwards) are those at the middle of the step.
    """

    angle: float
    rate: float
    moved: float
    speed: float


def palm_steps(scene: EngineScene, row: int, steps: int) -> Iterator[list[PalmStep]]:
    """Both palms in each of the `steps` between two rows; accelerations are constant in between."""
    motion, dt = scene.palms_at(row * STEP_S), STEP_S / steps
    turns = [[sum(each[: palm + 1]) for each in motion] for palm in range(len(PALMS))]
    shakers = scene.run.shaking.palms if scene.run.shaking else (STILL,) * len(PALMS)
    for late in (step * dt for step in range(steps)):
        t = row * STEP_S + late
        yield [
            PalmStep(
                angle + late * (rate + 0.5 * late * acceleration),
                rate + (late + 0.5 * dt) * acceleration,
                shaker.displacement(t),
                shaker.outward_speed(t + 0.5 * dt),
            )
            for (angle, rate, acceleration), shaker in zip(turns, shakers, strict=True)
        ]


class RunRows:
    """Collects a run of an engine, row by row."""

    def __init__(self, start: BodyState) -> None:
        """Start with the state before the first step."""
        self.deepest = 0.0
        self._rows: list[tuple[float, ...]] = [(start.x, start.y, start.psi, start.omega0, math.nan, math.nan)]
        self._impulses, self._touched, self._untouched_rows = [0.0] * len(PALMS), False, 0

    def press(self, palm: int, impulse: float, depth: float) -> None:
        """Add a contact of palm 0 or 1 in a step or a whole row: its normal impulse (N s) and penetration (m)."""
        self._impulses[palm] += impulse
        self._touched, self.deepest = True, max(self.deepest, depth)

    def end(self, x: float, y: float, psi: float, omega0: float) -> bool:
        """End a row with the body in this state; false if it has had no contact for a while."""
        self._rows.append((x, y, psi, omega0, *(impulse / STEP_S for impulse in self._impulses)))
        self._untouched_rows = 0 if self._touched else self._untouched_rows + 1
        self._impulses, self._touched = [0.0] * len(PALMS), False
        return self._untouched_rows < _LOST_ROWS

    def simulated(self, body: Body) -> EngineRun:
        """The run; the forces of its first row are those of the next."""
        x, y, psi, omega0, f1, f2 = np.array(self._rows).T
        f1[0], f2[0] = f1[1], f2[1]
        return EngineRun(body, x, y, psi, omega0, f1, f2, self.deepest)


class Engine(Protocol):
    """Runs a scene; the result may end early if a contact is lost."""

    def __call__(self, scene: EngineScene, duration_s: float) -> EngineRun:
        """Simulate so many seconds."""


def draw_scene(kind: EngineKind, seed: int, known: DrawnImperfections = "none") -> EngineScene:
    """A scene drawn by its seed: an ellipse with an eccentric centre of mass, vibration as sines.

    known: `none` for an exactly known rig, `calibrated` for one with drawn imperfections.
    """
    rng = np.random.default_rng([_STREAM, ENGINE_KINDS.index(kind), seed])
    off = drawn(RigDescription().known_to(CALIBRATION[known]), _STREAM, seed)
    off = replace(off, pads=tuple(replace(pad, sagitta=0.0) for pad in off.pads))  # engines' palms are planes
    mean, ratio = float(rng.uniform(*_MEAN_RADIUS_M)), float(rng.uniform(*_RATIO))
    half_axes = 2.0 * mean / (1.0 + ratio), 2.0 * mean * ratio / (1.0 + ratio)
    body = with_slug(uniform_body_of("ellipse", ellipse(*half_axes), float(rng.uniform(*_MASS_KG))), rng)
    motion = DitheredRocking if kind == "dry" else Rocking
    rocking = motion(
        draw_rock(rng, (0.68, 0.82), (0.35, 0.70), (0.16, 0.38), ()),
        draw_rock(rng, (1.50, 1.82), (0.10, 0.28), (0.17, 0.42), ()),
    )
    surface = FrictionSurface(mu=0.0 if kind == "slick" else float(rng.uniform(*_MU)))
    vibration = Vibration(_RELATIONS[kind])
    shaking = None
    if vibration.vibrates:
        shaking = drawn_shaking(vibration, rng, speed=float(rng.uniform(*_SPEED_M_S)), pure=True)
        surface = replace(surface, dither=0.5 * math.pi * shaking.palms[0].speed)
    palms = off.true_palms(rocking.at(0.0))
    poses = stable_poses(body, palms)
    psi = poses[int(rng.integers(len(poses)))]
    if kind == "slick":
        psi += float(rng.choice((-1.0, 1.0)) * rng.uniform(*_RELEASE_RAD))
    body = body.turned(psi)
    hinge = Hinge("fixed", base=(0.0, 0.0))
    run = SimulatedRun("friction", body, hinge, surface, rocking, off, vibration=vibration, shaking=shaking)
    plant = Plant(body, hinge, FrictionSurface(), imperfections=off)
    plant.place(palms, psi=0.0)
    return EngineScene(kind, run, ellipse_of(body.support), plant.state)


def history_of(scene: EngineScene, simulated: EngineRun) -> FloatArray | None:
    """Rows as those of `rig.simulate`, means over the vibration where needed; None if a contact was lost."""
    t = np.arange(len(simulated.x)) * STEP_S
    motions = [scene.palms_at(float(each)) for each in t]
    frames = [palm_frame(scene.run.hinge, palms) for palms in motions]
    lines = np.array([[palm[:3] for palm in frame.palms] for frame in frames])
    (tx1, tx2), (ty1, ty2), (out1, out2) = lines.T
    ox, oy = np.array([(frame.ox, frame.oy) for frame in frames]).T
    rx, ry, support = simulated.x - ox, simulated.y - oy, simulated.body.support
    theta1, theta2 = out1 - simulated.psi, out2 - simulated.psi
    r1, r2 = support.sample(theta1), support.sample(theta2)
    contact1 = tx1 * rx + ty1 * ry + support.sample(theta1, 1)
    contact2 = -(tx2 * rx + ty2 * ry + support.sample(theta2, 1))
    angles = np.array([palms.angles for palms in motions]).T
    rows = np.array([
        t, simulated.psi, simulated.omega0, r1, r2, contact1, contact2, *angles, simulated.f1, simulated.f2
    ]).T  # fmt: skip
    slow = smoothed(rows)
    inside = (slow[:, 5:7] > _MARGIN_M) & (slow[:, 5:7] < PAD_LENGTH - _MARGIN_M)
    return slow if inside.all() and (slow[:, 9:11] > _LEAST_N).all() else None


def engine_log(
    engine: Engine, kind: EngineKind, seed: int, duration_s: float, known: DrawnImperfections = "none"
) -> tuple[list[Line], Line]:
    """A run of an engine as event-log lines, and its truth with the engine's penetration and the vibration.

    Scenes in which a contact is lost are drawn again.
    """
    for attempt in range(1000):
        scene = draw_scene(kind, seed + 100_000 * attempt, known)
        simulated = engine(scene, duration_s)
        history = history_of(scene, simulated) if len(simulated.x) == round(duration_s / STEP_S) + 1 else None
        if history is None:
            continue
        run = replace(scene.run, body=simulated.body)
        rng = np.random.default_rng([_STREAM, seed, attempt])
        lines = list(log_lines(run, history, CALIBRATION[known], rng))
        truth = truth_of(run, history) | {
            "engine_kind": kind,
            "engine_penetration_m": simulated.penetration,
        }
        return lines, truth
    raise ValueError(f"no {kind} scene of seed {seed} keeps both contacts")
