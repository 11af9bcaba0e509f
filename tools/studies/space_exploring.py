"""How much of a body three palms can show within a minute, where the body is known to who decides.

What an exploration can reach at best: nothing has to be estimated. What is known of the body is its truth as far as
harmonics hold it, and where it is when a move begins; the truth itself is not band-limited.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from palmd.blas import one_thread
from palmd.config.three_palms import ThreePalmsLimitsConfig
from palmd.events import FloatArray
from palmd.jsonvalues import or_none
from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, evaluator
from palmd.model.three_palms import MOMENT
from palmd.motion.body_explorer import BodyExplorer
from palmd.motion.body_foresight import Bearings, BodyForesight
from palmd.motion.segments import Move
from palmd.motion.three_palms import TiltLimits
from palmd.observer.three_palms.body import ORDER
from palmd.rig.three_palms.bodies import Bodies, random_bodies
from palmd.rig.three_palms.compiled import BodyOnPalms, palm_rows
from palmd.rig.three_palms.plant import Rubbing
from palmd.rig.three_palms.simulate import KINDS, REST_POSE, STEP_S, started
from palmd.system.three_palms import ThreePalmsRig, palms_at, readings_of, room_on_pads

WIDE = ThreePalmsLimitsConfig(beta_deg=(10.0, 80.0), gamma2_deg=(15.0, 75.0), gamma3_deg=(15.0, 75.0))
MU, DITHER_M_S = (0.05, 0.2), (8e-3, 1.2e-2)
HALVINGS = 3  # of the directions that are counted: 642
GOAL = 0.8
MARKS_S = (20.0, 40.0, 60.0)
WAIT_S = 0.5  # of standing, where no move is thought safe


@dataclass(frozen=True, slots=True)
class SpaceExploringRow:
    """One body: the share of all directions within 10 degrees of a contact curve after each of `MARKS_S`.

    lost: when a contact was lost (s), which ends it, NaN if none was. stood: where no move was thought safe, how long
    the palms stood (s). decisions: how many; seconds: of processor time for each.
    """

    seed: int
    mu: float
    coverage: tuple[float, ...]
    lost: float
    stood: float
    decisions: int
    seconds: float

    def line(self) -> dict[str, Any]:
        """As JSON, None for what is not a number."""
        line: dict[str, Any] = or_none(asdict(self))
        return line


def known_parameters(body: Bodies, rubbing: Rubbing) -> FloatArray:
    """Parameters of `model.three_palms` of the first of these bodies, by least squares over the sphere."""
    directions = icosphere()[0]
    h = body.support(directions[None])[0][0]
    c = np.linalg.lstsq(evaluator(ORDER)(directions)[0], h, rcond=None)[0]
    moment = 0.5 * np.trace(body.inertia[0]) * np.eye(3) - body.inertia[0]
    root = np.linalg.cholesky(moment) / (MOMENT * Y00 * c[0])
    lam = [math.log(root[i, j]) if i == j else root[i, j] for i in range(3) for j in range(i + 1)]
    resisting = [float(rubbing.drag[0]), float(rubbing.mu[0]), math.log(float(rubbing.dither[0]))]
    return np.concatenate([c, lam, resisting])


class BodyStand:
    """One body on the palms."""

    def __init__(self, seed: int, gravity: float) -> None:
        random = np.random.default_rng(seed)
        body = random_bodies(1, random)
        rubbing = Rubbing(random.uniform(*MU, 1), random.uniform(*DITHER_M_S, 1), np.zeros(1))
        self.plant = BodyOnPalms(body, rubbing, gravity)
        self.plant.state[:] = started(body, rubbing, KINDS["friction"], random, gravity)[0]

    @property
    def bearings(self) -> tuple[FloatArray, FloatArray]:
        """Rotation (1, 3, 3) and spin (1, 3)."""
        return self.plant.state[6:15].reshape(1, 3, 3).copy(), self.plant.state[None, 15:].copy()

    def moved(self, move: Move, side: float) -> tuple[FloatArray, bool]:
        """(T, 3 palms, 3) normals touched on a move; whether all palms kept their contacts."""
        steps = round(move.duration / STEP_S)
        motion = [move.at(0.5 * k * STEP_S) for k in range(2 * steps + 1)]
        each = ([getattr(one, name) for one in motion] for name in ("angles", "rates", "accelerations"))
        planes = palms_at(*map(np.array, each))
        rows, normals, points = palm_rows(planes), np.empty((steps, 3, 3)), np.empty((2 * steps + 1, 3, 3))
        for k in range(steps):
            self.plant.advance(rows[2 * k : 2 * k + 3], STEP_S)
            points[2 * k + 2] = self.plant.point
            normals[k] = -planes.normal[2 * k + 2] @ self.plant.state[6:15].reshape(3, 3)
            if not (self.plant.force > 0.0).all():
                return normals[:k], False
        read = readings_of(planes, points)[2::2]
        return normals, bool((room_on_pads(read, side) > 0.0).all())


@one_thread()
def explored(seed: int, seconds: float, limits: ThreePalmsLimitsConfig = WIDE) -> SpaceExploringRow:
    """The body of this seed for so long (s)."""
    rig, within = ThreePalmsRig(), TiltLimits.over(limits, 1e3 * ThreePalmsRig().pad.side)
    stand = BodyStand(seed, rig.gravity)
    plant = stand.plant
    directions = icosphere(HALVINGS)[0]
    foresight = BodyForesight(known_parameters(plant.body, plant.rubbing), rig)
    explorer = BodyExplorer(foresight, within, directions, seed)
    pose = tuple(REST_POSE.tolist())
    touched = np.zeros(len(directions), np.bool_)
    t, stood, lost, decisions, thought = 0.0, 0.0, math.nan, 0, 0.0
    coverage: list[tuple[float, float]] = []
    while t < seconds and math.isnan(lost):
        begun = time.process_time()
        move = explorer.decide(Bearings(*stand.bearings, np.array([pose])), touched)
        thought += time.process_time() - begun
        decisions += 1
        if move is None:
            move = Move(pose, pose, WAIT_S)
            stood += WAIT_S
        move = Move(move.start, move.end, STEP_S * math.ceil(move.duration / STEP_S))
        normals, held = stand.moved(move, rig.pad.side)
        t, pose = t + move.duration, move.end
        touched |= explorer.covered(normals)
        coverage.append((t, float(touched.mean())))
        lost = math.nan if held else t
    marks = tuple(max((share for at, share in coverage if at <= mark), default=0.0) for mark in MARKS_S)
    return SpaceExploringRow(
        seed, float(plant.rubbing.mu[0]), marks, lost, stood, decisions, thought / max(decisions, 1)
    )


def told_of_exploring(rows: Sequence[SpaceExploringRow]) -> Iterator[str]:
    """A line for each, and what they come to."""
    for row in rows:
        shares = ", ".join(f"{share:.0%} after {mark:.0f} s" for mark, share in zip(MARKS_S, row.coverage, strict=True))
        ended = "" if math.isnan(row.lost) else f", lost after {row.lost:.1f} s"
        yield (
            f"{row.seed:8}: μ {row.mu:.3f}, {shares}{ended}; stood {row.stood:.1f} s, {row.decisions} decisions of"
            f" {row.seconds:.2f} s"
        )
    last = np.array([row.coverage[-1] for row in rows])
    yield (
        f"{len(rows)} bodies: median {np.median(last):.0%}, {np.count_nonzero(last >= GOAL)} with at least {GOAL:.0%},"
        f" {sum(not math.isnan(row.lost) for row in rows)} lost"
    )
