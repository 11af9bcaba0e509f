"""A simulated camera: the track of a simulated run, from the simulator's truth. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from palmd.events import FloatArray

Table = dict[str, FloatArray]


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera's clock, frame and noise.

    Its time is (log time − offset)(1 − drift). The world frame is at `place_m`, turned by `angle_rad`. The mark is at
    `mark_m` and the arrow at `arrow_rad` in the object's frame, whose x axis is at ψ.
    """

    offset_s: float = -37.25
    drift: float = 0.0
    angle_rad: float = 2.2
    place_m: tuple[float, float] = (0.31, -0.12)
    mark_m: tuple[float, float] = (6e-3, -9e-3)
    arrow_rad: float = 0.8
    place_sd_m: float = 2e-4
    angle_sd_rad: float = math.radians(0.3)
    rate_hz: float = 30.0


def filmed(truth: dict[str, Any], palm1_length_m: float | None, camera: Camera, rng: np.random.Generator) -> Table:
    """The track's columns by name, in the file's units, with wrapped angles; palm1_length_m None: a fixed hinge."""
    t = np.array(truth["t"])
    log_t = np.arange(t[0], t[-1], 1.0 / camera.rate_hz)
    psi, phi1, phi2 = (CubicSpline(t, truth[name])(log_t) for name in ("psi_rad", "phi1_rad", "phi2_rad"))
    com = CubicSpline(t, _com(truth, palm1_length_m))(log_t)
    world = com + complex(*camera.mark_m) * np.exp(1j * psi)
    position = complex(*camera.place_m) + world * np.exp(1j * camera.angle_rad)
    angles = (psi + camera.arrow_rad, phi1, phi1 + phi2)
    table = {"t_s": (log_t - camera.offset_s) * (1.0 - camera.drift)}
    for name, values in (("object_x_mm", position.real), ("object_y_mm", position.imag)):
        table[name] = (values + rng.normal(0.0, camera.place_sd_m, len(log_t))) * 1e3
    for name, angle in zip(("object_angle_deg", "palm1_angle_deg", "palm2_angle_deg"), angles, strict=True):
        noisy = angle + camera.angle_rad + rng.normal(0.0, camera.angle_sd_rad, len(log_t))
        table[name] = np.degrees(np.angle(np.exp(1j * noisy)))
    return table


def as_csv(table: Table, keep: Sequence[bool] | npt.NDArray[np.bool_] | slice = slice(None)) -> str:
    """The text of a track file with the rows to `keep`."""
    rows = np.stack(list(table.values()), axis=1)[np.asarray(keep) if not isinstance(keep, slice) else keep]
    return "\n".join([",".join(table), *(",".join(f"{value:.6f}" for value in row) for row in rows)]) + "\n"


def _com(truth: dict[str, Any], palm1_length_m: float | None) -> npt.NDArray[np.complex128]:
    """The centre of mass in the world: at distance r1 from palm 1's line and r2 from palm 2's, by 2 × 2 systems."""
    phi1, phi2, r1, r2 = (np.array(truth[name]) for name in ("phi1_rad", "phi2_rad", "r1_m", "r2_m"))
    phi12 = phi1 + phi2
    lines = np.stack([np.stack([-np.sin(phi1), np.cos(phi1)]), np.stack([np.sin(phi12), -np.cos(phi12)])])
    places = np.linalg.solve(np.moveaxis(lines, 2, 0), np.stack([r1, r2], axis=1)[:, :, None])[:, :, 0]
    hinge = 0.0 if palm1_length_m is None else palm1_length_m * (1.0 - np.exp(1j * phi1))
    return np.asarray(places[:, 0] + 1j * places[:, 1] + hinge)
