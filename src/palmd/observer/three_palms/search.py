"""From a blind start to the motion and body that explain a record: rivals in a short window, the best ones grown."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model.spherical import Y00, count, evaluator
from palmd.model.three_palms import BODY, MOMENT
from palmd.observer.three_palms import beliefs, kernels
from palmd.observer.three_palms.beliefs import Hypothesis
from palmd.observer.three_palms.driven import BallBelief, ContactCurves, DrivenCourse, ball_of, course
from palmd.observer.three_palms.kernels import by_columns
from palmd.observer.three_palms.path import JointPath
from palmd.observer.three_palms.record import BodyRecord, PadReadings, lay_out
from palmd.observer.three_palms.smoother import BodyFit, BodyMotion, BodyPrior, BodySmoother, Noise, at_readings
from palmd.system.three_palms import PALMS, ThreePalmsRig

START_ORDER = 6
ORDER = 8
STARTS_S = (2.0, 3.0)
SPACING_S = 0.02
LOOSE = ((1.0, 0.1, 1e-5), (0.03, 0.03, 1e-6))
"""Strengths of the noise that a start is smoothed with first: of spin, by spin, of turn."""
STIFF = 0.05  # one-sigma of λ meanwhile, lest the inertia explains what the motion does not yet
ROUGH_M = 5e-4  # what readings may miss a first outline by
KEPT = 2  # rivals that are grown
GROWTH = 0.5
CURVATURE_EVERY = 5  # contacts
LONGEST_STEP_S = 4.0
SHORTEST_STEP_S = 0.2
STILL_RAD_S, STILL_RAD = 0.04, 1e-3  # of the joints, below which a body that rested still rests
LEAST_REST_S, LONGEST_REST_S = 0.12, 1.0
TURN_A_STEP = 1.5  # rad
SHARES = (1.0, 0.3)  # of the usual growth, which are tried
FOLLOWED = 1.15  # cost per number read, below which a rival has followed
LOST = 1.6  # cost per number read, above which a rival is given up
HOPELESS = 2.5  # above which a start is not followed at all
SURE = 1.1  # below which no other start is asked for


@dataclass(frozen=True, slots=True)
class Task:
    """What is given: the joints' path, all readings with their smoothed course, and the rig."""

    path: JointPath
    readings: PadReadings
    contacts: ContactCurves
    rig: ThreePalmsRig
    start: float
    end: float

    def record(self, seconds: float) -> BodyRecord:
        """The first `seconds`."""
        intervals = max(round(min(seconds, self.end - self.start) / SPACING_S - 0.5), 1)
        return lay_out(self.path, self.readings, self.start, intervals, SPACING_S)

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

    def reaches_end(self, record: BodyRecord) -> bool:
        """Whether a record goes as far as there is anything."""
        return bool(record.t[-1] > self.end - 2 * SPACING_S)

    def rank(self, rival: Rival) -> tuple[float, float]:
        """What rivals are sorted by."""
        return -float(rival.record.t[-1]), rival.fit.cost


@dataclass(frozen=True, slots=True)
class Rival:
    """A hypothesis, what is believed with it, and the fit that it led to in `record`."""

    hypothesis: Hypothesis
    radius: float
    record: BodyRecord
    fit: BodyFit

    @property
    def per_number(self) -> float:
        """Cost per number read."""
        return self.fit.cost / (2 * len(self.record.readings.t))

    def least_radius(self) -> float:
        """The smallest radius of curvature where a palm has touched (m); not more than 0 where the body is hollow."""
        R, p = self.fit.motion.R, self.fit.motion.p
        normals = self.record.node_palms[:, :9].reshape(-1, 3, 3)
        u = -np.einsum("tji,tnj->tni", R, normals).reshape(-1, 3)[::CURVATURE_EVERY]
        return float(curvatures(p[: len(p) - BODY], u).min())


def rivals(task: Task, seconds: float) -> list[Rival]:
    """What each hypothesis leads to in the first `seconds`, the cheapest first."""
    record = task.record(seconds)
    given = task.contacts.at(task.path, record.t)
    centres, radii = ball_of(given[:, :9].reshape(-1, 3, 3), record.node_palms[:, :9].reshape(-1, 3, 3))
    radius = float(np.median(radii))
    found = []
    for hypothesis in beliefs.hypotheses():
        belief = hypothesis.belief(radius, centres[0], task.spin_sd, task.rest)
        driven = course(task.path, task.contacts, record.start, len(record.t) - 1, SPACING_S, belief, task.rig.gravity)
        own = radius * (1.0 + hypothesis.larger)
        prior = beliefs.prior(own, START_ORDER, task.spin_sd)
        motion = first_motion(record, driven, prior)
        stiff = beliefs.with_inertia(prior, STIFF)
        for strengths in LOOSE:
            noise = _loosened(task.noise, strengths)
            motion = BodySmoother(record, stiff, noise, task.rig.gravity).fit(motion, 20).motion
        fit = BodySmoother(record, prior, task.noise, task.rig.gravity).fit(motion, 25)
        found.append(Rival(hypothesis, own, record, fit))
    return sorted(found, key=lambda each: each.fit.cost)


def first_motion(record: BodyRecord, driven: DrivenCourse, prior: BodyPrior) -> BodyMotion:
    """The course with the outline that fits it best, by linear least squares."""
    R, omega = driven.rotations(), driven.omega
    p = prior.mean.copy()
    order = int(math.sqrt(len(p) - 9)) - 1
    n = count(order)
    p[-3], p[-2], p[-1] = driven.constants[1], math.exp(driven.constants[2]), driven.constants[3]
    turned = at_readings(record, R, omega)
    rows = kernels.reading(order)((by_columns(turned), record.geometry), (np.zeros(n),))[2].reshape(-1, n) / ROUGH_M
    believed = prior.information[:n, :n]
    sides = rows.T @ (record.readings.value.reshape(-1) / ROUGH_M) + believed @ prior.mean[:n]
    p[:n] = np.linalg.solve(rows.T @ rows + believed, sides)
    return BodyMotion(R, omega, p)


def grown(task: Task, rival: Rival) -> Rival:
    """The rival followed to the end of the record, or to where it is lost."""
    prior = beliefs.prior(rival.radius, ORDER, task.spin_sd)
    motion = replace(rival.fit.motion, p=beliefs.raised(rival.fit.motion.p, ORDER))
    record = rival.record
    fit = BodySmoother(record, prior, task.noise, task.rig.gravity).fit(motion, 15)
    now = Rival(rival.hypothesis, rival.radius, record, fit)
    total = len(task.record(task.end - task.start).t)
    while len(now.record.t) < total and now.per_number < LOST:
        now = _followed(task, now, prior, total)
    return now


def _followed(task: Task, now: Rival, prior: BodyPrior, total: int) -> Rival:
    """The rival on a longer record: by as much as it can follow, or by the least, lost."""
    longer = now
    for share in SHARES:
        record, motion = _further(task, now, total, share)
        for noise, iterations in ((_loosened(task.noise, LOOSE[-1]), 6), (task.noise, 20)):
            fit = BodySmoother(record, prior, noise, task.rig.gravity).fit(motion, iterations)
            motion = fit.motion
        longer = Rival(now.hypothesis, now.radius, record, fit)
        if longer.per_number < max(FOLLOWED, 1.1 * now.per_number):
            break
    return longer


def _loosened(noise: Noise, strengths: tuple[float, float, float]) -> Noise:
    spin, by_spin, turn = strengths
    return replace(noise, spin=spin, by_spin=by_spin, turn=turn)


def _further(task: Task, now: Rival, total: int, share: float) -> tuple[BodyRecord, BodyMotion]:
    """A longer record, and the motion carried on in it as the contacts tell."""
    motion, record = now.fit.motion, now.record
    have = len(record.t) - 1
    wanted = share * min(GROWTH * have * SPACING_S, LONGEST_STEP_S)
    more = min(max(round(wanted / SPACING_S), 1), total - 1 - have)
    p = motion.p
    radius = Y00 * p[0]
    centre = _centre(motion, record)
    belief = BallBelief(
        np.array([math.log(_gyration(p)), p[-3], math.log(max(p[-2], beliefs.FRICTIONLESS)), p[-1], radius]),
        np.array([0.02, 1e-6, 0.02, 0.02, 0.02 * radius]),
        np.concatenate([centre, motion.omega[-1]]),
        np.array([1e-4] * 3 + [0.05] * 3),
    )
    driven = course(task.path, task.contacts, float(record.t[-1]), more, SPACING_S, belief, task.rig.gravity)
    turned = np.cumsum(np.linalg.norm(driven.omega, axis=1)) * SPACING_S
    within = int(np.searchsorted(turned, share * TURN_A_STEP))
    more = min(more, max(within, round(share * SHORTEST_STEP_S / SPACING_S)))
    R = driven.rotations(motion.R[-1])[1 : more + 1]
    longer = lay_out(task.path, task.readings, task.start, have + more, SPACING_S)
    return longer, BodyMotion(
        np.concatenate([motion.R, R]), np.concatenate([motion.omega, driven.omega[1 : more + 1]]), p
    )


def _gyration(p: FloatArray) -> float:
    """Radius of gyration about a mean axis (m)."""
    return float(np.sqrt(np.trace(inertia(p)) / 3))


def inertia(p: FloatArray) -> FloatArray:
    """(3, 3) in the body's frame, per unit mass (m²)."""
    L = np.zeros((3, 3))
    L[np.tril_indices(3)] = p[-9:-3]
    L[np.diag_indices(3)] = np.exp(np.diagonal(L))
    root = MOMENT * Y00 * p[0] * L
    moment = root @ root.T
    about: FloatArray = np.asarray(np.trace(moment) * np.eye(3) - moment, np.float64)
    return about


def _centre(motion: BodyMotion, record: BodyRecord) -> FloatArray:
    """Of mass at the last node (m, world)."""
    centre: FloatArray = centres_of(motion.R[-1:], record.node_palms[-1:], motion.p)[0]
    return centre


def centres_of(R: FloatArray, palms: FloatArray, p: FloatArray) -> FloatArray:
    """(T, 3) centres of mass (m, world) for rotations (T, 3, 3) between palms (T, 36)."""
    normals = palms[:, :9].reshape(-1, 3, 3)
    u = -np.einsum("tji,tnj->tni", R, normals)
    n = len(p) - 9
    h = (evaluator(math.isqrt(n) - 1)(u.reshape(-1, 3))[0] @ p[:n]).reshape(-1, 3)
    return np.asarray(np.linalg.solve(normals, h[..., None])[..., 0])


def curvatures(c: FloatArray, u: FloatArray) -> FloatArray:
    """(T, 2) radii of curvature (m), the smaller first, at outward unit normals (T, 3)."""
    order = math.isqrt(len(c)) - 1
    one = np.cross(u, np.eye(3)[np.abs(u).argmin(axis=1)])
    one /= np.linalg.norm(one, axis=1)[:, None]
    axes = np.stack([one, np.cross(u, one)], axis=1)
    step = 1e-4
    bend = np.empty((len(u), 2, 2))
    for k in range(2):
        ahead, behind = (u + sign * step * axes[:, k] for sign in (1.0, -1.0))
        ahead, behind = (each / np.linalg.norm(each, axis=1)[:, None] for each in (ahead, behind))
        slope = (evaluator(order)(ahead)[1] @ c - evaluator(order)(behind)[1] @ c) / (2 * step)
        bend[:, k] = np.einsum("tki,ti->tk", axes, slope)
    return np.asarray(np.linalg.eigvalsh(0.5 * (bend + bend.transpose(0, 2, 1))))


def best(task: Task) -> list[Rival]:
    """Rivals followed to the end or to where they are lost: who got furthest first, then the cheapest."""
    ended: list[Rival] = []
    for seconds in STARTS_S:
        found = [each for each in rivals(task, seconds)[:KEPT] if each.per_number < HOPELESS]
        for each in found:
            ended.append(grown(task, each))
            if ended[-1].per_number < SURE and task.reaches_end(ended[-1].record):
                return sorted(ended, key=task.rank)
    return sorted(ended, key=task.rank)
