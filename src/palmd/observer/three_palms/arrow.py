"""Least squares over a chain of nodes that share parameters; the normal equations have an arrowhead matrix.

Each node has `STATES` unknowns and is coupled to its neighbours only; all nodes are coupled to the parameters. The
chain is eliminated by a banded Cholesky factorisation, which leaves a dense Schur complement for the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from palmd.events import FloatArray

STATES = 6


@dataclass(slots=True)
class Arrow:
    """Half the Hessian and half the gradient of a sum of squares: K nodes of `STATES` unknowns, m parameters.

    diagonal (K, 6, 6), upper (K−1, 6, 6) from node k to k+1, border (K, 6, m), corner (m, m); nodes_gradient (K, 6),
    gradient (m,).
    """

    diagonal: FloatArray
    upper: FloatArray
    border: FloatArray
    corner: FloatArray
    nodes_gradient: FloatArray
    gradient: FloatArray

    @classmethod
    def empty(cls, nodes: int, parameters: int) -> Arrow:
        """All zero."""
        return cls(
            np.zeros((nodes, STATES, STATES)),
            np.zeros((nodes - 1, STATES, STATES)),
            np.zeros((nodes, STATES, parameters)),
            np.zeros((parameters, parameters)),
            np.zeros((nodes, STATES)),
            np.zeros(parameters),
        )

    def add_residuals(self, r: FloatArray, left: FloatArray, right: FloatArray, by: FloatArray) -> None:
        """Add whitened residuals r (K−1, q) between neighbours, with their Jacobians in both nodes and parameters."""
        left_t, right_t = left.transpose(0, 2, 1), right.transpose(0, 2, 1)
        self.diagonal[:-1] += left_t @ left
        self.diagonal[1:] += right_t @ right
        self.upper += left_t @ right
        self.border[:-1] += left_t @ by
        self.border[1:] += right_t @ by
        self.nodes_gradient[:-1] += (left_t @ r[..., None])[..., 0]
        self.nodes_gradient[1:] += (right_t @ r[..., None])[..., 0]
        self._add_to_parameters(r, by)

    def add_prior(self, information: FloatArray, gradient: FloatArray) -> None:
        """Add a prior of the first node and the parameters: information (6 + m, 6 + m), half gradient (6 + m,)."""
        self.diagonal[0] += information[:STATES, :STATES]
        self.border[0] += information[:STATES, STATES:]
        self.corner += information[STATES:, STATES:]
        self.nodes_gradient[0] += gradient[:STATES]
        self.gradient += gradient[STATES:]

    def marginal_of_last_node(self) -> tuple[FloatArray, FloatArray]:
        """Marginalise all nodes but the last: information (6 + m, 6 + m) of it and the parameters, half gradient."""
        K, _, m = self.border.shape
        border = np.zeros((K - 1, STATES, STATES + m))
        border[-1, :, :STATES] = self.upper[-1]
        border[:, :, STATES:] = self.border[:-1]
        corner = np.empty((STATES + m, STATES + m))
        corner[:STATES, :STATES], corner[:STATES, STATES:] = self.diagonal[-1], self.border[-1]
        corner[STATES:, :STATES], corner[STATES:, STATES:] = self.border[-1].T, self.corner
        gradient = np.concatenate([self.nodes_gradient[-1], self.gradient])
        before = Arrow(self.diagonal[:-1], self.upper[:-1], border, corner, self.nodes_gradient[:-1], gradient)
        return before.marginal()

    def _add_to_parameters(self, r: FloatArray, by: FloatArray) -> None:
        flat = by.reshape(r.size, by.shape[-1])
        self.corner += flat.T @ flat
        self.gradient += flat.T @ r.reshape(-1)

    def solve(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Steps of the nodes (K, 6) and of the parameters (m,), with diagonals multiplied by 1 + `damping`.

        Raises numpy.linalg.LinAlgError if the matrix is not positive definite.
        """
        chain, solved, schur, side = self._schur_complement(damping)
        step = -linalg.cho_solve(linalg.cho_factor(schur, check_finite=False), side)
        nodes = _triangular_solve(chain, -(solved[:, -1] + solved[:, :-1] @ step), "T")
        return nodes.reshape(-1, STATES), step

    def nodes_step(self, damping: float) -> FloatArray:
        """Step of the nodes (K, 6) with the parameters fixed; raises as `solve`."""
        chain, _ = self._factor(damping)
        step = -linalg.cho_solve_banded((chain, True), self.nodes_gradient.reshape(-1), check_finite=False)
        return np.asarray(step.reshape(-1, STATES), np.float64)

    def predicted_decrease(self, nodes: FloatArray, step: FloatArray) -> float:
        """Decrease of the quadratic model for a step (K, 6) of the nodes and (m,) of the parameters."""
        linear = 2.0 * float((self.nodes_gradient * nodes).sum() + self.gradient @ step)
        curved = np.einsum("kij,kj->ki", self.diagonal, nodes) + 2.0 * (self.border @ step)
        curved[:-1] += 2.0 * np.einsum("kij,kj->ki", self.upper, nodes[1:])
        return -linear - float((nodes * curved).sum() + step @ self.corner @ step)

    def marginal(self) -> tuple[FloatArray, FloatArray]:
        """Marginalise all nodes: information (m, m) of the parameters and half gradient (m,)."""
        _, _, schur, side = self._schur_complement(0.0)
        return schur, side

    def information(self) -> FloatArray:
        """Marginal information of the parameters (m, m)."""
        return self.marginal()[0]

    def _schur_complement(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(the chain's factor L, L⁻¹ (border, nodes' gradient), Schur complement (m, m), its half gradient (m,))."""
        chain, corner = self._factor(damping)
        K, _, m = self.border.shape
        sides = np.empty((K * STATES, m + 1), order="F")
        sides[:, :m], sides[:, m] = self.border.reshape(-1, m), self.nodes_gradient.reshape(-1)
        solved = _triangular_solve(chain, sides)
        product = solved.T @ solved
        return chain, solved, corner - product[:m, :m], self.gradient - product[:m, m]

    def _factor(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Banded Cholesky factor of the chain, and the corner; both damped."""
        K = len(self.diagonal)
        band = np.zeros((2 * STATES, K, STATES))  # lower form: band[i − j, j]
        for i in range(STATES):
            for j in range(STATES):
                if i >= j:
                    band[i - j, :, j] = self.diagonal[:, i, j]
                band[STATES + i - j, :-1, j] = self.upper[:, j, i]
        band[0] *= 1.0 + damping
        corner = self.corner.copy()
        corner[np.diag_indices_from(corner)] *= 1.0 + damping
        flat = band.reshape(2 * STATES, K * STATES)
        return linalg.cholesky_banded(flat, lower=True, overwrite_ab=True, check_finite=False), corner


def _triangular_solve(chain: FloatArray, sides: FloatArray, transposed: str = "N") -> FloatArray:
    """L⁻¹ sides (or L⁻ᵀ sides) with the banded factor L = `chain`; half the cost of a solve by LLᵀ."""
    solved, _ = linalg.lapack.dtbtrs(chain, sides, uplo="L", trans=transposed, overwrite_b=True)
    return np.asarray(solved, np.float64)
