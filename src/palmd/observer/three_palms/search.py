"""Blind starts: candidate motions and bodies for the beginning of a record, and graduated optimisation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.spherical import Y00, count
from palmd.observer.three_palms import beliefs, kernels
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.beliefs import StartAssumption
from palmd.observer.three_palms.driven import ContactCurves, DrivenCourse, nearest_balls, smooth_course
from palmd.observer.three_palms.equations import BodyMotion, Noise
from palmd.observer.three_palms.kernels import by_columns
from palmd.observer.three_palms.path import JointPath
from palmd.observer.three_palms.record import BodyRecord, PadReadings, lay_out
from palmd.observer.three_palms.smoother import BodyFit, BodyPrior, BodySmoother
from palmd.system.three_palms import PALMS, ThreePalmsRig

START_ORDER = 6
SPACING_S = 0.02
LOOSE_NOISE = ((1.0, 0.1, 1e-5), (0.03, 0.03, 1e-6))
"""Process noise of the first fits, in turn: `spin`, `by_spin` and `turn` of `Noise`."""
COARSE_STAGES = tuple(
    (order, Noise(reading, spin, *LOOSE_NOISE[0][1:]))
    for order, reading, spin in ((2, 6e-4, 1.0), (3, 4e-4, 1.0), (4, 2.5e-4, 1.0), (START_ORDER, 1.3e-4, 0.3))
)
"""Outline degrees of a start's fits, in turn, and the noise of each: with a coarse outline and as much reading noise as
it leaves out, the cost has few local minima, and the outline does not adapt to errors of the motion."""
CHANCE_SD = 1.5  # standard deviations of the cost above its expectation, beyond which further starts are tried
STIFF_LAMBDA_SD = 0.05  # 1σ of λ during these fits, so that the inertia does not compensate errors of the motion
FIRST_OUTLINE_SD_M = 5e-4  # 1σ of the readings in the fit of the first outline
STILL_RAD_S, STILL_RAD = 0.04, 1e-3  # rate and turn of the joints below which a resting body is still at rest
LEAST_REST_S, LONGEST_REST_S = 0.12, 1.0
LEAST_RADIUS_M = 3e-3  # of a ball; inconsistent contacts may give a smaller radius, or a negative one
HOPELESS_COST = 2.5  # cost per number read above which a start is dropped
EXPLAINED_COST = 1.35  # cost per number read below which, with friction, frictionless bodies are not tried
STEPS, COARSE_STEPS = 12, 8  # iterations
SAME_COST = 2.0  # difference of cost below which two fits are the same
START_PRUNE_COST = 100.0  # cost above the cheapest at which a start is dropped
MOST_CANDIDATES = 4


@dataclass(frozen=True)  # no slots: `full_record` is cached
class Task:
    """The given data: the joints' path, all readings with their smoothed curves, the rig, start and end (s).

    finer_orders: degrees of the outline to try, one after the other, if `ORDER` does not explain the readings. If it is
    not empty, hypotheses that nothing explains are dropped, and fits are repeated by graduated optimisation. Empty
    live, for want of time.
    """

    path: JointPath
    readings: PadReadings
    contacts: ContactCurves
    rig: ThreePalmsRig
    start: float
    end: float
    finer_orders: tuple[int, ...] = ()

    @cached_property
    def full_record(self) -> BodyRecord:
        """The whole record."""
        return lay_out(self.path, self.readings, self.start, self.intervals(math.inf), SPACING_S)

    def record(self, seconds: float) -> BodyRecord:
        """The first `seconds` of the record."""
        return self.full_record.first(self.intervals(seconds))

    def intervals(self, seconds: float) -> int:
        """Number of whole intervals in the first `seconds`."""
        return max(round(min(seconds, self.end - self.start) / SPACING_S - 0.5), 1)

    @property
    def rest(self) -> int:
        """Number of first nodes at which the body is at rest; 0 if it moves from the beginning."""
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
        """1σ of the initial spin (rad/s)."""
        return beliefs.REST_SPIN_SD if self.rest else beliefs.SPIN_SD

    @property
    def noise(self) -> Noise:
        """Noise of readings and process."""
        return Noise(math.sqrt(self.rig.pad.reading_variance))

    def fit_with(
        self,
        record: BodyRecord,
        prior: BodyPrior,
        strengths: tuple[float, float, float] | None,
        motion: BodyMotion,
        iterations: int,
    ) -> BodyFit:
        """Fit from `motion` with process noise of these `strengths` (spin, by_spin, turn), or the task's own."""
        noise = self.noise if strengths is None else Noise(self.noise.reading, *strengths)
        return BodySmoother(record, prior, noise, self.rig).fit(motion, iterations)


@dataclass(frozen=True, slots=True)
class StartCandidate:
    """A fit of `record` from a blind start; radius: of a ball through the contacts (m)."""

    radius: float
    record: BodyRecord
    fit: BodyFit

    @property
    def cost_per_number(self) -> float:
        """Cost per number read."""
        return self.fit.cost / self.record.numbers


def start_candidates(task: Task, seconds: float) -> list[StartCandidate]:
    """Distinct fits of the first `seconds` from blind starts, the cheapest first."""
    record = task.record(seconds)
    ball = ContactBall.of(task.path, task.contacts, record)
    prior = beliefs.prior(ball.radius, START_ORDER, task.spin_sd)
    found: list[StartCandidate] = []
    for assumption in beliefs.start_assumptions():
        if (
            assumption.mu == beliefs.FRICTIONLESS
            and found
            and min(each.cost_per_number for each in found) < EXPLAINED_COST
        ):
            break
        found.append(
            StartCandidate(ball.radius, record, fit_blind_start(task, record, prior, task.contacts, ball, assumption))
        )
    kept = [each for each in _distinct(found) if each.cost_per_number < HOPELESS_COST]
    kept = [each for each in kept if each.fit.cost < kept[0].fit.cost + START_PRUNE_COST][:MOST_CANDIDATES]
    return _distinct([replace(each, fit=task.fit_with(record, prior, None, each.fit.motion, 25)) for each in kept])


@dataclass(frozen=True, slots=True)
class ContactBall:
    """The ball nearest to a record's contacts: its centre at the first node (m) and median radius (m)."""

    centre: FloatArray
    radius: float

    @classmethod
    def of(cls, path: JointPath, contacts: ContactCurves, record: BodyRecord) -> ContactBall:
        """Fit it to smoothed contacts at the record's nodes."""
        points = contacts.at(path, record.t)[:, :9].reshape(-1, 3, 3)
        centres, radii = nearest_balls(points, record.node_palms[:, :9].reshape(-1, 3, 3))
        return cls(centres[0], max(float(np.median(radii)), LEAST_RADIUS_M))


def fit_blind_start(
    task: Task,
    record: BodyRecord,
    prior: BodyPrior,
    contacts: ContactCurves,
    ball: ContactBall,
    assumption: StartAssumption,
) -> BodyFit:
    """Fit a record from a blind start, from coarse to fine outlines, with much process noise."""
    belief = assumption.belief(ball.radius, ball.centre, task.spin_sd, task.rest)
    driven = smooth_course(task.path, contacts, record.start, len(record.t) - 1, SPACING_S, belief, task.rig)
    first = beliefs.prior(ball.radius, COARSE_STAGES[0][0], task.spin_sd)
    motion = initial_motion(record, driven, first, ball.radius * (1.0 + assumption.oversize))
    for order, noise in COARSE_STAGES:
        coarse = beliefs.with_inertia(beliefs.prior(ball.radius, order, task.spin_sd), STIFF_LAMBDA_SD)
        smoother = BodySmoother(record, coarse, noise, task.rig)
        motion = smoother.fit(replace(motion, p=beliefs.with_order(motion.p, order)), COARSE_STEPS).motion
    return task.fit_with(record, beliefs.with_inertia(prior, STIFF_LAMBDA_SD), LOOSE_NOISE[1], motion, STEPS)


def fit_with_loose_equations(task: Task, record: BodyRecord, prior: BodyPrior, motion: BodyMotion) -> BodyFit:
    """Fit from `motion` with much process noise, then less, and a stiff inertia."""
    stiff = beliefs.with_inertia(prior, STIFF_LAMBDA_SD)
    first, second = LOOSE_NOISE
    loose_fit = task.fit_with(record, stiff, first, motion, STEPS)
    return task.fit_with(record, stiff, second, loose_fit.motion, STEPS)


def within_chance(fit: BodyFit, record: BodyRecord) -> bool:
    """Whether a fit's cost is within `CHANCE_SD` of its expectation."""
    return fit.cost <= record.numbers + CHANCE_SD * math.sqrt(2.0 * record.numbers)


def graduated_refit(task: Task, record: BodyRecord, prior: BodyPrior, fit: BodyFit) -> BodyFit:
    """Repeat a fit that costs more than chance by graduated optimisation; returns the cheaper of both.

    A window in which the body turns far, over surface never touched, has several minima; most vanish with more noise of
    readings and process. Not done live, for want of time.
    """
    if within_chance(fit, record) or not task.finer_orders:
        return fit
    motion = graduated_fit(task, record, prior, fit.motion).motion
    refit = BodySmoother(record, prior, task.noise, task.rig).fit(motion)
    return min(fit, refit, key=lambda each: each.cost)


def graduated_fit(task: Task, record: BodyRecord, prior: BodyPrior, motion: BodyMotion) -> BodyFit:
    """Fit from `motion` with the noise of `COARSE_STAGES` in turn, then with loose equations."""
    for _, noise in COARSE_STAGES:
        motion = BodySmoother(record, prior, noise, task.rig).fit(motion, STEPS).motion
    return task.fit_with(record, prior, LOOSE_NOISE[1], motion, STEPS)


def _distinct(found: Sequence[StartCandidate]) -> list[StartCandidate]:
    """Sort candidates by cost, and drop those with the same cost as the one before."""
    kept: list[StartCandidate] = []
    for each in sorted(found, key=lambda each: each.fit.cost):
        if not kept or each.fit.cost - kept[-1].fit.cost >= SAME_COST:
            kept.append(each)
    return kept


def initial_motion(record: BodyRecord, driven: DrivenCourse, prior: BodyPrior, radius: float) -> BodyMotion:
    """Initial motion: the course, with an outline by linear least squares about a ball of this radius (m)."""
    R, omega = driven.rotations(), driven.omega
    p = prior.mean.copy()
    p[0] = radius / Y00
    order = int(math.sqrt(len(p) - 9)) - 1
    n = count(order)
    p[-3], p[-2], p[-1] = driven.constants[1], math.exp(driven.constants[2]), driven.constants[3]
    turned = _at_readings(record, R, omega)
    rows = (
        kernels.reading(order)((by_columns(turned), record.geometry), (np.zeros(n),))[2].reshape(-1, n)
        / FIRST_OUTLINE_SD_M
    )
    prior_information = prior.information[STATES : STATES + n, STATES : STATES + n]
    sides = rows.T @ (record.readings.value.reshape(-1) / FIRST_OUTLINE_SD_M) + prior_information @ p[:n]
    p[:n] = np.linalg.solve(rows.T @ rows + prior_information, sides)
    return BodyMotion(R, omega, p)


def _at_readings(record: BodyRecord, R: FloatArray, omega: FloatArray) -> FloatArray:
    """(S, 3, 3) rotations at the readings' times, interpolated by cubics between nodes R, omega (K + 1, …)."""
    phi = rotation.log(R[1:] @ np.swapaxes(R[:-1], 1, 2))
    ending = omega[1:] - 0.5 * np.cross(phi, omega[1:])  # rate of the rotation vector at the interval's end
    k, share = record.interval, record.share[:, None]
    there, out, back = 3 * share**2 - 2 * share**3, share - 2 * share**2 + share**3, share**3 - share**2
    turned = there * phi[k] + record.spacing * (out * omega[:-1][k] + back * ending[k])
    return rotation.exp(turned) @ R[:-1][k]
