"""Orientation of a known outline from the readings alone, without dynamics. Pure; not for use inside the loop."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.model import sharp
from palmd.model.sharp import WIDTH
from palmd.observer.record import Record
from palmd.system.mechanism import JOINTS, OPENING, normal_directions

# grid of ψ: spacing (rad), most steps in one interval, and range about the start (rad)
GRID_RAD, REACH, SEARCH_RANGE = 2.5e-3, 40, 0.9
INTERVAL_NODES = 3
READING_SD_M, READING_GATE, TURN_SD_RAD = 6e-4, 25.0, 0.02
TRACKED_WIDTH = 0.008  # least width of sides (rad), a few of the grid's steps
TABLE = 7200


def tracked_orientation(
    p: FloatArray, record: Record, start: int, psi0: float, reach: float = SEARCH_RANGE
) -> FloatArray:
    """ψ (rad) at the nodes from `start` on, where it is psi0, from the readings and the outline p alone.

    Dynamic programming over a grid of ψ within `reach` (rad): minimises the readings' residuals and the turn in each
    interval.
    """
    t = record.t[start:]
    bins = np.arange(0, len(t), INTERVAL_NODES)
    count = 2 * round(reach / GRID_RAD) + 1
    grid = np.linspace(psi0 - reach, psi0 + reach, count)
    angles = np.linspace(0.0, math.tau, TABLE, endpoint=False)
    widened = p.copy()
    widened[WIDTH] = max(p[WIDTH], math.log(TRACKED_WIDTH))
    h = sharp.support(angles, widened)
    d = -(np.roll(h, -1) - np.roll(h, 1)) * (TABLE / math.tau / 2)

    def interpolated(table: FloatArray, theta: FloatArray) -> FloatArray:
        position = theta * (TABLE / math.tau)
        low = np.floor(position)
        part = position - low
        i = low.astype(np.intp) % TABLE
        return table[i] * (1 - part) + table[(i + 1) % TABLE] * part

    later = record.contact_step >= start
    interval = (record.contact_step[later] - start) // INTERVAL_NODES
    joints = [record.contact_palms[later, joint][:, None] for joint in range(len(JOINTS))]
    normals = normal_directions(joints, grid[None, :])
    h1, h2 = (interpolated(h, theta) for theta in normals)
    d1, d2 = (interpolated(d, theta) for theta in normals)
    on_first, cos, sin = (record.contact_pad[later] < 1.5)[:, None], np.cos(joints[OPENING]), np.sin(joints[OPENING])
    s = np.where(on_first, h1 * cos + h2, h2 * cos + h1) / sin + np.where(on_first, -d1, d2)
    residual = (record.contact_value[later][:, None] - s) ** 2 / READING_SD_M**2
    residual = np.where(
        residual > READING_GATE,
        READING_GATE * (1 + np.log(np.maximum(residual, READING_GATE) / READING_GATE)),
        residual,
    )
    cost = np.zeros((len(bins), len(grid)))
    np.add.at(cost, np.minimum(interval, len(bins) - 1), residual)
    turn_cost = (np.arange(-REACH, REACH + 1) * GRID_RAD / TURN_SD_RAD) ** 2
    best = np.where(np.abs(grid - psi0) < GRID_RAD / 2, 0.0, 1e9)
    back = np.zeros((len(bins), len(grid)), dtype=np.intp)
    index = np.arange(len(grid))
    for b in range(1, len(bins)):
        padded = np.pad(best, REACH, constant_values=1e12)
        options = np.lib.stride_tricks.sliding_window_view(padded, 2 * REACH + 1) + turn_cost
        choice = options.argmin(axis=1)
        back[b] = np.clip(index + choice - REACH, 0, len(grid) - 1)
        best = options[index, choice] + cost[b]
    path = np.zeros(len(bins), dtype=np.intp)
    path[-1] = int(best.argmin())
    for b in range(len(bins) - 1, 0, -1):
        path[b - 1] = back[b, path[b]]
    middle = np.minimum(bins + INTERVAL_NODES / 2, len(t) - 1)
    middle[0] = 0
    psi: FloatArray = np.interp(np.arange(len(t)), middle, grid[path])
    return psi
