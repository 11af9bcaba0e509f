"""The baselines of the field's benchmark, each from a log to one line of results. Needs the extra `studies` (filterpy).

All are given the same log and nothing of its truth, and begin blind. palmd's own are told how well the rig is known, as
the header says it; the others take the rig for what it is described as: their state has no place for its constants.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from palmd import observer
from palmd.events import Event, FloatArray
from palmd.model import shape, shape_map
from palmd.model.outputs import rig_inputs
from palmd.observer.reconstruct import reconstruct
from palmd.polygon import degrees
from palmd.record.eventlog import EventLog
from palmd.score import support_at
from palmd.system.description import RigDescription
from tools.studies.peers import horizon, newton
from tools.studies.peers.filterpy_filters import FilterpyExtended
from tools.studies.peers.functions import functions
from tools.studies.peers.horizon import MovingHorizon
from tools.studies.peers.task import LostError, Peer, PeerTask, blind, task_from

Line = dict[str, Any]
Method = Callable[[EventLog], Line]

TICK_S = 0.01
SOLVED_EVERY_S = 0.5
"""Between the windows that IPOPT solves: at each 0.1 s, it would take hours."""

_model, _solver, _window = cache(functions), cache(horizon.program), cache(newton.window)


def palmd_live(log: EventLog) -> Line:
    """The daemon's observer with the smoother at its side, tick by tick, as it would have answered then."""
    watcher = observer.make("shape", log.rig, 0, observer.Simulated(log.rig))
    waiting = list(reversed(log.events))
    end = log.events[-1].t_sample
    rows = []
    for k in range(1, math.floor((end - log.events[0].t_sample) / TICK_S) + 1):
        t = log.events[0].t_sample + k * TICK_S
        while waiting and waiting[-1].t_sample <= t:
            watcher.feed(waiting.pop())
        watcher.improve(t)
        told = watcher.estimate(t)
        if told.valid:
            rows.append((t, told.r1, told.r2, told.omega0))
    last = watcher.estimate(end)
    answer = _motion(np.array(rows).reshape(-1, 4))
    outline = watcher.shape(end)
    if not last.valid or outline is None:
        return answer
    theta = degrees() - float(outline.theta[0])
    h_sd = np.interp(degrees(), outline.theta, outline.h_sd, period=math.tau)
    return answer | _body(support_at(outline.h, theta), h_sd, last.rho, last.mu, last.mass)


def palmd_reconstruct(log: EventLog) -> Line:
    """The whole record at once, offline: no causal answer."""
    answer = reconstruct(log.events, log.rig)
    if not answer.converged or answer.h is None or answer.h_sd is None:
        return {}
    told = _motion(np.column_stack([answer.t, *answer.radii, answer.omega0]))
    return told | _body(answer.h, answer.h_sd, answer.rho, answer.mu, answer.mass)


def filterpy_ekf(log: EventLog) -> Line:
    """filterpy's extended Kalman filter on palmd's model."""
    task = _task(log)
    return _of_shape_map(task, FilterpyExtended(_model(), blind(task)))


def ipopt_window(log: EventLog) -> Line:
    """The last 133 steps by multiple shooting, Gauss–Newton Hessian and arrival cost, solved by IPOPT."""
    task = _task(log)
    return _of_shape_map(task, MovingHorizon(_model(), _solver(_model()), blind(task), SOLVED_EVERY_S))


def paper_window(log: EventLog) -> Line:
    """The paper's chapter 4: one Gauss–Newton step a reading on a window (Zimmer 1994), v constant; no outline."""
    task = _task(log)
    first = np.array([*task.palms.angles, *task.palms.rates, *task.palms.accelerations])
    start = blind(task)
    peer = newton.NewtonObserver(_window("constant"), start, first, rig_inputs(task.rig), math.nan)
    return _motion(_stepped(task, peer))


METHODS: Mapping[str, Method] = {
    "palmd reconstruct": palmd_reconstruct,
    "palmd live": palmd_live,
    "filterpy EKF": filterpy_ekf,
    "IPOPT window": ipopt_window,
    "paper's window": paper_window,
}
"""By the name that results carry; `palmd reconstruct` alone sees the whole record before it answers."""


@cache
def warmed_up(method: str) -> None:
    """Compiles and builds beforehand what is built once, so that no run's time counts it."""
    if METHODS[method] in (filterpy_ekf, ipopt_window):
        _model()
    if METHODS[method] is ipopt_window:
        _solver(_model())
    if METHODS[method] is paper_window:
        _window("constant")
    if METHODS[method] is palmd_live:
        observer.make("shape", RigDescription()).warm_up()


def _task(log: EventLog) -> PeerTask:
    events: tuple[Event, ...] = tuple(log.events)
    return task_from(log.rig, events)


def _of_shape_map(task: PeerTask, peer: FilterpyExtended | MovingHorizon) -> Line:
    rows = _stepped(task, peer)
    x, places = peer.x, shape_map.Z
    told = _motion(rows)
    if not np.isfinite(x).all():
        return told
    h = shape.basis(degrees()) @ x[places.SHAPE :]
    return told | _body(h, None, math.exp(x[places.LN_RHO]), x[places.MU], math.nan)


def _stepped(task: PeerTask, peer: Peer) -> FloatArray:
    """Rows of t, r1, r2 and ω0 (NaN: not told) up to the reading at which the peer was lost, if it was."""
    rows = []
    with np.errstate(all="ignore"):
        for reading in task.readings:
            try:
                peer.step(reading)
                r1, r2 = peer.radii(reading).tolist()
            except (LostError, np.linalg.LinAlgError, ValueError):
                break
            if not math.isfinite(r1 + r2):
                break
            rows.append((reading.t, r1, r2, math.nan))
    return np.array(rows).reshape(-1, 4)


def _motion(rows: FloatArray) -> Line:
    t, r1, r2, omega0 = rows.T
    told: Line = {"t": _numbers(t, 4), "r1_m": _numbers(r1, 7), "r2_m": _numbers(r2, 7)}
    return told | ({"omega0_rad_s": _numbers(omega0, 5)} if np.isfinite(omega0).all() else {})


def _body(h: FloatArray, h_sd: FloatArray | None, rho: float, mu: float, mass: float) -> Line:
    told: Line = {"h_m": _numbers(h, 8)}
    if h_sd is not None:
        told["h_sd_m"] = _numbers(h_sd, 8)
    constants = {"rho_m": rho, "mu": mu, "mass_kg": mass}
    return told | {name: float(value) for name, value in constants.items() if math.isfinite(value)}


def _numbers(values: FloatArray, decimals: int) -> list[float | None]:
    return [round(value, decimals) if math.isfinite(value) else None for value in values.tolist()]
