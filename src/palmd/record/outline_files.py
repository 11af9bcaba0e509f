"""Outline files for other programs: SVG, DXF, and points in CSV, which palmd can read back."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from html import escape

import numpy as np

from palmd.events import FloatArray
from palmd.record.outline_curves import OutlineCurves

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
