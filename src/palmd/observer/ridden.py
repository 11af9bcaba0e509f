"""Where the search begins for what rides: the motion, the side's length and where on it the object stands. Pure.

An object that rides turns with its palm but for what the side gives: on a side that is passed within w, a contact at e
from its middle is at the angle 2 w artanh(2 e / L) from its normal. e is read: by how far the contact on the ridden
palm is from the corner on the other, which both are fixed to the object.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np

from palmd.events import FloatArray
from palmd.model import sharp
from palmd.model.shape import turned
from palmd.model.sharp import FOURIER, LENGTHS, NORMALS, WIDTH
from palmd.model.smoothing import ORDER, C
from palmd.observer.factor import Prior
from palmd.observer.normal_equations import Guess
from palmd.observer.outline import normal_angles, wrapped
from palmd.observer.record import Record
from palmd.observer.rides import TRIM_S, Ride, unexplained
from palmd.system.mechanism import OPENING, PALMS, normal_directions

SPAN, LONGER = (2.0, 98.0), 1.5  # percentiles of e that the side reaches over, and by how much it does
MOST_OUT = 0.95  # of half its length, where a contact may stand at first
MEAN_OF = 5  # readings
WINDOW_SIGMAS = 5.0  # of χ² in a window, beyond which nothing explains its readings
FELT = 25  # normals of a corner
STEP_RAD = 1e-4  # of a normal, for slopes
CORNER_SD_M, SLOPE_SD_M = 3e-5, 1e-4  # of an outline at first, where a corner was felt,
SIDE_SD_M = 1e-3  # and of how high the centre of mass is over the side, and how far from its middle
NEAR_S = 1e-9  # of a node
LEAST_PART_S = 0.3  # of what is left between


def trimmed(rides: Sequence[Ride]) -> list[tuple[float, float]]:
    """From when to when (s) each lasts without its ends."""
    return [(ride.start + TRIM_S, ride.end - TRIM_S) for ride in rides]


def calm(record: Record, residuals: FloatArray) -> list[tuple[float, float]]:
    """The parts (s) of `record` without what is not explained, and `TRIM_S` about it: it tips or rocks there.

    A long ride hides it among all its readings. residuals: of its contacts, in sigmas.
    """
    wrong = list[tuple[float, float]]()
    for pad in PALMS:
        mine = record.contact_pad == pad
        wrong += unexplained(record.contact_t[mine], residuals[mine] ** 2, WINDOW_SIGMAS)
    wrong.sort()
    parts = list[tuple[float, float]]()
    for start, end in record.spans:
        for gone, back in [*(each for each in wrong if each[1] > start and each[0] < end), (end, end)]:
            if gone - start > LEAST_PART_S:
                parts.append((start, gone))
            start = max(start, back)
    return parts


def kept(guess: Guess, own: FloatArray, wanted: FloatArray) -> Guess:
    """The same of the nodes at the times `wanted` of `own`, ψ beginning at 0: the outline turns instead."""
    x = guess.x[np.searchsorted(own, wanted - NEAR_S)]
    return rotated(Guess(x, guess.p), float(x[0, 0]))


def rotated(guess: Guess, turn: float) -> Guess:
    """The same in a frame in which all normals are greater by `turn` (rad)."""
    p = guess.p.copy()
    p[C.SHAPE : NORMALS] = turned(-turn, ORDER) @ p[C.SHAPE : NORMALS]
    p[NORMALS:LENGTHS] += turn
    return Guess(guess.x - (turn, 0.0), p)


def turning(record: Record, palm: int) -> FloatArray:
    """Angle since the first node and rate (K + 1, 2) of what turns with the palm (0, 1)."""
    joints = len(PALMS)
    angle, spin = (record.palms[:, j : j + palm + 1].sum(axis=1) for j in (0, joints))
    return np.stack([angle - angle[0], spin], axis=1)


def normal_at_first(record: Record, palm: int) -> float:
    """Normal (rad) by which the palm feels what is not turned yet."""
    return float(normal_directions(tuple(record.palms[0, : len(PALMS)]), 0.0)[palm])


def outline_through(
    p: FloatArray,
    normals: FloatArray,
    wanted: tuple[FloatArray, FloatArray],
    sd: tuple[FloatArray, FloatArray],
    prior: Prior,
    sides: int,
) -> FloatArray:
    """The constants `p` with that outline which has h and h′ (m) as `wanted` on `normals` (rad), by least squares.

    sd: by how much not. Besides the series the lengths of the first `sides` are free; where they are is as in p.
    """
    here, after, before = (sharp.outline_rows(normals + by, p) for by in (0.0, STEP_RAD, -STEP_RAD))
    rows = np.concatenate([here / sd[0][:, None], (after - before) / (2 * STEP_RAD * sd[1][:, None])])
    linear = np.concatenate([np.arange(FOURIER), LENGTHS - C.SHAPE + np.arange(sides)])
    held = np.arange(LENGTHS + sides, WIDTH) - C.SHAPE
    misses = np.concatenate([wanted[0] / sd[0], wanted[1] / sd[1]]) - rows[:, held] @ p[C.SHAPE :][held]
    mean, own_sd = prior.mean[C.SHAPE :][linear], prior.sd[C.SHAPE :][linear]
    p = p.copy()
    p[C.SHAPE + linear] = np.linalg.lstsq(
        np.concatenate([rows[:, linear], np.diag(1.0 / own_sd)]), np.concatenate([misses, mean / own_sd]), rcond=None
    )[0]
    return p


def begun(record: Record, palm: int, corner: FloatArray, p: FloatArray, prior: Prior) -> Guess:
    """The motion on the parts of `record`, and the constants `p`, of one side, with its length and where it is.

    The corner on the other palm is put into the outline, where `corner` (Y and ρ, m) and the readings have it.
    """
    high, rho = corner
    mine = record.contact_pad == PALMS[palm]
    t, opening = record.contact_t[mine], record.contact_palms[mine, OPENING]
    e = record.contact_value[mine] - (rho + high * np.cos(opening)) / np.sin(opening)
    low, most = np.percentile(e, SPAN)
    p = p.copy()
    p[LENGTHS] = max(LONGER * float(most - low), p[LENGTHS])
    away = np.empty((len(record.t), 2))
    for (start, end), nodes in zip(record.spans, np.split(np.arange(len(record.t)), record.torn + 1), strict=True):
        part = slice(*np.searchsorted(t, (start, end)))
        padded = np.pad(e[part], MEAN_OF // 2, mode="edge")
        mean = np.convolve(padded, np.full(MEAN_OF, 1.0 / MEAN_OF), "valid")
        out = (2.0 / p[LENGTHS]) * (np.interp(record.t[nodes], t[part], mean) - (low + most) / 2)
        angle = 2.0 * math.exp(p[WIDTH]) * np.arctanh(np.clip(out, -MOST_OUT, MOST_OUT)) * (1.0, -1.0)[palm]
        away[nodes] = np.stack([angle, np.gradient(angle, record.t[nodes])], axis=1)
    x = turning(record, palm) - away
    near, far = np.percentile(normal_angles(record.palms, x[:, 0])[:, 1 - palm], SPAN)
    felt = np.linspace(near, far, FELT)
    side = p[NORMALS : NORMALS + 1]
    along = cmath.exp(1j * float(side[0])) * complex(p[C.SHAPE] - high, (-1.0, 1.0)[palm] * (low + most) / 2)
    from_centre = along * np.exp(-1j * felt)
    wanted = np.append(from_centre.real + rho, p[C.SHAPE]), np.append(from_centre.imag, 0.0)
    sd = np.append(np.full(FELT, CORNER_SD_M), SIDE_SD_M), np.append(np.full(FELT, SLOPE_SD_M), SIDE_SD_M)
    return Guess(x, outline_through(p, np.append(felt, side), wanted, sd, prior, 0))


def narrowed(guess: Guess, record: Record, palm: int, width: float) -> Guess:
    """The same contacts on a side that is passed within `width` (rad): it gives as much less."""
    give = 1.0 - width / math.exp(guess.p[WIDTH])
    p = guess.p.copy()
    p[WIDTH] = math.log(width)
    away = wrapped(normal_angles(record.palms, guess.x[:, 0])[:, palm] - p[NORMALS])
    spin = turning(record, palm)[:, 1] - guess.x[:, 1]
    return Guess(guess.x + give * np.stack([away, spin], axis=1), p)
