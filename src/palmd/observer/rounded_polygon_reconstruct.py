"""Reconstruct an object with corners that has lain on several of its sides, as a rounded polygon (decision 55)."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palmd.events import FloatArray
from palmd.model.smoothing import RIG, C
from palmd.observer.data_association import (
    STAYS_S,
    Association,
    ModeEstimate,
    anchor_of,
    associated,
    certain,
    mode_estimate,
)
from palmd.observer.flat_side_fits import LEAST_S, LN_GYRATION, LN_GYRATION_SD
from palmd.observer.mass import MassEstimator
from palmd.observer.mode_initialisation import trimmed_spans
from palmd.observer.mode_model import SegmentReadings, SupportFrame, balance
from palmd.observer.mode_segments import TRIM_S, ModeSegment, group_by_mode
from palmd.observer.outline import directions, normal_angles, rms_sd, sd_of, touched_within
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.record import IntArray, Record, total_duration
from palmd.observer.rounded_polygon import discs, side_normals, support, turned
from palmd.observer.rounded_polygon_fit import RoundedPolygonFit, SharedPrior, fit_rounded_polygon
from palmd.observer.search import Search
from palmd.observer.shape_classification import root_of, shape_class
from palmd.observer.validity import SHARP_M
from palmd.observer.visits import visits_of
from palmd.system.mechanism import PALMS, normal_directions
from palmd.system.rig_constants import declared_exact

LEAST_MODES = 4  # different contact modes, for an object that has lain on several sides
OVERLAP_S = 0.05  # that two segments may overlap: a reading that ends one may begin the other
GYRATION_SD = 0.2  # 1σ of ln of the radius of gyration, while segments are fitted one by one
HELD_SD = 0.02  # 1σ of the same in the joint fit: an object that rocks a little would bias it
MEAN_RADIUS_RATIO = 1.08  # mean radius, relative to the sides' height
# least share of the segments' time that is associated; of their readings that are taken while the object lies still
EXPLAINED, STILL = 0.8, 0.5
MOST_CHI2, SEGMENT_SIGMAS = 1.15, 6.0  # per reading, over all of them; σ by which one segment's readings may exceed it
# twice the log-likelihood by which a rival may be worse and still count; RMS difference (m) of another outline
DOUBT, DIFFERENT_M = 30.0, 1e-4
# model error of h, as sides yield and corners roll; factor by which 1σ is inflated
MODEL_SD_M, OVERCONFIDENCE = 1e-5, 1.5


def rounded_polygon_reconstruction(
    search: Search, record: Record, mode_segments: Sequence[ModeSegment], started: float
) -> Reconstruction | None:
    """Outline of the polygon on whose sides the object has lain; None where it is in doubt.

    record: the data segment of `search`, and others that may be of the same object.
    mode_segments: all contact-mode segments of `record`.
    started: when the reconstruction was started (`time.perf_counter`).
    """
    if not declared_exact(search.rig):
        return None
    segments = _without_overlaps(mode_segments)
    if len(group_by_mode(segments)) < LEAST_MODES or not any(segment.excludes_disc for segment in segments):
        return None
    shared_prior = _shared_prior(search, float(search.prior.mean[C.SHAPE]), GYRATION_SD)
    law = search.rig.vibration.law
    readings = [
        SegmentReadings.of(record, segment, TRIM_S, law)
        for segment in sorted(segments, key=lambda segment: segment.start)
    ]
    estimated = [
        (estimate, each)
        for each in readings
        if (estimate := mode_estimate(each, shared_prior.mean, shared_prior.sd)) is not None
    ]
    estimates, readings = [estimate for estimate, _ in estimated], [each for _, each in estimated]
    if len(estimates) < LEAST_MODES:
        return None
    shared_prior = _shared_prior(
        search, MEAN_RADIUS_RATIO * float(np.median([estimate.value[3] for estimate in estimates])), HELD_SD
    )
    rivals = associated(estimates, DOUBT)
    if not rivals:
        return None
    best = rivals[0]
    if _used_duration(estimates, best.used) < EXPLAINED * total_duration(
        [span for span in trimmed_spans(segments) if span[1] > span[0]]
    ):
        return None
    used = certain(rivals, np.array([estimate.segment.lasts for estimate in estimates]))
    fit = fit_rounded_polygon(estimates, readings, replace(best, used=used), shared_prior)
    if fit is None or _used_duration(estimates, fit.association.used) < LEAST_S or _is_doubtful(fit, readings):
        return None
    return _result(fit, rivals, search, record, started)


def _shared_prior(search: Search, radius: float, sd: float) -> SharedPrior:
    """Prior of the shared numbers for an object of this mean radius (m); `sd` is of ln of the radius of gyration."""
    prior, friction = search.prior, [C.DRAG, C.SATURATION]
    mean = np.array([LN_GYRATION + math.log(radius), *prior.mean[friction]])
    return SharedPrior(mean, np.array([sd, *prior.sd[friction]]))


def _without_overlaps(segments: Sequence[ModeSegment]) -> list[ModeSegment]:
    """The segments, longest first, without those that overlap a longer one."""
    kept = list[ModeSegment]()
    for segment in sorted(segments, key=lambda segment: -segment.lasts):
        if all(min(segment.end, other.end) - max(segment.start, other.start) < OVERLAP_S for other in kept):
            kept.append(segment)
    return kept


def _used_duration(estimates: Sequence[ModeEstimate], used: IntArray) -> float:
    """Total duration (s) of the segments used, without their ends."""
    return total_duration(
        trimmed_spans([estimate.segment for estimate, each in zip(estimates, used, strict=True) if each])
    )


def _is_doubtful(fit: RoundedPolygonFit, segments: Sequence[SegmentReadings]) -> bool:
    """Whether the fit has not converged, explains too few readings, or does not explain a segment."""
    readings_used = sum(len(each.t) for each, used in zip(segments, fit.association.used, strict=True) if used)
    if sum(len(each.t) for each in fit.segments) < STILL * readings_used or not fit.settled or fit.chi2 > MOST_CHI2:
        return True
    return any(
        float(np.sum(each[of_palm] ** 2)) > of_palm.sum() * MOST_CHI2 + SEGMENT_SIGMAS * math.sqrt(2.0 * of_palm.sum())
        for each, observed in zip(fit.residuals, fit.segments, strict=True)
        for of_palm in (observed.on_support, ~observed.on_support)
    )


def _result(
    fit: RoundedPolygonFit, rivals: Sequence[Association], search: Search, whole: Record, started: float
) -> Reconstruction | None:
    """The result; None where rivals disagree or the outline is too uncertain."""
    record, psi, spin = _motion(fit, whole)
    turn = float(psi[0])
    p, psi = turned(fit.p, turn), psi - turn
    covariance = OVERCONFIDENCE**2 * _turned_covariance(fit, turn)
    normals, theta = normal_angles(record.palms, psi), directions()
    touched = touched_within(record, psi)
    anchor = anchor_of(rivals, fit.association.used)
    if anchor is None:
        return None
    relative_normals = theta[touched] - side_normals(p)[fit.association.sides[anchor]]
    if not _rivals_agree(rivals, anchor, relative_normals):
        return None
    h, slope, rows = support(p, theta)
    turns = slope[touched] @ rows[touched] / max(float(slope[touched] @ slope[touched]), 1e-30)
    gauge_free = rows - np.outer(slope, turns)
    h_sd = np.hypot(sd_of(gauge_free, covariance), MODEL_SD_M)
    if rms_sd(h_sd, touched) > SHARP_M:
        return None
    mass = _mass_of(fit, whole, search)
    shared_sd = OVERCONFIDENCE * np.sqrt(np.diagonal(fit.covariance)[len(p) :])
    rho = math.exp(LN_GYRATION) * float(h.mean())  # that of a uniform body: the readings do not determine it
    return Reconstruction(
        converged=True, chi2=fit.chi2,
        theta=theta, h=h, h_sd=h_sd, touched=touched,
        visits=np.sum([visits_of(part) for part in np.split(normals, record.gap_steps + 1)], axis=0),
        rho=rho, rho_sd=rho * LN_GYRATION_SD, mu=float(fit.shared[1]), mu_sd=float(shared_sd[1]),
        mass=mass.value, mass_sd=mass.sd, rig=search.prior.mean[RIG], rig_covariance=np.diag(search.prior.sd[RIG] ** 2),
        contradicted=search.belief.contradicted, rig_prior_sd=search.belief.sd,
        t=record.t, psi=psi, omega0=spin, radii=np.stack([support(p, each)[0] for each in normals.T]),
        seconds=time.perf_counter() - started,
        sides=_sides(fit, p, covariance), shape_class=shape_class(theta, h, root_of(rows, covariance), touched),
    )  # fmt: skip


def _motion(fit: RoundedPolygonFit, whole: Record) -> tuple[Record, FloatArray, FloatArray]:
    """Parts of `whole` while the object lies still, with ψ (rad) and its rate at the nodes.

    ψ follows the supporting palm.
    """
    stays = list[tuple[float, float, int, int]]()
    for observed, side in zip(fit.segments, fit.sides.tolist(), strict=True):
        start, end, palm = float(observed.t[0]), float(observed.t[-1]), observed.segment.palm
        before = stays[-1] if stays else None
        if (
            before is not None
            and before[2:] == (palm, side)
            and observed.segment.start - before[1] < STAYS_S + 2 * TRIM_S
        ):
            start = stays.pop()[0]
        stays.append((start, end, palm, side))
    record = whole.within([each[:2] for each in stays])
    normals, psi, spin = side_normals(fit.p), list[FloatArray](), list[FloatArray]()
    starts = [start for start, *_ in stays]
    for nodes in np.split(np.arange(len(record.t)), record.gap_steps + 1):  # a contact may be lost meanwhile
        _, _, palm, side = stays[int(np.searchsorted(starts, record.t[nodes[-1]])) - 1]
        palms = record.palms[nodes]
        unturned = normal_directions(palms[:, : len(PALMS)].T, 0.0)[palm]
        psi.append(unturned - normals[side])
        spin.append(palms[:, len(PALMS) : len(PALMS) + palm + 1].sum(axis=1))
    return record, np.concatenate(psi), np.concatenate(spin)


def _turned_covariance(fit: RoundedPolygonFit, turn: float) -> FloatArray:
    """Covariance of the outline's numbers after a turn (rad) of the frame."""
    count = len(fit.p) // 3
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.kron(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.eye(count))
    own = len(fit.p)
    covariance: FloatArray = rotation @ fit.covariance[:own, :own] @ rotation.T
    return covariance


def _rivals_agree(rivals: Sequence[Association], anchor: int, relative_normals: FloatArray) -> bool:
    """Whether all rivals have the same outline on normals (rad) given relative to the side of mode `anchor`."""
    outlines = [support(each.p, relative_normals + side_normals(each.p)[each.sides[anchor]])[0] for each in rivals]
    return all(float(np.sqrt(np.mean((h - outlines[0]) ** 2))) < DIFFERENT_M for h in outlines)


def _mass_of(fit: RoundedPolygonFit, whole: Record, search: Search) -> MassEstimator:
    """Mass, from the forces on either pad while the object lies still."""
    mass = MassEstimator(search.rig.pads)
    for which, observed in enumerate(fit.segments):
        during = (whole.force_t > observed.t[0]) & (whole.force_t < observed.t[-1])
        frame = SupportFrame.by(observed.segment.palm, whole.force_palms[during], whole.rig)
        predicted = balance(fit.parameters(which), fit.shared, frame, observed.law)
        on_support = whole.force_pad[during] == PALMS[observed.segment.palm]
        pressed = np.where(on_support, predicted.support_force, predicted.other_force)
        for pad, force, expected in zip(whole.force_pad[during], whole.force_value[during], pressed, strict=True):
            mass.feed(int(pad), float(force), float(expected))
    return mass


def _sides(fit: RoundedPolygonFit, p: FloatArray, covariance: FloatArray) -> FloatArray:
    """Normal (rad), length and its 1σ (m) of each side both of whose corners were touched."""
    centres, _ = discs(p)
    touched, normals, count = set(fit.corners.tolist()), side_normals(p), len(centres)
    rows = list[tuple[float, float, float]]()
    for side in sorted(side for side in range(count) if {side, (side + 1) % count} <= touched):
        end = (side + 1) % count
        along = (centres[end] - centres[side]) / abs(centres[end] - centres[side])
        row = np.zeros((1, len(p)))
        row[0, [end, side, count + end, count + side]] = along.real, -along.real, along.imag, -along.imag
        length = abs(centres[end] - centres[side])
        rows.append((math.remainder(normals[side], math.tau), length, float(sd_of(row, covariance)[0])))
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
