"""The paper's own proposal: Zimmer's observer (1994), Newton steps on a window of outputs (CMU-CS-01-107, section 4.3).

The state at the window's beginning is corrected so that the outputs s1, s2 follow the readings, by one Gauss–Newton
step on the integral of their squared error for each new reading; nothing is remembered of what has left the window. As
in the paper there is no friction and ρ is known beforehand. The outline's continuation is unknown; there are two ways:

    eliminated   (4.13)–(4.17): v1, v2 are eliminated, what remains needs the contact forces (the paper takes torques
                 of the palms; here the pads' forces and the true mass) and divides by ω1 − ω0 and ω12 − ω0
    constant     v1, v2 are states that stay the same throughout a window; no force is needed and nothing is singular
"""

# ruff: noqa: N806 -- matrices keep their capital letters
from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from palmd.events import FloatArray
from palmd.model import shape_map
from palmd.model.contact import Contact, normal, offsets, readings
from palmd.model.dynamics import BodyConstants, Palms, effective_gravity, newton_euler
from palmd.model.outputs import NAMED, RIG_INPUTS
from palmd.model.symbolic import SX
from tools.studies.peers.functions import array
from tools.studies.peers.task import LostError, PeerReading, PeerStart

Form = Literal["eliminated", "constant"]
NODES = 133  # steps in a window of half a second
LEAST = 40  # before that the window says too little
WELL_SEEN = 1e-2
"""Directions in which the window says less than this much of what it says in the best are left as they are: with noise
of 0.1 mm a full step along them is metres wide, and an observer without this is lost at its first correction."""

STATES = ("r1", "r2", "omega0", "s1", "s2", "v1", "v2")
_SIZE = {"eliminated": 5, "constant": 7}
_SCALE = np.array([1e-3, 1e-3, 1.0, 1e-3, 1e-3, 1e-3, 1e-3])
_S = {1: 3, 2: 4}  # where each pad's output stands in the state
_INPUTS = shape_map.PREDICTION_INPUTS + 2  # and the two forces per unit mass

Drift = Callable[[SX, Palms, SX, SX, SX], SX]


def eliminated(q: SX, palms: Palms, forces: SX, rho: SX, rig: SX) -> SX:
    """(4.13)–(4.17) with the errata's signs: q̇ of (r1, r2, ω0, s1, s2), forces per unit mass (m/s²)."""
    r1, r2, omega0, s1, s2 = (q[i] for i in range(5))
    d1, d2 = offsets(palms.phi2, r1, r2, s1, s2)
    n1, n2 = normal(palms.phi1, 1), normal(palms.phi12, 2)
    a0 = forces[0] * n1 + forces[1] * n2 + effective_gravity(palms, rig)
    alpha0 = -(forces[0] * d1 + forces[1] * d2) / rho**2
    rate1, rate2 = palms.omega1 - omega0, palms.omega12 - omega0
    sum1, sum2 = palms.omega1 + omega0, palms.omega12 + omega0
    sin, tan = ca.sin(palms.phi2), ca.tan(palms.phi2)
    s1_rate = -(s1 * palms.alpha1 - omega0**2 * r1 - ca.dot(a0, n1) + alpha0 * d1) / rate1
    s1_rate += -sum1 / tan * s1 + sum1 * rate2 / (rate1 * sin) * s2
    s2_rate = (-s2 * palms.alpha12 - omega0**2 * r2 - ca.dot(a0, n2) + alpha0 * d2) / rate2
    s2_rate += sum2 / tan * s2 - sum2 * rate1 / (rate2 * sin) * s1
    return ca.vertcat(-d1 * rate1, -d2 * rate2, alpha0, s1_rate, s2_rate)


def constant(q: SX, palms: Palms, _forces: SX, rho: SX, rig: SX) -> SX:
    """q̇ of (r1, r2, ω0, s1, s2, v1, v2) with v̇ = 0: ṙ = −d θ̇, ḋ = (r − v) θ̇, ṡ from (3.13), (3.14)."""
    r1, r2, omega0, s1, s2, v1, v2 = (q[i] for i in range(7))
    d1, d2 = offsets(palms.phi2, r1, r2, s1, s2)
    one, two = Contact(r1, d1, v1), Contact(r2, d2, v2)
    body = BodyConstants(rho, SX(0), SX(1), SX(0))
    alpha0 = newton_euler(palms, omega0, one, two, body, rig).alpha0
    rate1, rate2 = palms.omega1 - omega0, palms.omega12 - omega0
    geometry = [SX.sym(name) for name in ("phi2", "r1", "d1", "r2", "d2")]
    phi2, at1, slope1, at2, slope2 = geometry
    seen = ca.vertcat(*readings(phi2, Contact(at1, slope1, SX(0)), Contact(at2, slope2, SX(0))))
    rates = ca.vertcat(palms.omega2, -d1 * rate1, (r1 - v1) * rate1, -d2 * rate2, (r2 - v2) * rate2)
    s_rates = ca.jtimes(seen, ca.vertcat(*geometry), rates)
    s_rates = ca.substitute(s_rates, ca.vertcat(*geometry), ca.vertcat(palms.phi2, r1, d1, r2, d2))
    return ca.vertcat(rates[1], rates[3], alpha0, s_rates, 0, 0)


def step_function(form: Form) -> ca.Function:
    """(q, [dt, φ1 … α2, jerk, rig, f1, f2], ρ) → q after dt by Runge–Kutta's fourth order."""
    drift: Drift = eliminated if form == "eliminated" else constant
    q, u, rho = SX.sym("q", _SIZE[form]), SX.sym("u", _INPUTS), SX.sym("rho")
    dt, rig, forces = u[0], u[9 : 9 + RIG_INPUTS], u[9 + RIG_INPUTS :]

    def rates(state: SX, t: SX) -> SX:
        return drift(state, shape_map.palms_after(u[1:7], u[7:9], t), forces, rho, rig)

    k1 = rates(q, SX(0))
    k2 = rates(q + dt / 2 * k1, dt / 2)
    k3 = rates(q + dt / 2 * k2, dt / 2)
    k4 = rates(q + dt * k3, dt)
    return ca.Function("step", [q, u, rho], [q + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])


@dataclass(frozen=True, slots=True)
class NewtonWindow:
    """run: (q, u of all nodes, ρ) → states after each node, and their sensitivities to q side by side."""

    form: Form
    step: ca.Function
    run: ca.Function


def window(form: Form) -> NewtonWindow:
    """The window's trajectory and its variational equation, on CasADi's virtual machine."""
    n, step = _SIZE[form], step_function(form)
    q, S, u, rho = SX.sym("q", n), SX.sym("S", n, n), SX.sym("u", _INPUTS), SX.sym("rho")
    after = step(q, u, rho)
    both = ca.horzcat(q, S)
    moved = ca.Function("both", [both, u, rho], [ca.horzcat(after, ca.jacobian(after, q) @ S)])
    along = moved.mapaccum("along", NODES)
    start, us, rho_all = ca.MX.sym("q", n), ca.MX.sym("u", _INPUTS, NODES), ca.MX.sym("rho")
    path = along(ca.horzcat(start, ca.DM.eye(n)), us, ca.repmat(rho_all, 1, NODES))
    return NewtonWindow(form, step, ca.Function("run", [start, us, rho_all], [path]))


def first_state(form: Form, start: PeerStart, palms: FloatArray, rig: FloatArray) -> FloatArray:
    """What a shape map's start means in `STATES`, under the palms φ1 … α2."""
    values = array(shape_map.values_function()(start.x, np.concatenate([palms, rig])))
    return values[[NAMED.index(name) for name in STATES[: _SIZE[form]]]]


class NewtonObserver:
    """One Gauss–Newton step on the window for each reading; see the module."""

    def __init__(self, model: NewtonWindow, start: PeerStart, first: FloatArray, rig: FloatArray, mass: float):
        """`first` are the palms' φ1 … α2 at the start, `rig` as `named.rig_inputs`; `mass` in kg."""
        self._model, self._mass = model, mass
        self._n = _SIZE[model.form]
        self._rho = math.exp(start.x[shape_map.Z.LN_RHO])
        self._q = first_state(model.form, start, first, rig)  # at the window's beginning
        self._now = self._q.copy()
        self._nodes: deque[tuple[FloatArray, int, float]] = deque()  # input, pad or 0, reading

    def step(self, reading: PeerReading) -> bool:
        """Take the reading into the window and correct the state at its beginning; True once it has been corrected."""
        for i, u in enumerate(reading.moves):
            pad = reading.pad if i == len(reading.moves) - 1 else 0
            node = np.concatenate([u, np.array(reading.forces) / self._mass])
            self._nodes.append((node, pad, reading.value))
            self._now = array(self._model.step(self._now, node, self._rho))
        while len(self._nodes) > NODES:
            node, _, _ = self._nodes.popleft()
            self._q = array(self._model.step(self._q, node, self._rho))
        if len(self._nodes) < LEAST:
            return False
        self._correct()
        return True

    def radii(self, _reading: PeerReading) -> FloatArray:
        """(r1, r2) (m)."""
        return self._now[:2]

    def outline(self) -> None:
        """There is none: the radii are known where they are now, as functions of time."""

    def _correct(self) -> None:
        n, used = self._n, len(self._nodes)
        u = np.zeros((_INPUTS, NODES))
        u[:, :used] = np.array([node for node, _, _ in self._nodes]).T
        u[1:, used:] = u[1:, used - 1 : used]  # no time passes in what is not full yet
        path = self._model.run(self._q, u, self._rho).full().reshape(n, NODES, n + 1)
        if not np.isfinite(path).all():
            raise LostError("its equations divide by zero")
        rows, errors = [], []
        for k, (_, pad, value) in enumerate(self._nodes):
            if pad:
                rows.append(path[_S[pad], k, 1:] * _SCALE[:n])
                errors.append(value - path[_S[pad], k, 0])
        correction = _SCALE[:n] * np.linalg.lstsq(np.array(rows), np.array(errors), rcond=WELL_SEEN)[0]
        self._q = self._q + correction
        end = path[:, used - 1]
        self._now = end[:, 0] + end[:, 1:] @ correction
