"""The shape map as ordinary CasADi functions, on its virtual machine: what estimators from elsewhere are given."""

# ruff: noqa: N806 -- matrices keep their capital letters
from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from palmd.events import FloatArray
from palmd.model import shape_map
from palmd.model.outputs import NAMED, RIG_INPUTS

Q_DIAGONAL = (shape_map.Q_PSI, shape_map.Q_OMEGA0)
"""Process noise per second of the first two states; the others stay."""


@dataclass(frozen=True, slots=True)
class Functions:
    """move: (x, u) → x after u's dt; transition: → (x, ∂x/∂x). By pad − 1, see: (x, palms) → s; row: → ∂s/∂x."""

    move: ca.Function
    transition: ca.Function
    see: tuple[ca.Function, ca.Function]
    row: tuple[ca.Function, ca.Function]


def functions() -> Functions:
    """Derived from `shape_map` alone, so that every peer has exactly palmd's model; x (21), palms φ1 … α2."""
    n = shape_map.N
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", shape_map.PREDICTION_INPUTS)
    palms = ca.SX.sym("palms", shape_map.PALM_INPUTS)
    predict = shape_map.predict_function()
    # the Jacobian's moving rows J are read off how a covariance moves, where J P stands beside the part that stays: so
    # it is palmd's own J, which leaves out how the integrator's parameter for stiffness depends on the state
    shifted = ca.DM(n, n)
    shifted[0, 2] = shifted[1, 3] = 1.0
    moved, beside = predict(x, ca.DM.eye(n), u)
    J = ca.horzcat(predict(x, shifted, u)[1][:2, 2:4], beside[:2, 2:])
    moved, F = ca.cse([moved, ca.vertcat(J, ca.DM.eye(n)[2:, :])])
    values = shape_map.values_function()(x, ca.vertcat(palms, ca.SX.zeros(RIG_INPUTS)))
    readings = [values[NAMED.index(name)] for name in ("s1", "s2")]
    see = [ca.Function("see", [x, palms], [s]) for s in readings]
    row = [ca.Function("row", [x, palms], [ca.densify(ca.jacobian(s, x))]) for s in readings]
    return Functions(
        move=ca.Function("move", [x, u], [moved]),
        transition=ca.Function("transition", [x, u], [moved, F]),
        see=(see[0], see[1]),
        row=(row[0], row[1]),
    )


def array(value: ca.DM) -> FloatArray:
    """As NumPy's, dense; a column as a vector."""
    full: FloatArray = value.full()
    return full.ravel() if full.shape[1] == 1 else full
