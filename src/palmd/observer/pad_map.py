"""A pad's smooth error of place as a few more constants of a record: eigenfunctions of its prior over what was touched.

The error m(s) is a Gaussian process of covariance a² exp(−Δ²/2l²) without its constant and linear part over the whole
pad, which are its zero and scale. Its strongest eigenfunctions over the touched span are constants of prior one-sigma
1; what they leave of it is white noise, as much larger as readings share the same error. Pure.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from palmd.events import FloatArray
from palmd.observer.factor import Prior
from palmd.observer.normal_equations import Guess
from palmd.observer.record import Record
from palmd.system.description import PadSensor, RigDescription
from palmd.system.mechanism import PALMS

LEFT = 0.1  # of the readings' variance, that what the functions leave may come to (convention)
MOST_FUNCTIONS = 24
"""Of each pad (derivation: 55 mm are 18 correlation lengths of 3 mm, with about one function each)."""
FINEST_M = 1e-4
"""Least correlation length (m): below a reading's own noise an error of place is white noise, and is taken for it."""
STEPS = 12  # of the grid in a correlation length (derivation: linear interpolation is then off by 1/1000 of the error)
BEYOND = 8
"""Of these steps that the functions reach beyond the touched span, where a fit may move contacts (convention)."""

SHARED_READINGS = 150.0
"""Readings that share a smooth error of place, where there is no map of it (study of linearised posteriors and of fits,
10 s at 100 readings/s: covariances are honest with errors of 0.07 and 0.14 mm RMS)."""


def has_map(rig: RigDescription) -> bool:
    """Whether any pad has a smooth error of place."""
    return any(pad.map_sd > 0.0 for pad in rig.pads)


def with_map(
    record: Record, places: FloatArray, prior: Prior, guess: Guess, rig: RigDescription
) -> tuple[Record, Prior, Guess]:
    """The problem of a record with the pads' maps among its constants, after all others.

    rig: that the record was laid out by, maps being noise or nothing. places: of the contacts as a fit predicts them
    (m). At their readings instead a map would follow the noise: at the ends of what was touched a reading is farthest
    out because its noise points there.
    """
    variance, of_pads = record.contact_variance.copy(), list[FloatArray]()
    for number, pad in zip(PALMS, rig.pads, strict=True):
        mine = record.contact_pad == number
        if pad.map_sd == 0.0 or not mine.any():
            continue
        variance[mine] -= pad.map_noise**2
        if pad.map_length < FINEST_M:
            variance[mine] += pad.map_sd**2
            continue
        basis, left = _functions(pad, places[mine], float(variance[mine].min()))
        variance[mine] += left
        of_pads.append(np.zeros((len(mine), basis.shape[1])))
        of_pads[-1][mine] = basis
    columns = np.concatenate([np.zeros((len(places), 0)), *of_pads], axis=1)
    further = columns.shape[1]
    mean, sd = np.concatenate([prior.mean, np.zeros(further)]), np.concatenate([prior.sd, np.ones(further)])
    mapped = replace(record, contact_map=columns, contact_variance=variance)
    return mapped, replace(prior, mean=mean, sd=sd), Guess(guess.x, np.concatenate([guess.p, np.zeros(further)]))


def with_shared_errors(record: Record, rig: RigDescription) -> Record:
    """The record, its readings as uncertain as what many of them share; for covariances without a map.

    rig: that the record was laid out by, maps being noise (`map_as_noise`). So noisy a record is explained by nearly
    every fit, so that it tells no good one from a bad one.
    """
    variances = np.array([(SHARED_READINGS - 1.0) * pad.map_noise**2 for pad in rig.pads])
    shared = variances[record.contact_pad.astype(np.intp) - 1]
    return replace(record, contact_variance=record.contact_variance + shared)


def _functions(pad: PadSensor, places: FloatArray, variance: float) -> tuple[FloatArray, FloatArray]:
    """The eigenfunctions (m) at these places, and what they leave there, as noise of each reading (m²)."""
    low, high = min(float(places.min()), 0.0), max(float(places.max()), pad.length)
    step = pad.map_length / STEPS
    beyond = BEYOND * step
    grid = np.arange(low - beyond, high + beyond + step, step)
    covariance = pad.map_sd**2 * np.exp(-0.5 * np.subtract.outer(grid, grid) ** 2 / pad.map_length**2)
    linear, _ = np.linalg.qr(np.stack([np.ones_like(grid), grid], axis=1))
    covariance -= linear @ (linear.T @ covariance)
    covariance -= (covariance @ linear) @ linear.T
    touched = (grid > places.min() - beyond) & (grid < places.max() + beyond)
    covariance, grid = covariance[np.ix_(touched, touched)], grid[touched]
    alike = _alike(places, pad.map_length)
    functions, left = np.zeros((len(grid), 0)), np.diagonal(covariance).copy()
    for each in _strongest_first(covariance):
        functions, left = np.column_stack([functions, each]), left - each**2
        noise = alike * np.interp(places, grid, np.maximum(left, 0.0))
        if functions.shape[1] == MOST_FUNCTIONS or noise.mean() < LEFT * variance:
            break
    return np.stack([np.interp(places, grid, each) for each in functions.T], axis=1), noise


def _strongest_first(covariance: FloatArray) -> Iterator[FloatArray]:
    values, vectors = np.linalg.eigh(covariance)
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        yield vector * np.sqrt(max(value, 0.0))


def _alike(places: FloatArray, length: float) -> FloatArray:
    """How many readings have about the same error as each: those within half a correlation `length`."""
    ordered = np.sort(places)
    first, last = (np.searchsorted(ordered, places + side * length / 2) for side in (-1, 1))
    return np.asarray(np.maximum(last - first, 1), dtype=np.float64)
