"""A pad's smooth position error as additional constants of a record: eigenfunctions of its prior over the touched span.

The error m(s) is a Gaussian process of covariance a² exp(−Δ²/2l²), without its constant and linear part over the whole
pad, which are the pad's zero and scale. Its strongest eigenfunctions over the touched span are constants of prior 1σ 1;
the remainder is treated as white noise, multiplied by the number of readings that share the same error. Pure.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from palmd.events import FloatArray
from palmd.observer.factor import Prior
from palmd.observer.normal_equations import Guess
from palmd.observer.record import Record, total_duration
from palmd.system.description import PadSensor, RigDescription
from palmd.system.mechanism import PALMS

MOST_REMAINDER = 0.1  # largest remainder, relative to the readings' variance (convention)
MOST_FUNCTIONS = 24
"""Per pad (derivation: 55 mm are 18 correlation lengths of 3 mm, with about one function each)."""
FINEST_M = 1e-4
"""Least correlation length (m): below a reading's own noise a position error is white noise and is treated as such."""
# of the grid per correlation length (derivation: linear interpolation then errs by 1/1000 of the position error)
STEPS = 12
BEYOND = 8
"""Grid steps by which the functions extend beyond the touched span, where a fit may move contacts (convention)."""

SHARED_READINGS, SHARED_S = 150.0, 10.0
"""Readings that share a smooth position error, where there is no map of it, and the time (s) in which they are taken
(study of linearised posteriors and of fits, 10 s at 100 readings/s: covariances are honest with errors of 0.07 and 0.14
mm RMS). In a shorter time, proportionally fewer readings are taken at the same place (derivation)."""


def has_map(rig: RigDescription) -> bool:
    """Whether any pad has a smooth position error."""
    return any(pad.map_sd > 0.0 for pad in rig.pads)


def with_map(
    record: Record, contacts: FloatArray, prior: Prior, guess: Guess, rig: RigDescription
) -> tuple[Record, Prior, Guess]:
    """The problem of a record with the pads' maps appended to its constants.

    rig: by which the record was laid out; its maps are noise or zero. contacts: as a fit predicts them (m). With the
    readings instead, a map would follow the noise: at the ends of the touched span a reading is farthest out because of
    its noise.
    """
    variance, columns_of_pads = record.contact_variance.copy(), list[FloatArray]()
    for number, pad in zip(PALMS, rig.pads, strict=True):
        of_pad = record.contact_pad == number
        if pad.map_sd == 0.0 or not of_pad.any():
            continue
        variance[of_pad] -= pad.map_noise**2
        if pad.map_length < FINEST_M:
            variance[of_pad] += pad.map_sd**2
            continue
        basis, remainder = _functions(pad, contacts[of_pad], float(variance[of_pad].min()))
        variance[of_pad] += remainder
        columns_of_pads.append(np.zeros((len(of_pad), basis.shape[1])))
        columns_of_pads[-1][of_pad] = basis
    columns = np.concatenate([np.zeros((len(contacts), 0)), *columns_of_pads], axis=1)
    added = columns.shape[1]
    mean, sd = np.concatenate([prior.mean, np.zeros(added)]), np.concatenate([prior.sd, np.ones(added)])
    mapped_record = replace(record, contact_map=columns, contact_variance=variance)
    return mapped_record, replace(prior, mean=mean, sd=sd), Guess(guess.x, np.concatenate([guess.p, np.zeros(added)]))


def with_shared_errors(record: Record, rig: RigDescription, alone: bool = False) -> Record:
    """The record with the readings' variance increased by shared errors; for covariances without a map.

    rig: by which the record was laid out; its maps are noise (`map_as_noise`). alone: whether there are no readings
    of the object before the record, with which it would share its errors. Almost every fit explains a record with so
    much noise, so it cannot be used to test a fit.
    """
    shared_readings = SHARED_READINGS * (min(total_duration(record.spans) / SHARED_S, 1.0) if alone else 1.0)
    variances = np.array([_added_variance(pad, shared_readings) for pad in rig.pads])
    shared = variances[record.contact_pad.astype(np.intp) - 1]
    return replace(record, contact_variance=record.contact_variance + shared)


def shared_readings(rig: RigDescription) -> FloatArray:
    """Number of each pad's readings that share one error, for a filter that continues a smoother's estimate.

    rig: with its maps as noise of single readings (`map_as_noise`).
    """
    return np.array([1.0 + _added_variance(pad, SHARED_READINGS) / pad.reading_variance for pad in rig.pads])


def _added_variance(pad: PadSensor, readings: float) -> float:
    """What to add to the variance of a reading (m²) if so many `readings` share the pad's error."""
    return max(readings * pad.map_sd**2 - pad.map_noise**2, 0.0)


def _functions(pad: PadSensor, contacts: FloatArray, variance: float) -> tuple[FloatArray, FloatArray]:
    """The eigenfunctions (m) at these contacts, and the remainder there, as noise of each reading (m²)."""
    low, high = min(float(contacts.min()), 0.0), max(float(contacts.max()), pad.length)
    step = pad.map_length / STEPS
    margin = BEYOND * step
    grid = np.arange(low - margin, high + margin + step, step)
    covariance = pad.map_sd**2 * np.exp(-0.5 * np.subtract.outer(grid, grid) ** 2 / pad.map_length**2)
    linear, _ = np.linalg.qr(np.stack([np.ones_like(grid), grid], axis=1))
    covariance -= linear @ (linear.T @ covariance)
    covariance -= (covariance @ linear) @ linear.T
    touched = (grid > contacts.min() - margin) & (grid < contacts.max() + margin)
    covariance, grid = covariance[np.ix_(touched, touched)], grid[touched]
    shared_by = _shared_by(contacts, pad.map_length)
    functions, remainder = np.zeros((len(grid), 0)), np.diagonal(covariance).copy()
    for each in _strongest_first(covariance):
        functions, remainder = np.column_stack([functions, each]), remainder - each**2
        noise = shared_by * np.interp(contacts, grid, np.maximum(remainder, 0.0))
        if functions.shape[1] == MOST_FUNCTIONS or noise.mean() < MOST_REMAINDER * variance:
            break
    return np.stack([np.interp(contacts, grid, each) for each in functions.T], axis=1), noise


def _strongest_first(covariance: FloatArray) -> Iterator[FloatArray]:
    values, vectors = np.linalg.eigh(covariance)
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        yield vector * np.sqrt(max(value, 0.0))


def _shared_by(contacts: FloatArray, length: float) -> FloatArray:
    """How many readings have about the same error as each one: those within half a correlation `length`."""
    ordered = np.sort(contacts)
    first, last = (np.searchsorted(ordered, contacts + side * length / 2) for side in (-1, 1))
    return np.asarray(np.maximum(last - first, 1), dtype=np.float64)
