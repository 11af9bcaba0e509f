"""Moving-horizon estimation on the same model: CasADi, multiple shooting, IPOPT.

The readings of the last half second are explained at once by (ψ, ω0) at each of them and one set of constants, tied by
the model's own steps as equality constraints (process noise is left out within the window). The Hessian is Gauss and
Newton's, several times faster here than the exact one. The arrival cost is that of an extended Kalman filter taken
along the window's solution (Rao, Rawlings and Lee 2001), so that no reading counts twice.
"""

# ruff: noqa: N806 -- matrices keep their capital letters
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from palmd.events import FloatArray
from palmd.model import shape_map
from tools.studies.peers.functions import Q_DIAGONAL, Functions, array
from tools.studies.peers.task import PeerReading, PeerStart, radii

NODES = 133  # steps in a window of half a second; two pads at 100 Hz, some gaps cut in two
EVERY_S = 0.1  # between solutions: at each reading the study would take hours
MOVING = 2
_CONSTANTS = shape_map.N - MOVING
_SCALE = np.array([0.01, 0.1, 0.05, 0.1, 0.3, 3e-4, *[1e-3] * (_CONSTANTS - 4)])  # of the states
_IPOPT = {"print_level": 0, "sb": "yes", "max_iter": 50, "tol": 1e-2, "warm_start_init_point": "yes"}


@dataclass(frozen=True, slots=True)
class Node:
    """One integration step, and the reading at its end if there is one: its weight is 1/variance, else 0."""

    u: FloatArray
    palms: FloatArray
    pad: int
    value: float
    weight: float


def program(model: Functions) -> ca.Function:
    """min ½|L (x₀ − x̄)|² + Σ ½ w (s − s(x))², x_(k+1) = f(x_k, u_k); states in units of their usual size.

    Unknowns: (ψ, ω0) at each node, then the constants; parameters: x̄, L, and u, palms, values, √weights of the nodes.
    """
    scale = ca.DM(_SCALE)
    unknowns = ca.MX.sym("w", MOVING * (NODES + 1) + _CONSTANTS)
    moving = ca.reshape(unknowns[: MOVING * (NODES + 1)], MOVING, NODES + 1)
    constants = unknowns[MOVING * (NODES + 1) :]
    shapes = [(shape_map.N, 1), (shape_map.N, shape_map.N), (shape_map.PREDICTION_INPUTS, NODES)]
    shapes += [(shape_map.PALM_INPUTS, NODES), (2, NODES), (2, NODES)]
    parameters = [ca.MX.sym(f"p{i}", *size) for i, size in enumerate(shapes)]
    mean, root, u, palms, values, roots = parameters
    x = ca.repmat(scale, 1, NODES + 1) * ca.vertcat(moving, ca.repmat(constants, 1, NODES + 1))

    moved = model.move.map(NODES)(x[:, :NODES], u)[:MOVING, :]
    defects = ca.vec((moved - x[:MOVING, 1:]) / ca.repmat(scale[:MOVING], 1, NODES))
    seen = ca.vertcat(*(see.map(NODES)(x[:, 1:], palms) for see in model.see))
    arrival, errors = root @ (x[:, 0] - mean), ca.vec(roots * (values - seen))
    residuals = ca.vertcat(arrival, errors)

    p = ca.vertcat(*map(ca.vec, parameters))
    factor, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", defects.shape[0])
    J = ca.jacobian(residuals, unknowns)
    hessian = ca.Function("gauss_newton", [unknowns, p, factor, multipliers], [ca.triu(factor * (J.T @ J))])
    # put together by hand from the steps' own Jacobians: ten times faster than CasADi's of the whole
    _, F = model.transition.map(NODES)(x[:, :NODES], u)
    steps = [(F_k[:MOVING, :] @ ca.diag(scale)) / scale[:MOVING] for F_k in ca.horzsplit(F, shape_map.N)]
    before = ca.horzcat(ca.diagcat(*(F_k[:, :MOVING] for F_k in steps)), ca.DM(MOVING * NODES, MOVING))
    after = ca.horzcat(ca.DM(MOVING * NODES, MOVING), ca.DM.eye(MOVING * NODES))
    jacobian = ca.horzcat(before - after, ca.vertcat(*(F_k[:, MOVING:] for F_k in steps)))
    jacobian_of_defects = ca.Function("jacobian", [unknowns, p], [defects, jacobian])
    problem: Any = {"x": unknowns, "p": p, "f": ca.sumsqr(residuals) / 2, "g": defects}
    derivatives = {"hess_lag": hessian, "jac_g": jacobian_of_defects}
    options: Any = {
        "print_time": False,
        "error_on_fail": False,
        "calc_lam_p": False,
        "show_eval_warnings": False,
        "ipopt": _IPOPT,
        **derivatives,
    }
    return ca.nlpsol("horizon", "ipopt", problem, options)


class MovingHorizon:
    """Solves anew each `every_s`; a solution that IPOPT does not vouch for is counted and not taken."""

    def __init__(self, model: Functions, solver: ca.Function, start: PeerStart, every_s: float = EVERY_S):
        self._model, self._solver, self._every_s = model, solver, every_s
        self._mean, self._P = start.x.copy(), start.P.copy()  # arrival: what is known at the window's beginning
        self._nodes: deque[Node] = deque()
        self._path: deque[FloatArray] = deque([start.x.copy()])  # the state before each node and after the last
        self._t_solved = -np.inf
        self.solved = self.failed = 0

    @property
    def x(self) -> FloatArray:
        """The state at the last reading, as `shape_map.Z`."""
        return self._path[-1]

    def step(self, reading: PeerReading) -> bool:
        """Take the reading into the window; True when the window has been solved with it."""
        for i, u in enumerate(reading.moves):
            last = i == len(reading.moves) - 1
            weight = 1.0 / reading.variance if last else 0.0
            self._nodes.append(Node(u, reading.palms, reading.pad, reading.value, weight))
            self._path.append(array(self._model.move(self._path[-1], u)))
        while len(self._nodes) > NODES:
            self._leave()
        if reading.t - self._t_solved < self._every_s:
            return False
        self._t_solved = reading.t
        self._solve()
        return True

    def radii(self, reading: PeerReading) -> FloatArray:
        """(r1, r2) (m)."""
        return radii(self.x, reading)

    def outline(self) -> FloatArray:
        """Coefficients of h (m)."""
        return self.x[shape_map.Z.SHAPE :]

    @property
    def arrival(self) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance at the window's beginning from the readings that have left it."""
        return self._mean, self._P

    @property
    def remark(self) -> str:
        """How many windows were solved and how many were not."""
        return f"one solution each {self._every_s * 1e3:g} ms, {self.failed} of {self.solved + self.failed} failed"

    def _leave(self) -> None:
        """The oldest node leaves the window: the arrival filter takes it, linearised about the window's solution."""
        node, at = self._nodes.popleft(), self._path.popleft()
        moved, F = (value.full() for value in self._model.transition(at, node.u))
        about = moved.ravel()
        mean = about + F @ (self._mean - at)
        P = F @ self._P @ F.T
        for i, q in enumerate(Q_DIAGONAL):
            P[i, i] += q * node.u[0]
        if node.weight:
            see, row = self._model.see[node.pad - 1], self._model.row[node.pad - 1]
            h = array(row(about, node.palms).T)
            Ph = P @ h
            gain = Ph / (h @ Ph + 1.0 / node.weight)
            mean = mean + gain * (node.value - float(see(about, node.palms)) - h @ (mean - about))
            keep = np.eye(shape_map.N) - np.outer(gain, h)
            P = keep @ P @ keep.T + np.outer(gain, gain) / node.weight
        self._mean, self._P = mean, P

    def _solve(self) -> None:
        padded = [*self._nodes, *[_standing(self._nodes[-1])] * (NODES - len(self._nodes))]
        path = [*self._path, *[self._path[-1]] * (NODES + 1 - len(self._path))]
        states = np.array(path) / _SCALE
        guess = np.concatenate([states[:, :MOVING].ravel(), states[0, MOVING:]])
        values, weights = np.zeros((2, NODES)), np.zeros((2, NODES))
        for k, node in enumerate(padded):
            values[node.pad - 1, k], weights[node.pad - 1, k] = node.value, node.weight
        root = np.linalg.inv(np.linalg.cholesky(self._P))
        u, palms = np.array([node.u for node in padded]).T, np.array([node.palms for node in padded]).T
        blocks = (self._mean, root, u, palms, values, np.sqrt(weights))
        p = np.concatenate([np.ravel(block, order="F") for block in blocks])
        solution = self._solver(x0=guess, p=p, lbg=0.0, ubg=0.0)
        if not self._solver.stats()["success"]:
            self.failed += 1
            return
        self.solved += 1
        found = array(solution["x"])
        moving = found[: MOVING * (NODES + 1)].reshape(NODES + 1, MOVING)
        constants = found[MOVING * (NODES + 1) :]
        for k in range(len(self._path)):
            self._path[k] = _SCALE * np.concatenate([moving[k], constants])


def _standing(node: Node) -> Node:
    """What fills a window that is not full yet: no time passes and nothing is read."""
    return Node(np.concatenate([[0.0], node.u[1:]]), node.palms, node.pad, node.value, 0.0)
