"""The motion of a known outline by the readings alone, without dynamics. Pure; not for use inside the loop."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.model import sharp
from palmd.model.sharp import WIDTH
from palmd.observer.record import Record
from palmd.system.mechanism import JOINTS, OPENING, normal_directions

GRID_RAD, REACH, ROAMS = 2.5e-3, 40, 0.9  # of ψ: steps, most of them in one interval, and how far about the start (rad)
INTERVAL_NODES = 3
FOLLOW_SD_M, FOLLOW_GATE, FOLLOW_TURN_RAD = 6e-4, 25.0, 0.02
FOLLOW_WIDTH = 0.008  # of sides (rad), a few of the grid's steps
TABLE = 7200


def followed(p: FloatArray, record: Record, start: int, psi0: float, roams: float = ROAMS) -> FloatArray:
    """ψ (rad) at the nodes from `start` on, where it is psi0, by the readings and the outline p alone.

    Dynamic programming over a grid: each interval's readings are missed least, turns are dear. No dynamics.
    """
    t = record.t[start:]
    bins = np.arange(0, len(t), INTERVAL_NODES)
    count = 2 * round(roams / GRID_RAD) + 1
    grid = np.linspace(psi0 - roams, psi0 + roams, count)
    angles = np.linspace(0.0, math.tau, TABLE, endpoint=False)
    wide = p.copy()
    wide[WIDTH] = max(p[WIDTH], math.log(FOLLOW_WIDTH))
    h = sharp.support(angles, wide)
    d = -(np.roll(h, -1) - np.roll(h, 1)) * (TABLE / math.tau / 2)

    def at(table: FloatArray, theta: FloatArray) -> FloatArray:
        position = theta * (TABLE / math.tau)
        low = np.floor(position)
        part = position - low
        i = low.astype(np.intp) % TABLE
        return table[i] * (1 - part) + table[(i + 1) % TABLE] * part

    mine = record.contact_step >= start
    which = (record.contact_step[mine] - start) // INTERVAL_NODES
    joints = [record.contact_palms[mine, joint][:, None] for joint in range(len(JOINTS))]
    normals = normal_directions(joints, grid[None, :])
    one, two = (at(h, theta) for theta in normals)
    before, after = (at(d, theta) for theta in normals)
    first, cos, sin = (record.contact_pad[mine] < 1.5)[:, None], np.cos(joints[OPENING]), np.sin(joints[OPENING])
    s = np.where(first, one * cos + two, two * cos + one) / sin + np.where(first, -before, after)
    miss = (record.contact_value[mine][:, None] - s) ** 2 / FOLLOW_SD_M**2
    miss = np.where(miss > FOLLOW_GATE, FOLLOW_GATE * (1 + np.log(np.maximum(miss, FOLLOW_GATE) / FOLLOW_GATE)), miss)
    cost = np.zeros((len(bins), len(grid)))
    np.add.at(cost, np.minimum(which, len(bins) - 1), miss)
    turn = (np.arange(-REACH, REACH + 1) * GRID_RAD / FOLLOW_TURN_RAD) ** 2
    best = np.where(np.abs(grid - psi0) < GRID_RAD / 2, 0.0, 1e9)
    back = np.zeros((len(bins), len(grid)), dtype=np.intp)
    index = np.arange(len(grid))
    for b in range(1, len(bins)):
        padded = np.pad(best, REACH, constant_values=1e12)
        options = np.lib.stride_tricks.sliding_window_view(padded, 2 * REACH + 1) + turn
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
