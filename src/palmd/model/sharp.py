"""An outline with flat sides: a Fourier series plus a few sides, each with its normal and its length.

h(θ) = Fourier(θ) + Σ_j L_j G(θ − θ_j). A flat side of length L and normal θ_j has its whole radius of curvature at one
normal: v = L δ(θ − θ_j). G is the corresponding support function without mean and first harmonic (a closed outline's v
has no first harmonic): G + G″ = δ − cos/π − 1/2π. To keep v finite, a side is passed within a small angle: |y| in the
½ sin|y| that belongs to δ is replaced by the smooth w·2 ln(2 cosh(y/2w)), which makes δ a bump about 4w wide that
falls like e^(−|y|/w) and is never negative. Corners are the parts between sides.
"""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import Library
from palmd.model.contact import Contact
from palmd.model.shape import basis, contact_at
from palmd.model.smoothing import ORDER, C, Form, kernels
from palmd.model.symbolic import SX, ca

SIDES = 4  # most sides that one record determines
COMPILED = (1, SIDES)  # numbers of sides that kernels exist for; most records determine one
FOURIER = 2 * ORDER + 1
NORMALS = C.SHAPE + FOURIER
LENGTHS = NORMALS + SIDES
WIDTH = LENGTHS + SIDES  # ln w
CONSTANTS = WIDTH + 1


def outline_at(theta: SX, shape: SX, sides: int = SIDES) -> Contact:
    """Return r, d, v at outward normal `theta`; `shape`: all constants from `C.SHAPE` on.

    Only the first `sides` sides are used.
    """
    smooth = contact_at(theta, shape[:FOURIER])
    r, d, v = smooth.r, smooth.d, smooth.v
    width = ca.exp(shape[WIDTH - C.SHAPE])
    for j in range(sides):
        normal, length = shape[NORMALS - C.SHAPE + j], shape[LENGTHS - C.SHAPE + j]
        y = theta - normal
        y -= 2 * math.pi * ca.floor(y / (2 * math.pi) + 0.5)
        s, c = ca.sin(y), ca.cos(y)
        sign = 2 * (y >= 0) - 1  # never 0, which would drop derivatives of the following terms
        away = sign * y
        decay = ca.exp(-away / width)
        soft, slope = away + 2 * width * ca.log(1 + decay), sign * (1 - decay) / (1 + decay)
        rise = 4 * decay / (1 + decay) ** 2
        bend = (ca.sin(soft) + ca.cos(soft) / (2 * width)) * rise / 2
        r += length * (ca.sin(soft) / 2 - (2 * y * s + c + 2) / (4 * math.pi))
        d -= length * (ca.cos(soft) * slope / 2 - (2 * y * c + s) / (4 * math.pi))
        v += length * (bend - c / math.pi - 1 / (2 * math.pi))
    return Contact(r, d, v)


def outline_rows(theta: FloatArray, p: FloatArray) -> FloatArray:
    """Return ∂h(`theta`)/∂(constants from `C.SHAPE` on) at the constants p: (len(theta), CONSTANTS − C.SHAPE)."""
    rows = np.zeros((len(theta), CONSTANTS - C.SHAPE))
    rows[:, :FOURIER] = basis(theta, ORDER)
    width = math.exp(p[WIDTH])
    for j in range(SIDES):
        y = np.arctan2(np.sin(theta - p[NORMALS + j]), np.cos(theta - p[NORMALS + j]))
        s, c, away = np.sin(y), np.cos(y), np.abs(y)
        decay = np.exp(-away / width)
        soft, slope = away + 2 * width * np.log1p(decay), np.tanh(y / (2 * width))
        rows[:, LENGTHS + j - C.SHAPE] = np.sin(soft) / 2 - (2 * y * s + c + 2) / (4 * math.pi)
        rows[:, NORMALS + j - C.SHAPE] = -p[LENGTHS + j] * (np.cos(soft) * slope / 2 - (2 * y * c + s) / (4 * math.pi))
        wider = 2 * width * np.log1p(decay) + 2 * away * decay / (1 + decay)
        rows[:, WIDTH - C.SHAPE] += p[LENGTHS + j] * np.cos(soft) * wider / 2
    return rows


def support(theta: FloatArray, p: FloatArray) -> FloatArray:
    """Return h (m) at normals `theta` for the constants p."""
    rows = outline_rows(theta, p)
    h: FloatArray = (
        rows[:, :FOURIER] @ p[C.SHAPE : NORMALS] + rows[:, FOURIER : FOURIER + 2 * SIDES][:, SIDES:] @ p[LENGTHS:WIDTH]
    )
    return h


@cache
def library(sides: int = SIDES) -> Library:
    """Load the smoother's kernels for such an outline, once per process; `sides`: one of `COMPILED`.

    Each side costs a quarter of the time of all harmonics together, whether it is used or not.
    """
    return kernels(f"sharp{sides}", Form(partial(outline_at, sides=sides), CONSTANTS))


def library_for(sides: int) -> Library:
    """Load the smallest `library` with at least this many sides."""
    return library(min(each for each in COMPILED if each >= sides))
