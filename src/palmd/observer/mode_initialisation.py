"""Initial guess of a fit to contact-mode segments: motion, the side's length, and where on it the object stands. Pure.

The object turns with its supporting palm, but for what the side yields: on a side that is passed within w, a contact at
e from its middle is at the angle 2 w artanh(2 e / L) from its normal. e follows from the readings: the distance of the
contact on the supporting palm from the corner on the other palm, both of which are fixed to the object.
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
from palmd.observer.mode_segments import TRIM_S, ModeSegment, rejected_windows
from palmd.observer.normal_equations import Guess
from palmd.observer.outline import normal_angles, wrapped
from palmd.observer.record import Record
from palmd.system.mechanism import OPENING, PALMS, normal_directions

SPAN, LONGER = (2.0, 98.0), 1.5  # percentiles of e over which the side extends; factor on its length
MOST_OUT = 0.95  # of half the side's length, where a contact may be initially
MEAN_OF = 5  # readings of the moving average
WINDOW_SIGMAS = 5.0  # of χ² in a window, beyond which its readings are not explained
CORNER_NORMALS = 25  # normals of a corner
STEP_RAD = 1e-4  # of a normal, for difference quotients
CORNER_SD_M, SLOPE_SD_M = 3e-5, 1e-4  # 1σ of h and h′ of the initial outline, where a corner was touched,
SIDE_SD_M = 1e-3  # and of how high the centre of mass is over the side, and how far from its middle
NEAR_S = 1e-9  # tolerance of a node's time
LEAST_PART_S = 0.3  # of the remaining parts


def trimmed_spans(segments: Sequence[ModeSegment]) -> list[tuple[float, float]]:
    """Time spans (s) of the segments without their ends."""
    return [(segment.start + TRIM_S, segment.end - TRIM_S) for segment in segments]


def explained_spans(record: Record, residuals: FloatArray) -> list[tuple[float, float]]:
    """Spans (s) of `record` that are explained, without `TRIM_S` about the others: the object tips or rocks there.

    A long segment hides unexplained readings among all its readings. residuals: of its contacts, normalised.
    """
    rejected = list[tuple[float, float]]()
    for pad in PALMS:
        mine = record.contact_pad == pad
        rejected += rejected_windows(record.contact_t[mine], residuals[mine] ** 2, WINDOW_SIGMAS)
    rejected.sort()
    parts = list[tuple[float, float]]()
    for start, end in record.spans:
        for gap_start, gap_end in [*(each for each in rejected if each[1] > start and each[0] < end), (end, end)]:
            if gap_start - start > LEAST_PART_S:
                parts.append((start, gap_start))
            start = max(start, gap_end)
    return parts


def on_nodes(guess: Guess, own: FloatArray, wanted: FloatArray) -> Guess:
    """The guess on the nodes at the times `wanted` of `own`, rotated so that ψ = 0 at the first."""
    x = guess.x[np.searchsorted(own, wanted - NEAR_S)]
    return rotated(Guess(x, guess.p), float(x[0, 0]))


def rotated(guess: Guess, turn: float) -> Guess:
    """The guess in a frame in which all normals are greater by `turn` (rad)."""
    p = guess.p.copy()
    p[C.SHAPE : NORMALS] = turned(-turn, ORDER) @ p[C.SHAPE : NORMALS]
    p[NORMALS:LENGTHS] += turn
    return Guess(guess.x - (turn, 0.0), p)


def palm_turn(record: Record, palm: int) -> FloatArray:
    """Angle since the first node and rate (K + 1, 2) of an object that turns with the palm (0, 1)."""
    joints = len(PALMS)
    angle, spin = (record.palms[:, j : j + palm + 1].sum(axis=1) for j in (0, joints))
    return np.stack([angle - angle[0], spin], axis=1)


def initial_normal(record: Record, palm: int) -> float:
    """Normal (rad) by which an object with ψ = 0 touches the palm at the first node."""
    return float(normal_directions(tuple(record.palms[0, : len(PALMS)]), 0.0)[palm])


def outline_through(
    p: FloatArray,
    normals: FloatArray,
    targets: tuple[FloatArray, FloatArray],
    sd: tuple[FloatArray, FloatArray],
    prior: Prior,
    sides: int,
) -> FloatArray:
    """The constants `p` with the outline whose h and h′ (m) on `normals` (rad) fit `targets` by least squares.

    sd: 1σ of h and h′. Free are the series and the lengths of the first `sides`; the sides' normals are those of p.
    """
    rows_here, rows_after, rows_before = (sharp.outline_rows(normals + by, p) for by in (0.0, STEP_RAD, -STEP_RAD))
    rows = np.concatenate([rows_here / sd[0][:, None], (rows_after - rows_before) / (2 * STEP_RAD * sd[1][:, None])])
    linear = np.concatenate([np.arange(FOURIER), LENGTHS - C.SHAPE + np.arange(sides)])
    held = np.arange(LENGTHS + sides, WIDTH) - C.SHAPE
    residuals = np.concatenate([targets[0] / sd[0], targets[1] / sd[1]]) - rows[:, held] @ p[C.SHAPE :][held]
    mean, own_sd = prior.mean[C.SHAPE :][linear], prior.sd[C.SHAPE :][linear]
    p = p.copy()
    p[C.SHAPE + linear] = np.linalg.lstsq(
        np.concatenate([rows[:, linear], np.diag(1.0 / own_sd)]), np.concatenate([residuals, mean / own_sd]), rcond=None
    )[0]
    return p


def initial_guess(record: Record, palm: int, corner: FloatArray, p: FloatArray, prior: Prior) -> Guess:
    """Motion on the parts of `record`, and the constants `p` with one side: its length and position.

    The corner on the other palm is added to the outline, from its parameters `corner` (Y and ρ, m) and the readings.
    """
    height, rho = corner
    of_pad = record.contact_pad == PALMS[palm]
    t, opening = record.contact_t[of_pad], record.contact_palms[of_pad, OPENING]
    e = record.contact_value[of_pad] - (rho + height * np.cos(opening)) / np.sin(opening)
    least, most = np.percentile(e, SPAN)
    p = p.copy()
    p[LENGTHS] = max(LONGER * float(most - least), p[LENGTHS])
    yielded = np.empty((len(record.t), 2))
    for (start, end), nodes in zip(record.spans, np.split(np.arange(len(record.t)), record.gap_steps + 1), strict=True):
        part = slice(*np.searchsorted(t, (start, end)))
        padded = np.pad(e[part], MEAN_OF // 2, mode="edge")
        smoothed_e = np.convolve(padded, np.full(MEAN_OF, 1.0 / MEAN_OF), "valid")
        offset = (2.0 / p[LENGTHS]) * (np.interp(record.t[nodes], t[part], smoothed_e) - (least + most) / 2)
        angle = 2.0 * math.exp(p[WIDTH]) * np.arctanh(np.clip(offset, -MOST_OUT, MOST_OUT)) * (1.0, -1.0)[palm]
        yielded[nodes] = np.stack([angle, np.gradient(angle, record.t[nodes])], axis=1)
    x = palm_turn(record, palm) - yielded
    first, last = np.percentile(normal_angles(record.palms, x[:, 0])[:, 1 - palm], SPAN)
    normals = np.linspace(first, last, CORNER_NORMALS)
    side = p[NORMALS : NORMALS + 1]
    corner_centre = cmath.exp(1j * float(side[0])) * complex(
        p[C.SHAPE] - height, (-1.0, 1.0)[palm] * (least + most) / 2
    )
    projected = corner_centre * np.exp(-1j * normals)
    targets = np.append(projected.real + rho, p[C.SHAPE]), np.append(projected.imag, 0.0)
    sd = (
        np.append(np.full(CORNER_NORMALS, CORNER_SD_M), SIDE_SD_M),
        np.append(np.full(CORNER_NORMALS, SLOPE_SD_M), SIDE_SD_M),
    )
    return Guess(x, outline_through(p, np.append(normals, side), targets, sd, prior, 0))


def narrowed(guess: Guess, record: Record, palm: int, width: float) -> Guess:
    """The guess with the same contacts on a side that is passed within `width` (rad), which yields less."""
    share = 1.0 - width / math.exp(guess.p[WIDTH])
    p = guess.p.copy()
    p[WIDTH] = math.log(width)
    offset = wrapped(normal_angles(record.palms, guess.x[:, 0])[:, palm] - p[NORMALS])
    spin = palm_turn(record, palm)[:, 1] - guess.x[:, 1]
    return Guess(guess.x + share * np.stack([offset, spin], axis=1), p)
