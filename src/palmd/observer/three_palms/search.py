"""From a blind start to the motion and body that explain a record: rivals in a short window, the best ones grown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palmd.events import FloatArray
from palmd.model.spherical import Y00, count
from palmd.observer.three_palms import beliefs, kernels
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.beliefs import Hypothesis
from palmd.observer.three_palms.driven import ContactCurves, DrivenCourse, ball_of, course
from palmd.observer.three_palms.equations import BodyMotion, Noise, at_readings
from palmd.observer.three_palms.kernels import by_columns
from palmd.observer.three_palms.path import JointPath
from palmd.observer.three_palms.record import BodyRecord, PadReadings, lay_out
from palmd.observer.three_palms.smoother import BodyFit, BodyPrior, BodySmoother
from palmd.system.three_palms import PALMS, ThreePalmsRig

START_ORDER = 6
SPACING_S = 0.02
LOOSE = ((1.0, 0.1, 1e-5), (0.03, 0.03, 1e-6))
"""Strengths of the noise that a motion is smoothed with first: of spin, by spin, of turn."""
COARSE = tuple(
    (order, Noise(reading, spin, *LOOSE[0][1:]))
    for order, reading, spin in ((2, 6e-4, 1.0), (3, 4e-4, 1.0), (4, 2.5e-4, 1.0), (START_ORDER, 1.3e-4, 0.3))
)
"""Degrees of the outline that a start is smoothed with one after the other, and the noise meanwhile (of readings
in m): what a coarse outline has wrong hides few minima, and bends to nothing."""
CHANCE = 1.5  # one-sigmas of the cost above one for each number read, beyond which more is tried
STIFF = 0.05  # one-sigma of λ meanwhile, lest the inertia explains what the motion does not yet
ROUGH_M = 5e-4  # what readings may miss a first outline by
STILL_RAD_S, STILL_RAD = 0.04, 1e-3  # of the joints, below which a body that rested still rests
LEAST_REST_S, LONGEST_REST_S = 0.12, 1.0
LEAST_RADIUS_M = 3e-3  # of a ball: contacts that contradict each other may tell a smaller one, or none
HOPELESS = 2.5  # cost per number read above which a start is not followed at all
EXPLAINED = 1.35  # of the same, below which bodies that rub explain the record, and none that do not are tried
STEPS, COARSE_STEPS = 12, 8
SAME_COST = 2.0
TOO_FAR = 100.0  # in cost, of the cheapest, where a start is dropped
KEPT = 4


@dataclass(frozen=True)  # no slots: `whole` is kept
class Task:
    """What is given: the joints' path, all readings with their smoothed course, and the rig.

    finer: degrees up to which outlines may go, one after the other, where `ORDER` does not explain what is read; whom
    nothing explains is given up, and fits are eased. Empty live, where there is time for none of that.
    """

    path: JointPath
    readings: PadReadings
    contacts: ContactCurves
    rig: ThreePalmsRig
    start: float
    end: float
    finer: tuple[int, ...] = ()

    @cached_property
    def whole(self) -> BodyRecord:
        """All of it."""
        return lay_out(self.path, self.readings, self.start, self.intervals(math.inf), SPACING_S)

    def record(self, seconds: float) -> BodyRecord:
        """The first `seconds`."""
        return self.whole.first(self.intervals(seconds))

    def intervals(self, seconds: float) -> int:
        """How many whole ones there are in the first `seconds`."""
        return max(round(min(seconds, self.end - self.start) / SPACING_S - 0.5), 1)

    @property
    def rest(self) -> int:
        """At how many of the first nodes the body is seen to rest; 0 when it moves from the beginning."""
        t: FloatArray = np.asarray(self.start + SPACING_S * np.arange(int(LONGEST_REST_S / SPACING_S) + 1), np.float64)
        turned = np.abs(self.path.angle(t) - self.path.angle(t[:1])).max(axis=1)
        still = (np.abs(self.path.rate(t)).max(axis=1) < STILL_RAD_S) & (turned < STILL_RAD)
        nodes = len(t) if still.all() else int(np.argmin(still))
        until = self.readings.within(self.start, self.start + max(nodes * SPACING_S, LEAST_REST_S))
        for pad in range(len(PALMS)):
            value = until.value[until.pad == pad]
            half = len(value) // 2
            if half < 2:
                return 0
            moved = value[half:].mean(0) - value[:half].mean(0)
            if (np.abs(moved) > 4 * self.noise.reading * math.sqrt(2 / half)).any():
                return 0
        return nodes

    @property
    def spin_sd(self) -> float:
        """One-sigma of the first spin (rad/s)."""
        return beliefs.REST_SPIN_SD if self.rest else beliefs.SPIN_SD

    @property
    def noise(self) -> Noise:
        """Of the readings and of what the equations leave out."""
        return Noise(math.sqrt(self.rig.pad.reading_variance))

    def fitted(
        self,
        record: BodyRecord,
        prior: BodyPrior,
        strengths: tuple[float, float, float] | None,
        motion: BodyMotion,
        iterations: int,
    ) -> BodyFit:
        """The fit from `motion`, the equations held loosely by these strengths, or as they are."""
        noise = self.noise if strengths is None else _loosened(self.noise, strengths)
        return BodySmoother(record, prior, noise, self.rig).fit(motion, iterations)


@dataclass(frozen=True, slots=True)
class Rival:
    """The radius of a ball through the contacts, and the fit that a start led to in `record`.

    met: how many starts led to the same.
    """

    radius: float
    record: BodyRecord
    fit: BodyFit
    met: int = 1

    @property
    def per_number(self) -> float:
        """Cost per number read."""
        return self.fit.cost / self.record.numbers


def rivals(task: Task, seconds: float) -> list[Rival]:
    """What the starts lead to in the first `seconds`, the cheapest first, each but once."""
    record = task.record(seconds)
    ball = ContactBall.of(task.path, task.contacts, record)
    prior = beliefs.prior(ball.radius, START_ORDER, task.spin_sd)
    found: list[Rival] = []
    for hypothesis in beliefs.hypotheses():
        if hypothesis.mu == beliefs.FRICTIONLESS and found and min(each.per_number for each in found) < EXPLAINED:
            break
        found.append(Rival(ball.radius, record, loosely(task, record, prior, task.contacts, ball, hypothesis)))
    kept = [each for each in met(found) if each.per_number < HOPELESS]
    kept = [each for each in kept if each.fit.cost < kept[0].fit.cost + TOO_FAR][:KEPT]
    return met([replace(each, fit=task.fitted(record, prior, None, each.fit.motion, 25)) for each in kept])


@dataclass(frozen=True, slots=True)
class ContactBall:
    """The ball nearest to a record's contacts: its first centre (m) and its median radius (m)."""

    centre: FloatArray
    radius: float

    @classmethod
    def of(cls, path: JointPath, contacts: ContactCurves, record: BodyRecord) -> ContactBall:
        """By smoothed contacts at the record's nodes."""
        points = contacts.at(path, record.t)[:, :9].reshape(-1, 3, 3)
        centres, radii = ball_of(points, record.node_palms[:, :9].reshape(-1, 3, 3))
        return cls(centres[0], max(float(np.median(radii)), LEAST_RADIUS_M))


def loosely(
    task: Task, record: BodyRecord, prior: BodyPrior, contacts: ContactCurves, ball: ContactBall, hypothesis: Hypothesis
) -> BodyFit:
    """What a blind start leads to while much noise is allowed to the equations."""
    belief = hypothesis.belief(ball.radius, ball.centre, task.spin_sd, task.rest)
    driven = course(task.path, contacts, record.start, len(record.t) - 1, SPACING_S, belief, task.rig)
    first = beliefs.prior(ball.radius, COARSE[0][0], task.spin_sd)
    motion = first_motion(record, driven, first, ball.radius * (1.0 + hypothesis.larger))
    for order, noise in COARSE:
        coarse = beliefs.with_inertia(beliefs.prior(ball.radius, order, task.spin_sd), STIFF)
        smoother = BodySmoother(record, coarse, noise, task.rig)
        motion = smoother.fit(replace(motion, p=beliefs.raised(motion.p, order)), COARSE_STEPS).motion
    return task.fitted(record, beliefs.with_inertia(prior, STIFF), LOOSE[1], motion, STEPS)


def loosened(task: Task, record: BodyRecord, prior: BodyPrior, motion: BodyMotion) -> BodyFit:
    """What leads on from a motion while much noise is allowed to the equations, then less, and the inertia is held."""
    stiff = beliefs.with_inertia(prior, STIFF)
    first, second = LOOSE
    begun = task.fitted(record, stiff, first, motion, STEPS)
    return task.fitted(record, stiff, second, begun.motion, STEPS)


def by_chance(fit: BodyFit, record: BodyRecord) -> bool:
    """Whether a fit costs no more than chance has it."""
    return fit.cost <= record.numbers + CHANCE * math.sqrt(2.0 * record.numbers)


def eased(task: Task, record: BodyRecord, prior: BodyPrior, fit: BodyFit) -> BodyFit:
    """The fit; if it costs more than chance, what its motion leads to once `roughened`, if that costs less.

    What turns far in a window, over what was never felt, has minima beside the right one: they are shallow where
    readings are rough and equations are loose. Live there is no time for it.
    """
    if by_chance(fit, record) or not task.finer:
        return fit
    motion = roughened(task, record, prior, fit.motion).motion
    again = BodySmoother(record, prior, task.noise, task.rig).fit(motion)
    return min(fit, again, key=lambda each: each.cost)


def roughened(task: Task, record: BodyRecord, prior: BodyPrior, motion: BodyMotion) -> BodyFit:
    """What leads on from a motion while readings are as rough as those of a start, then the equations loose."""
    for _, noise in COARSE:
        motion = BodySmoother(record, prior, noise, task.rig).fit(motion, STEPS).motion
    return task.fitted(record, prior, LOOSE[1], motion, STEPS)


def met(found: Sequence[Rival]) -> list[Rival]:
    """The rivals, the cheapest first, those that have met in the same cost as one."""
    kept: list[Rival] = []
    for each in sorted(found, key=lambda each: each.fit.cost):
        if kept and each.fit.cost - kept[-1].fit.cost < SAME_COST:
            kept[-1] = replace(kept[-1], met=kept[-1].met + each.met)
        else:
            kept.append(each)
    return kept


def first_motion(record: BodyRecord, driven: DrivenCourse, prior: BodyPrior, radius: float) -> BodyMotion:
    """The course with the outline that fits it best, by linear least squares, begun with a ball of this radius (m)."""
    R, omega = driven.rotations(), driven.omega
    p = prior.mean.copy()
    p[0] = radius / Y00
    order = int(math.sqrt(len(p) - 9)) - 1
    n = count(order)
    p[-3], p[-2], p[-1] = driven.constants[1], math.exp(driven.constants[2]), driven.constants[3]
    turned = at_readings(record, R, omega)
    rows = kernels.reading(order)((by_columns(turned), record.geometry), (np.zeros(n),))[2].reshape(-1, n) / ROUGH_M
    believed = prior.information[STATES : STATES + n, STATES : STATES + n]
    sides = rows.T @ (record.readings.value.reshape(-1) / ROUGH_M) + believed @ p[:n]
    p[:n] = np.linalg.solve(rows.T @ rows + believed, sides)
    return BodyMotion(R, omega, p)


def _loosened(noise: Noise, strengths: tuple[float, float, float]) -> Noise:
    spin, by_spin, turn = strengths
    return replace(noise, spin=spin, by_spin=by_spin, turn=turn)
