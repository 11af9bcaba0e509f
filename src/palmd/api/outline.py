"""The outline of an object as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.api.errors import PalmdError
from palmd.events import FloatArray
from palmd.polygon import closed_outline, turned


@dataclass(frozen=True, slots=True, eq=False)
class OutlineData:
    """A convex outline as support function h about the centre of mass, on n normals spread evenly over a full turn.

    theta_rad (n): the outward normals in the object's frame. h_m, h_sd_m (n): support function and its standard
    deviation. touched (n): where a palm has been in contact. t_s: time of the estimate, NaN for the result of a whole
    run.
    """

    t_s: float
    theta_rad: FloatArray
    h_m: FloatArray
    h_sd_m: FloatArray
    touched: npt.NDArray[np.bool_]

    def xy(self, psi_rad: float = 0.0, com_m: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """Points (361, 2) of the closed outline in m, rotated by psi_rad with the centre of mass at com_m.

        By default in the object's frame.
        """
        return np.asarray(closed_outline(self.theta_rad, self.h_m) @ turned(psi_rad) + np.array(com_m))


def outline_of(fields: Mapping[str, Any], t_s: float) -> OutlineData:
    """The outline in the fields of `palm/shape`, or of a reconstruction's result."""
    theta, h, h_sd = (np.array(fields[name], dtype=np.float64) for name in ("theta_rad", "h_m", "h_sd_m"))
    return OutlineData(t_s, theta, h, h_sd, np.array(fields["touched"], dtype=np.bool_))


def last_of(outlines: tuple[OutlineData, ...], what: str) -> OutlineData:
    """The last outline; PalmdError if there is none."""
    if not outlines:
        raise PalmdError(f"{what} has no outline: no contact lasted long enough")
    return outlines[-1]
