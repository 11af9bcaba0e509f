"""What a record tells of an object with corners that has lain on several of its sides: as `reconstruct` gives it."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palmd.events import FloatArray
from palmd.model.smoothing import RIG, C
from palmd.observer.cornered import discs, side_normals, supported, turned
from palmd.observer.cornered_fit import CorneredFit, Shared, fitted
from palmd.observer.lying import Carried, RideReadings, balance
from palmd.observer.mass import MassEstimator
from palmd.observer.outline import directions, normal_angles, sd_of, touched_within
from palmd.observer.places import STAYS_S, Places, Seat, anchor_of, certain, placed, seat_of
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.record import IntArray, Record, lasting
from palmd.observer.ridden import trimmed
from palmd.observer.rides import TRIM_S, Ride, same
from palmd.observer.search import Search
from palmd.observer.shape_classification import root_of, shape_class
from palmd.observer.sided_fits import LEAST_S, LN_GYRATION, LN_GYRATION_SD
from palmd.observer.validity import SHARP_M
from palmd.observer.visits import visits_of
from palmd.system.mechanism import PALMS, normal_directions
from palmd.system.rig_constants import declared_exact

LEAST_SEATS = 4  # rides that differ, of an object that has lain on several sides
OVERLAP_S = 0.05  # of two rides, as readings that end one may begin the other
GYRATION_SD = 0.2  # of ln of the radius of gyration, while rides are looked at one by one
HELD_SD = 0.02  # and then: what rocks a little would tell it wrong, so it is held
ROUND = 1.08  # of the sides' height, the mean radius
EXPLAINED, STILL = 0.8, 0.5  # of the rides' time, that has a place; of their readings, while the object lies still
MOST_CHI2, RIDE_SIGMAS = 1.15, 6.0  # of all readings; of one ride's
DOUBT, DIFFERENT_M = 30.0, 1e-4  # of twice the log-likelihood, that a rival lacks which need not be alike; how alike
MODEL_SD_M, OVERCONFIDENCE = 1e-5, 1.5  # of an outline besides, as sides give and corners roll


def cornered_reconstruction(
    search: Search, record: Record, ridden: Sequence[Ride], begun: float
) -> Reconstruction | None:
    """The outline on whose sides the object has lain; None where there is any doubt.

    record, ridden: the segment of `search`, and others in which the same object may have ridden, and all rides of them.
    """
    if not declared_exact(search.rig):
        return None
    rides = _apart(ridden)
    if len(same(rides)) < LEAST_SEATS or not any(ride.rolls for ride in rides):
        return None
    shared = _believed(search, float(search.prior.mean[C.SHAPE]), GYRATION_SD)
    law = search.rig.vibration.law
    whole = [RideReadings.of(record, ride, TRIM_S, law) for ride in sorted(rides, key=lambda ride: ride.start)]
    both = [(seat, each) for each in whole if (seat := seat_of(each, shared.mean, shared.sd)) is not None]
    told, whole = [seat for seat, _ in both], [each for _, each in both]
    if len(told) < LEAST_SEATS:
        return None
    shared = _believed(search, ROUND * float(np.median([seat.value[3] for seat in told])), HELD_SD)
    rivals = placed(told, DOUBT)
    if not rivals:
        return None
    best = rivals[0]
    if _lasting(told, best.used) < EXPLAINED * lasting([span for span in trimmed(rides) if span[1] > span[0]]):
        return None
    used = certain(rivals, np.array([seat.ride.lasts for seat in told]))
    fit = fitted(told, whole, replace(best, used=used), shared)
    if fit is None or _lasting(told, fit.places.used) < LEAST_S or _doubtful(fit, whole):
        return None
    return _told(fit, rivals, search, record, begun)


def _believed(search: Search, radius: float, sd: float) -> Shared:
    """Of what all rides share, of an object of this mean radius (m), the radius of gyration to `sd` of its ln."""
    prior, friction = search.prior, [C.DRAG, C.SATURATION]
    mean = np.array([LN_GYRATION + math.log(radius), *prior.mean[friction]])
    return Shared(mean, np.array([sd, *prior.sd[friction]]))


def _apart(rides: Sequence[Ride]) -> list[Ride]:
    """These, longest first, but for those that overlap a longer one."""
    kept = list[Ride]()
    for ride in sorted(rides, key=lambda ride: -ride.lasts):
        if all(min(ride.end, other.end) - max(ride.start, other.start) < OVERLAP_S for other in kept):
            kept.append(ride)
    return kept


def _lasting(told: Sequence[Seat], used: IntArray) -> float:
    """How long (s) the rides last that are used, but for their ends."""
    return lasting(trimmed([seat.ride for seat, each in zip(told, used, strict=True) if each]))


def _doubtful(fit: CorneredFit, whole: Sequence[RideReadings]) -> bool:
    there = sum(len(each.t) for each, used in zip(whole, fit.places.used, strict=True) if used)
    if sum(len(each.t) for each in fit.lyings) < STILL * there or not fit.settled or fit.chi2 > MOST_CHI2:
        return True
    return any(
        float(np.sum(each[mine] ** 2)) > mine.sum() * MOST_CHI2 + RIDE_SIGMAS * math.sqrt(2.0 * mine.sum())
        for each, lying in zip(fit.residuals, fit.lyings, strict=True)
        for mine in (lying.on_ridden, ~lying.on_ridden)
    )


def _told(
    fit: CorneredFit, rivals: Sequence[Places], search: Search, whole: Record, begun: float
) -> Reconstruction | None:
    """None where rivals tell otherwise, or it tells too little."""
    record, psi, spin = _motion(fit, whole)
    turn = float(psi[0])
    p, psi = turned(fit.p, turn), psi - turn
    covariance = OVERCONFIDENCE**2 * _turned_covariance(fit, turn)
    normals, theta = normal_angles(record.palms, psi), directions()
    touched = touched_within(record, psi)
    anchor = anchor_of(rivals, fit.places.used)
    if anchor is None:
        return None
    there = theta[touched] - side_normals(p)[fit.places.sides[anchor]]
    if not _alike(rivals, anchor, there):
        return None
    h, slope, rows = supported(p, theta)
    by = slope[touched] @ rows[touched] / max(float(slope[touched] @ slope[touched]), 1e-30)
    free = rows - np.outer(slope, by)
    h_sd = np.hypot(sd_of(free, covariance), MODEL_SD_M)
    if float(np.sqrt(np.mean(h_sd[touched] ** 2))) > SHARP_M:
        return None
    mass = _weighed(fit, whole, search)
    shared_sd = OVERCONFIDENCE * np.sqrt(np.diagonal(fit.covariance)[len(p) :])
    rho = math.exp(LN_GYRATION) * float(h.mean())  # as of an even body: it is not told
    return Reconstruction(
        converged=True, chi2=fit.chi2,
        theta=theta, h=h, h_sd=h_sd, touched=touched,
        visits=np.sum([visits_of(part) for part in np.split(normals, record.torn + 1)], axis=0),
        rho=rho, rho_sd=rho * LN_GYRATION_SD, mu=float(fit.shared[1]), mu_sd=float(shared_sd[1]),
        mass=mass.value, mass_sd=mass.sd, rig=search.prior.mean[RIG], rig_covariance=np.diag(search.prior.sd[RIG] ** 2),
        contradicted=search.belief.contradicted, rig_prior_sd=search.belief.sd,
        t=record.t, psi=psi, omega0=spin, radii=np.stack([supported(p, each)[0] for each in normals.T]),
        reason="", seconds=time.perf_counter() - begun,
        sides=_sides(fit, p, covariance), shape_class=shape_class(theta, h, root_of(rows, covariance), touched),
    )  # fmt: skip


def _motion(fit: CorneredFit, whole: Record) -> tuple[Record, FloatArray, FloatArray]:
    """The parts of `whole` in which it lies, ψ (rad) and its rate at the nodes: those of the palm that it lies on."""
    stays = list[tuple[float, float, int, int]]()
    for lying, side in zip(fit.lyings, fit.sides.tolist(), strict=True):
        start, end, palm = float(lying.t[0]), float(lying.t[-1]), lying.ride.palm
        before = stays[-1] if stays else None
        if before is not None and before[2:] == (palm, side) and lying.ride.start - before[1] < STAYS_S + 2 * TRIM_S:
            start = stays.pop()[0]
        stays.append((start, end, palm, side))
    record = whole.within([each[:2] for each in stays])
    normals, psi, spin = side_normals(fit.p), list[FloatArray](), list[FloatArray]()
    starts = [start for start, *_ in stays]
    for nodes in np.split(np.arange(len(record.t)), record.torn + 1):  # a contact may be lost during a stay
        _, _, palm, side = stays[int(np.searchsorted(starts, record.t[nodes[-1]])) - 1]
        palms = record.palms[nodes]
        unturned = normal_directions(palms[:, : len(PALMS)].T, 0.0)[palm]
        psi.append(unturned - normals[side])
        spin.append(palms[:, len(PALMS) : len(PALMS) + palm + 1].sum(axis=1))
    return record, np.concatenate(psi), np.concatenate(spin)


def _turned_covariance(fit: CorneredFit, turn: float) -> FloatArray:
    """Of the outline's numbers, after a turn (rad) of the frame."""
    count = len(fit.p) // 3
    c, s = math.cos(turn), math.sin(turn)
    by = np.kron(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.eye(count))
    own = len(fit.p)
    covariance: FloatArray = by @ fit.covariance[:own, :own] @ by.T
    return covariance


def _alike(rivals: Sequence[Places], anchor: int, away: FloatArray) -> bool:
    """Whether all rivals are the same outline on these normals (rad), away from that of the side of seat `anchor`."""
    outlines = [supported(each.p, away + side_normals(each.p)[each.sides[anchor]])[0] for each in rivals]
    return all(float(np.sqrt(np.mean((h - outlines[0]) ** 2))) < DIFFERENT_M for h in outlines)


def _weighed(fit: CorneredFit, whole: Record, search: Search) -> MassEstimator:
    """By what presses on either pad while it lies."""
    mass = MassEstimator(search.rig.pads)
    for which, lying in enumerate(fit.lyings):
        mine = (whole.force_t > lying.t[0]) & (whole.force_t < lying.t[-1])
        carried = Carried.by(lying.ride.palm, whole.force_palms[mine], whole.rig)
        there = balance(fit.seat(which), fit.shared, carried, lying.law)
        on_ridden = whole.force_pad[mine] == PALMS[lying.ride.palm]
        pressed = np.where(on_ridden, there.ridden_force, there.other_force)
        for pad, force, expected in zip(whole.force_pad[mine], whole.force_value[mine], pressed, strict=True):
            mass.feed(int(pad), float(force), float(expected))
    return mass


def _sides(fit: CorneredFit, p: FloatArray, covariance: FloatArray) -> FloatArray:
    """Normal (rad), length and its one-sigma (m) of each side whose corners both were felt."""
    centres, _ = discs(p)
    felt, normals, count = set(fit.corners.tolist()), side_normals(p), len(centres)
    rows = list[tuple[float, float, float]]()
    for side in sorted(side for side in range(count) if {side, (side + 1) % count} <= felt):
        end = (side + 1) % count
        along = (centres[end] - centres[side]) / abs(centres[end] - centres[side])
        by = np.zeros((1, len(p)))
        by[0, [end, side, count + end, count + side]] = along.real, -along.real, along.imag, -along.imag
        length = abs(centres[end] - centres[side])
        rows.append((math.remainder(normals[side], math.tau), length, float(sd_of(by, covariance)[0])))
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
