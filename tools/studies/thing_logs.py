"""Logs of bodies with corners, flat sides and dents, and of dry friction: how many `reconstruct` is right about.

Simulated, each from its kind and seed, on rocking palms or moved by a plan in the emulated rig, and reconstructed
blind, as `palmd reconstruct` does. What lies in a dent no palm feels: the truth of a dented body is its hull. `run`
gives the same row in any process and in any order.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.config.two_palms import Drawn, PlanSpec
from palmd.console.columns import aligned
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import read_log
from palmd.rig.dry_plant import DRY
from palmd.rig.plant import PlantOptions
from palmd.rig.real_things import Random, thing
from palmd.rig.shapes import Body, Support, random_body
from palmd.rig.sharp_shapes import FLAT_RAD, ChordSupport, rounded_polygon, uniform_body
from palmd.rig.simulate import CALIBRATION, simulate_log
from palmd.score import score_outline
from palmd.system import vibration
from tools.studies.runs import with_failures
from tools.studies.scoring import FAR, RIGHT_M
from tools.studies.simulated import written
from tools.studies.thing_recordings import ThingRecording, recorded

_STREAM = 31  # keeps the bodies' random numbers apart from those of the motion


def _polygon(random: Random, radius: float) -> Body:
    """Five to seven corners of this radius (m), about evenly spread, 14 to 21 mm from the middle."""
    mass, corners = float(random.uniform(0.05, 0.25)), int(random.integers(5, 8))
    angles = (np.arange(corners) + random.uniform(-0.25, 0.25, corners)) * (math.tau / corners)
    reach = random.uniform(15e-3, 20e-3) * random.uniform(0.92, 1.08, corners) - radius
    ring = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(reach.tolist(), angles.tolist(), strict=True)]
    return uniform_body("polygon", rounded_polygon(ring, radius), mass)


def _dented(random: Random, chord: float) -> Body:
    """The hull of an ellipse with a dent in its long side, on which it comes to rest: a chord of this length (m)."""
    mean, flat = float(random.uniform(17e-3, 21e-3)), float(random.uniform(0.5e-3, 1.2e-3))
    lump = Support.from_coefficients((complex(mean), 0j, complex(flat), complex(random.uniform(0.0, 3e-4))))
    hull = ChordSupport(lump, math.pi / 2 + float(random.uniform(-0.15, 0.15)), chord, FLAT_RAD)
    return uniform_body("dented lump", hull, float(random.uniform(0.05, 0.25)))


def _lump(random: Random) -> Body:
    return random_body("friction", random)


def _thing(name: str) -> Callable[[Random], Body]:
    return lambda random: thing(name, random).body


BODIES: Mapping[str, Callable[[Random], Body]] = {
    "corners of 3 mm": lambda random: _polygon(random, 3e-3),
    "corners of 1 mm": lambda random: _polygon(random, 1e-3),
    "dent of 4 mm": lambda random: _dented(random, 4e-3),
    "dent of 10 mm": lambda random: _dented(random, 10e-3),
    "dry lump": _lump,
    **{name: _thing(name) for name in ("die", "nut", "triangle", "block", "D-profile", "L-profile")},
}
"""What is drawn for each kind. A dry one is rubbed by Coulomb's friction, with no dither."""

KINDS: tuple[str, ...] = tuple(BODIES)
_DRY = "dry"


@dataclass(frozen=True, slots=True)
class SharpTask:
    """One log to make and to reconstruct: what lies on the palms, the seed, how long (s).

    plan: what the palms do in the emulated rig; None: they rock, and scenes in which a contact is lost are drawn again.
    """

    kind: str
    seed: int
    seconds: float = 20.0
    imperfections: Drawn = "none"
    plan: PlanSpec | None = None


@dataclass(frozen=True, slots=True)
class SharpRow:
    """What came of it; NaN for what there is not.

    e_h, most, sd: RMS and largest error, and RMS of the one-sigma, over the touched normals (m). touched: their share.
    shown: the share that a recording's object was really touched by.
    explained_s: how much of the log the answer explains; mass_z: by how many one-sigmas the mass is too large.
    seconds: of the processor. perfect: the rig is as described.
    """

    kind: str
    seed: int
    error: str = ""
    perfect: bool = True
    claimed: bool = False
    reason: str = ""
    e_h_m: float = math.nan
    most_m: float = math.nan
    sd_m: float = math.nan
    touched: float = math.nan
    shown: float = math.nan
    sides: int = 0
    explained_s: float = math.nan
    mass_z: float = math.nan
    seconds: float = math.nan
    looks_like: str = ""

    @property
    def right(self) -> bool:
        """Whether what is claimed is right to `RIGHT_M`."""
        return self.claimed and self.e_h_m < RIGHT_M

    @property
    def rough(self) -> bool:
        """Whether it is not, but no farther off than its band allows on a rig that is not as described."""
        return self.claimed and not self.right and not self.perfect and self.e_h_m < FAR * self.sd_m

    @property
    def wrong(self) -> bool:
        """Whether what is claimed is neither."""
        return self.claimed and not self.right and not self.rough


def tasks_of(kinds: Iterable[str], first: int, count: int, seconds: float, imperfections: Drawn) -> list[SharpTask]:
    """So many of each kind, all with the same seeds."""
    return [SharpTask(kind, first + i, seconds, imperfections) for i in range(count) for kind in kinds]


def failed(task: SharpTask, error: BaseException) -> SharpRow:
    """The row of a run that came to nothing."""
    return SharpRow(task.kind, task.seed, error=f"{type(error).__name__}: {error}")


@with_failures(failed)
def run(task: SharpTask) -> SharpRow:
    """Simulate, reconstruct, compare; what raises becomes a row that says so."""
    log, truth, shown = simulated(task)
    begun = time.process_time()
    answer = reconstruct(log.events, log.rig)
    seconds, perfect = time.process_time() - begun, task.imperfections == "none"
    row = SharpRow(task.kind, task.seed, perfect=perfect, reason=answer.reason, seconds=seconds, shown=shown)
    if not answer.converged or answer.h is None or answer.h_sd is None or answer.touched is None:
        return row
    score = score_outline(answer.theta, answer.h, answer.touched, np.array(truth["h_m"]))
    return replace(
        row,
        claimed=True,
        e_h_m=score.e_h,
        most_m=score.max_error,
        sd_m=float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2))),
        touched=score.touched,
        sides=len(answer.sides),
        explained_s=answer.lasts,
        mass_z=(answer.mass - truth["mass_kg"]) / answer.mass_sd,
        looks_like=answer.likeness.said or answer.likeness.why,
    )


def simulated(task: SharpTask) -> ThingRecording:
    """The task's log, as it is read from a file, or its recording, and the truth."""
    body = BODIES[task.kind](np.random.default_rng([_STREAM, KINDS.index(task.kind), task.seed]))
    dry = task.kind.startswith(_DRY)
    options, surface = PlantOptions(friction_law="coulomb" if dry else None), DRY if dry else None
    if task.plan is not None:
        return recorded(body, task.plan, task.seed, task.seconds, task.imperfections, options, surface)
    sds = CALIBRATION[task.imperfections]
    lines, truth = simulate_log(
        "friction", task.seed, task.seconds, options, body,
        surface=surface, calibration_sd=sds, vibration=vibration.DRY if dry else vibration.INDEPENDENT,
    )  # fmt: skip
    with written(lines) as path:
        return ThingRecording(read_log(path), truth, math.nan)


_VERDICTS = ("right", "in its band", "wrong", "refused")
HEAD = (*_VERDICTS, "µm", "largest", "error / sd", "touched", "explained (s)", "processor (s)")


def table(rows: Sequence[SharpRow]) -> str:
    """A line for each kind: errors and shares are medians of what is claimed, the largest error is of all that is."""
    lines: list[tuple[str, Sequence[str]]] = [("", HEAD)]
    groups = [(kind, [row for row in rows if row.kind == kind and not row.error]) for kind in KINDS]
    return aligned([*lines, *((name, _cells(mine)) for name, mine in groups if mine)])


def _cells(rows: Sequence[SharpRow]) -> Sequence[str]:
    claimed = [row for row in rows if row.claimed]
    verdicts = [(row.right, row.rough, row.wrong, not row.claimed) for row in rows]
    counts = [sum(each) for each in zip(*verdicts, strict=True)]
    spent = f"{np.median([row.seconds for row in rows]):.0f}, most {max(row.seconds for row in rows):.0f}"
    ratios = [row.e_h_m / row.sd_m for row in claimed]
    if not claimed:
        return (*(f"{count} of {len(rows)}" for count in counts), *("–",) * 5, spent)
    return (
        *(f"{count} of {len(rows)}" for count in counts),
        f"{1e6 * np.median([row.e_h_m for row in claimed]):.0f}",
        f"{1e6 * max(row.most_m for row in claimed):.0f}",
        f"{np.median(ratios):.1f}, most {max(ratios):.1f}",
        f"{np.median([row.touched for row in claimed]):.0%}",
        f"{np.median([row.explained_s for row in claimed]):.0f}",
        spent,
    )


def remarks(rows: Sequence[SharpRow]) -> list[str]:
    """A line for each log: what came of it, and what it looks like."""
    said = []
    for row in rows:
        shown = "" if math.isnan(row.shown) else f" ({row.shown:.0%} shown)"
        if row.error or not row.claimed:
            said.append(f"{row.kind} {row.seed}: {row.error or 'refused: ' + row.reason}{shown}")
        else:
            verdict = "right" if row.right else "in its band" if row.rough else "WRONG"
            said.append(
                f"{row.kind} {row.seed}: {verdict}, {1e6 * row.e_h_m:.0f} µm (largest {1e6 * row.most_m:.0f}), sd"
                f" {1e6 * row.sd_m:.0f} µm, {row.touched:.0%} touched{shown}, {row.explained_s:.1f} s explained, sides:"
                f" {row.sides}, mass {row.mass_z:+.1f} sd, {row.seconds:.0f} s; {row.looks_like}"
            )
    return said
