"""Which palm an object sticks to, told by the pads' forces alone. Pure.

Where friction has no dither an object nearly always sticks to one palm and slips along the other, which way is the
palms' doing (`model.rolling`). Friction there is μN, so in Newton's law only the friction of what sticks is unknown,
which has no part in it across the palm that is stuck to:

    f1 + f2 (μ2 σ sin φ2 − cos φ2) = g cos φ1      where palm 1 is stuck to,
    f2 + f1 (μ1 σ sin φ2 − cos φ2) = −g cos φ12    where palm 2 is;   σ = sign ω2,

accelerations of a few hundredths of g left out. Which of both holds, with what μ1, μ2 and mass, the readings tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.record import Record
from palmd.system.mechanism import JOINTS, OPENING, PALMS, directions

SMOOTHED_S = 0.015  # one-sigma of the window over which forces are averaged
FORCE_SD = 0.03  # of such an average, relative; accelerations are in it
MOST_COST = 25.0  # of one moment: whatever a blow does there
CHANGE_COST = 120.0  # of going over to the other palm; what accelerations do to forces lasts for tenths of a second
FRICTIONS: FloatArray = np.arange(0.05, 0.6, 0.025)
MASSES: FloatArray = np.linspace(0.8, 1.3, 41)  # in what a frictionless object of these forces would have
STANDING = 2e-3  # rad/s: palms that turn against each other no faster tell nothing

Palms = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class StuckGuess:
    """The palm stuck to (0 or 1) at each node of a record, the mass (kg) and friction that explain the forces so.

    asymmetry: (μ1 − μ2)/(μ1 + μ2), μ being the mean of both.
    """

    palms: Palms
    mass: float
    mu: float
    asymmetry: float


def stuck_guess(record: Record, asymmetry_sd: float) -> StuckGuess | None:
    """The likeliest; None where a pad tells no force, or the forces ask for the least friction: that sticks nowhere.

    asymmetry_sd: of what is believed of the palms' friction, 0 where both rub alike.
    """
    forces = [_averaged(record, palm) for palm in PALMS]
    if any(force is None for force in forces):
        return None
    one, two = np.array(forces)
    joints, rates = np.split(record.palms[:, : 2 * len(JOINTS)].T, 2)
    (first, second), opening, opens = directions(joints), joints[OPENING], rates[OPENING]
    g = float(record.rig[0])
    moves = np.abs(opens) > STANDING
    frictionless = g * (np.sin(second) + np.sin(first)) / np.sin(opening)
    about = float(np.median((one + two) / frictionless))

    def costs(mass: float, mu: float) -> FloatArray:
        across = mu * np.sign(opens) * np.sin(opening) - np.cos(opening)
        miss = np.stack([one + two * across - mass * g * np.cos(first), two + one * across + mass * g * np.cos(second)])
        spread = FORCE_SD * np.stack([np.hypot(one, two * across), np.hypot(two, one * across)])
        found: FloatArray = np.minimum((miss / spread) ** 2, MOST_COST) * moves
        return found

    alike = np.arange(len(FRICTIONS))
    pairs = np.array([alike, alike] if asymmetry_sd == 0.0 else np.meshgrid(alike, alike)).reshape(2, -1)
    mus = FRICTIONS[pairs]
    asymmetry = (mus[0] - mus[1]) / mus.sum(axis=0)
    unlikely = (asymmetry / asymmetry_sd) ** 2 if asymmetry_sd else np.zeros(len(alike))

    def with_each(mass: float) -> FloatArray:
        each: FloatArray = np.stack([costs(mass, mu) for mu in FRICTIONS.tolist()], axis=1)
        return each

    mass = min((about * MASSES).tolist(), key=lambda tried: float(with_each(tried).min(axis=(0, 1)).sum()))
    to_one, to_two = with_each(mass)
    of_pairs = np.stack([to_one[pairs[1]], to_two[pairs[0]]])  # what sticks to one palm rubs along the other
    best = int(np.argmin(_least_cost(of_pairs, CHANGE_COST) + unlikely))
    if not pairs[:, best].any():
        return None
    palms = likeliest(of_pairs[:, best], CHANGE_COST)
    return StuckGuess(palms, mass, float(mus[:, best].mean()), float(asymmetry[best]))


def _least_cost(costs: FloatArray, change: float) -> FloatArray:
    """What the likeliest sequences cost, of costs (2, m, n): (m)."""
    one, two = costs[:, :, 0]
    for k in range(1, costs.shape[2]):
        stays_one, stays_two = one, two
        one = np.minimum(stays_one, stays_two + change) + costs[0, :, k]
        two = np.minimum(stays_two, stays_one + change) + costs[1, :, k]
    least: FloatArray = np.minimum(one, two)
    return least


def likeliest(costs: FloatArray, change: float) -> Palms:
    """Of two states the sequence (n) of least cost, by Viterbi: `costs` (2, n) of each, and `change` of each change."""
    n = costs.shape[1]
    came = np.zeros((2, n), dtype=np.intp)
    so_far = costs[:, 0].tolist()
    for k, now in enumerate(costs.T[1:].tolist(), 1):
        before = so_far
        for state in (0, 1):
            stays = before[state] <= before[1 - state] + change
            came[state, k] = state if stays else 1 - state
            so_far = so_far if state else [0.0, 0.0]
            so_far[state] = now[state] + (before[state] if stays else before[1 - state] + change)
    states = np.empty(n, dtype=np.intp)
    states[-1] = int(np.argmin(so_far))
    for k in range(n - 1, 0, -1):
        states[k - 1] = came[states[k], k]
    return states


def _averaged(record: Record, palm: int) -> FloatArray | None:
    """What the pad's forces are at the nodes (N)."""
    mine = record.force_pad == palm
    if not mine.any():
        return None
    times = record.t[record.force_step[mine]] + record.force_offset[mine]
    value = record.force_value[mine]
    sums = np.zeros((2, len(record.t)))
    nearest = np.searchsorted(record.t, times)
    reach = math.ceil(3.0 * SMOOTHED_S / float(record.dt[0]))
    for by in range(-reach, reach + 1):
        node = np.clip(nearest + by, 0, len(record.t) - 1)
        weight = np.exp(-0.5 * ((record.t[node] - times) / SMOOTHED_S) ** 2)
        np.add.at(sums[0], node, weight)
        np.add.at(sums[1], node, weight * value)
    felt = sums[0] > 1e-3
    averaged: FloatArray = np.interp(record.t, record.t[felt], sums[1, felt] / sums[0, felt])
    return averaged
