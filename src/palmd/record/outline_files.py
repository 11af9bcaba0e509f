"""Outlines for other programs: as curves in mm, and as SVG, DXF and CSV files; palmd reads the CSV back."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from html import escape

import numpy as np
import numpy.typing as npt

from palmd.chords import STRAIGHT_LABEL, chords_of
from palmd.events import FloatArray
from palmd.polygon import boundary, normals, resampled, turned

Bools = npt.NDArray[np.bool_]

SDS = 2.0
"""Half-width of the band in standard deviations."""
_NORMALS = 720  # chords then deviate by 2 µm from an arc of 200 mm radius


@dataclass(frozen=True, slots=True)
class OutlineCurves:
    """Points (n, 2) in mm of three closed curves, counter-clockwise, the first point not repeated.

    Frame of the object: the origin is described by `origin`, the orientation is arbitrary. outer, inner: `SDS` standard
    deviations to either side along each point's normal. normal (n,): direction of that normal (rad). sd (n,): standard
    deviation in mm. touched (n,). chords: both ends (2, 2) of each straight part, in mm. rho_mm, mass_kg: NaN if
    unknown.
    """

    name: str
    outline: FloatArray
    outer: FloatArray
    inner: FloatArray
    normal: FloatArray
    sd: FloatArray
    touched: Bools
    rho_mm: float = math.nan
    mass_kg: float = math.nan
    chords: tuple[FloatArray, ...] = ()
    origin: str = "the object's centre of mass"

    @property
    def untouched(self) -> tuple[FloatArray, ...]:
        """The untouched arcs (k, 2) in mm, including the touched points at their ends."""
        n = len(self.touched)
        if not self.touched.any():
            return (np.concatenate([self.outline, self.outline[:1]]),)
        begins = np.flatnonzero(self.touched & ~np.roll(self.touched, -1))
        ends = np.flatnonzero(self.touched & ~np.roll(self.touched, 1))
        arcs = []
        for begin in begins.tolist():
            length = int(np.min((ends - begin - 1) % n)) + 1
            arcs.append(self.outline[np.arange(begin, begin + length + 1) % n])
        return tuple(arcs)

    @property
    def comments(self) -> tuple[str, ...]:
        """Lines that explain the curves to a reader of the file."""
        return (
            f"palmd: {self.name}",
            f"units: mm; origin: {self.origin}; orientation: arbitrary",
            f"band: ± {SDS:g} standard deviations along the normal",
            f"touched: {np.mean(self.touched):.1%} of the normals; the rest follows from the smoothness prior only",
            *(f"straight over {math.dist(*chord):.2f} mm of the hull: {STRAIGHT_LABEL}" for chord in self.chords),
        )


def curves_factory(
    theta: FloatArray,
    h: FloatArray | None,
    h_sd: FloatArray | None,
    touched: Bools | None,
    *,
    rho_m: float = math.nan,
    mass_kg: float = math.nan,
) -> Callable[[str], OutlineCurves] | None:
    """`curves_of` with only the name left to give; None if there is no outline."""
    if h is None or h_sd is None or touched is None:
        return None
    return lambda name: curves_of(name, theta, h, h_sd, touched, rho_m=rho_m, mass_kg=mass_kg)


def curves_of(
    name: str,
    theta: FloatArray,
    h: FloatArray,
    h_sd: FloatArray,
    touched: Bools,
    *,
    rho_m: float = math.nan,
    mass_kg: float = math.nan,
    origin: str = "the object's centre of mass",
) -> OutlineCurves:
    """The curves of a support function h (m) on normals theta (rad), evenly spaced over the full circle.

    h_sd (m), touched: on the same normals.
    """
    fine: FloatArray = np.arange(_NORMALS, dtype=np.float64) * (math.tau / _NORMALS)  # from theta[0] on
    points = boundary(resampled(h, _NORMALS)) @ turned(float(theta[0])) * 1e3
    coarse = np.arange(len(h)) * (math.tau / len(h))
    sd = np.interp(fine, coarse, h_sd, period=math.tau) * 1e3
    nearest = np.rint(fine / math.tau * len(h)).astype(int) % len(h)
    normal: FloatArray = (fine + float(theta[0])) % math.tau
    chords = tuple(np.array([chord.begin, chord.end]) * 1e3 for chord in chords_of(theta, h, touched))
    reach = (SDS * sd)[:, None] * normals(normal)
    return OutlineCurves(
        name,
        points,
        points + reach,
        points - reach,
        normal,
        sd,
        touched[nearest],
        rho_m * 1e3,
        mass_kg,
        chords,
        origin,
    )


Writer = Callable[[OutlineCurves], bytes]

SUFFIXES = (".svg", ".dxf", ".csv")

_MARGIN_MM = 3.0
_CROSS_MM = 1.5
_DECIMALS = 5  # of a millimetre: 10 nm, far below any standard deviation


def writer_of(suffix: str) -> Writer:
    """The writer for one of `SUFFIXES`; raises KeyError for others, ModuleNotFoundError for DXF without ezdxf."""
    if suffix == ".dxf":
        dxf: Writer = importlib.import_module("palmd.record.outline_dxf").as_dxf  # needs the extra `cad`
        return dxf
    return {".svg": as_svg, ".csv": as_csv}[suffix]


def as_csv(curves: OutlineCurves) -> bytes:
    """Comments, a header, one row per point (mm, degrees); readable by `outlinefile.read_outline`."""
    lines = [f"# {line}" for line in curves.comments]
    lines.append("# com_mm: 0, 0")
    if math.isfinite(curves.rho_mm):
        lines.append(f"# rho_mm: {curves.rho_mm:.6g}")
    if math.isfinite(curves.mass_kg):
        lines.append(f"# mass_kg: {curves.mass_kg:.6g}")
    lines.append("x_mm,y_mm,outer_x_mm,outer_y_mm,inner_x_mm,inner_y_mm,normal_deg,sd_mm,touched")
    rows = np.hstack([curves.outline, curves.outer, curves.inner]).tolist()
    for row, normal, sd, touched in zip(rows, np.degrees(curves.normal), curves.sd, curves.touched, strict=True):
        cells = [*(_number(value) for value in row), _number(normal), f"{sd:.7f}", str(int(touched))]
        lines.append(",".join(cells))
    return ("\n".join(lines) + "\n").encode()


def as_svg(curves: OutlineCurves) -> bytes:
    """A drawing at true scale, one unit per millimetre, y upwards; one path per curve, with its name as id."""
    extent = np.concatenate([curves.outline, curves.outer])
    low, high = extent.min(axis=0) - _MARGIN_MM, extent.max(axis=0) + _MARGIN_MM
    width, height = (high - low).tolist()
    band = "fill:none;stroke:#7fb2d9;stroke-width:0.05"
    straight = "fill:none;stroke:#0072b2;stroke-width:0.25;stroke-dasharray:1.2 0.6"
    untouched = "fill:none;stroke:#d55e00;stroke-width:0.15;stroke-dasharray:0.8 0.4"
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" version="1.1" width="{width:.3f}mm" height="{height:.3f}mm" '
        f'viewBox="{low[0]:.3f} {-high[1]:.3f} {width:.3f} {height:.3f}">\n'
        f"<title>{escape(curves.name)}</title>\n<desc>{escape('. '.join(curves.comments))}</desc>\n"
        '<g transform="scale(1,-1)">\n'
        f'<path id="band_outer" style="{band}" d="{_path(curves.outer, close=True)}"/>\n'
        f'<path id="band_inner" style="{band}" d="{_path(curves.inner, close=True)}"/>\n'
        f'<path id="outline" style="fill:none;stroke:#000;stroke-width:0.1" d="{_path(curves.outline, close=True)}"/>\n'
        + "".join(
            f'<path id="untouched_{number}" style="{untouched}" d="{_path(arc, close=False)}"/>\n'
            for number, arc in enumerate(curves.untouched, 1)
        )
        + "".join(
            f'<path id="chord_{number}" style="{straight}" d="{_path(chord, close=False)}"/>\n'
            for number, chord in enumerate(curves.chords, 1)
        )
        + f'<path id="centre_of_mass" style="fill:none;stroke:#000;stroke-width:0.1" '
        f'd="M{-_CROSS_MM} 0H{_CROSS_MM}M0 {-_CROSS_MM}V{_CROSS_MM}"/>\n</g>\n</svg>\n'
    ).encode()


def _path(points: FloatArray, *, close: bool) -> str:
    coordinates = "L".join(f"{_number(x)} {_number(y)}" for x, y in points.tolist())
    return f"M{coordinates}{'Z' if close else ''}"


def _number(value: float) -> str:
    return f"{value:z.{_DECIMALS}f}"
