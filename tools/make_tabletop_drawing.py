"""Draws the rig for the table, docs/figures/tabletop.svg, from the measures in tools/tabletop/palmd-tabletop.scad."""

from __future__ import annotations

import math
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCE, FIGURE = ROOT / "tools/tabletop/palmd-tabletop.scad", ROOT / "docs/figures/tabletop.svg"
SCALE = 2.6  # drawn units for a mm
ANGLES_DEG = (45.0, 135.0)  # of the palms, from the world X axis
HEAD = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {w:.0f} {h:.0f}" font-family="sans-serif" font-size="12">
<rect width="100%" height="100%" fill="white"/>
<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto-start-reverse">
<path d="M0 0 8 4 0 8z"/></marker></defs>
"""


def measures() -> dict[str, float]:
    """The lengths at the top of the OpenSCAD file (mm)."""
    return {name: float(value) for name, value in re.findall(r"^(\w+) = ([\d.]+);", SOURCE.read_text(), re.MULTILINE)}


class View:
    """One view: lengths in mm about an origin on the page, y upwards."""

    def __init__(self, x: float, y: float) -> None:
        self._x, self._y = x, y
        self.parts: list[str] = []

    def at(self, x: float, y: float) -> tuple[float, float]:
        return self._x + SCALE * x, self._y - SCALE * y

    def shape(self, points: list[tuple[float, float]], style: str) -> None:
        told = " ".join("{:.1f},{:.1f}".format(*self.at(*point)) for point in points)
        self.parts.append(f'<polygon points="{told}" {style}/>')

    def box(self, x: float, y: float, width: float, height: float, style: str) -> None:
        self.shape([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], style)

    def circle(self, x: float, y: float, radius: float, style: str) -> None:
        cx, cy = self.at(x, y)
        self.parts.append(f'<circle cx="{cx:.1f}" cy="{cy:.1f}" r="{SCALE * radius:.1f}" {style}/>')

    def line(self, start: tuple[float, float], end: tuple[float, float], style: str) -> None:
        (x1, y1), (x2, y2) = self.at(*start), self.at(*end)
        self.parts.append(f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" {style}/>')

    def text(self, x: float, y: float, words: str, anchor: str = "middle") -> None:
        px, py = self.at(x, y)
        self.parts.append(f'<text x="{px:.1f}" y="{py:.1f}" text-anchor="{anchor}">{words}</text>')

    def span(self, start: tuple[float, float], end: tuple[float, float], words: str) -> None:
        """A measure between two points."""
        self.line(start, end, 'stroke="black" marker-start="url(#tip)" marker-end="url(#tip)"')
        self.text(0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1]) + 1.5, words)


BODY = 'fill="#d8dee9" stroke="#3b4252"'
SERVO = 'fill="#eceff4" stroke="#3b4252"'
STRIP = 'stroke="#bf616a" stroke-width="3"'
THIN = 'stroke="#4c566a" stroke-dasharray="6 3 1 3"'


def along(angle_deg: float, s: float, off: float) -> tuple[float, float]:
    """A point s along a palm, `off` to the object's side of it; the object lies between the palms."""
    angle = math.radians(angle_deg)
    side = 1.0 if angle_deg < 90.0 else -1.0
    normal = (-math.sin(angle) * side, math.cos(angle) * side)
    return s * math.cos(angle) + off * normal[0], s * math.sin(angle) + off * normal[1]


def front(m: dict[str, float], view: View) -> None:
    """Seen along the axis, as palmd sees it."""
    top = m["axis_height"]
    view.box(-m["base_length"] / 2, -top - m["base_thickness"], m["base_length"], m["base_thickness"], BODY)
    servo = -m["servo_height"] + m["servo_axis"]
    view.box(-m["servo_width"] / 2 - 4, -top, m["servo_width"] + 8, top + m["servo_axis"], BODY)
    view.box(-m["servo_width"] / 2, servo, m["servo_width"], m["servo_height"], SERVO)
    for number, angle in enumerate(ANGLES_DEG, 1):
        under = -m["strip_thickness"] - m["palm_thickness"]
        corners = [
            (m["strip_start"], 0.0),
            (m["palm_length"], 0.0),
            (m["palm_length"], under),
            (m["strip_start"], under),
        ]
        view.shape([along(angle, *corner) for corner in corners], BODY)
        felt = m["strip_start"] + m["strip_length"]
        view.line(along(angle, m["strip_start"], 0.0), along(angle, felt, 0.0), STRIP)
        view.text(*along(angle, m["palm_length"] + 8, -4), f"palm {number}")
    view.circle(0.0, 0.0, m["hinge_eye"], BODY)
    view.circle(0.0, 0.0, m["pin"] / 2, 'fill="white" stroke="black"')
    middle = along(90.0, 0.0, 0.0)
    view.circle(middle[0], 22.0 * math.sqrt(2), 22.0, 'fill="none" stroke="#5e81ac" stroke-dasharray="5 4"')
    view.text(0.0, 22.0 * math.sqrt(2), "object")
    view.span(along(45.0, 0.0, -14.0), along(45.0, m["palm_length"], -14.0), f"{m['palm_length']:g}")
    view.span((m["base_length"] / 2 - 8, -top), (m["base_length"] / 2 - 8, 0.0), f"{m['axis_height']:g}")
    view.line((0.0, 0.0), (m["base_length"] / 2, 0.0), THIN)
    view.text(0.0, -top - 18, "front: palm 1 turns by φ1, palm 2 by φ1 + φ2")


def _ordered(a: float, b: float) -> tuple[float, float]:
    return min(a, b), abs(b - a)


def side(m: dict[str, float], view: View) -> None:
    """Seen across the axis: servo 1 behind (left), servo 2 before (right)."""

    def box(x: float, width: float, y: float, height: float, style: str = BODY) -> None:
        view.box(x, y, width, height, style)

    top, half = m["axis_height"], m["palm_width"] / 2
    box(-m["base_width"] / 2, m["base_width"], -top - m["base_thickness"], m["base_thickness"])
    box(-half, 2 * half, -4.0, m["palm_length"] / math.sqrt(2) + 4.0)
    begin = half + m["bracket_thickness"] + m["gap"]
    for way, number in ((-1, 1), (1, 2)):
        box(*_ordered(way * half, way * (half + m["bracket_thickness"])), -10.0, 20.0)
        under = -m["servo_height"] + m["servo_axis"]
        box(*_ordered(way * begin, way * (begin + m["servo_depth"])), under, m["servo_height"], SERVO)
        back = begin + m["servo_depth"]
        box(*_ordered(way * back, way * (back + m["bracket_thickness"])), -top, top + m["servo_axis"])
        view.text(way * (begin + m["servo_depth"] / 2), -20.0, f"servo {number}")
    view.line((-m["base_width"] / 2, 0.0), (m["base_width"] / 2, 0.0), THIN)
    view.span((-half, 60.0), (half, 60.0), f"{m['palm_width']:g}")
    view.text(0.0, -top - 18, "side: one axis through both shafts and the pin")


def drawing(m: dict[str, float]) -> str:
    """The figure."""
    first = View(SCALE * 95, SCALE * 90)
    second = View(SCALE * 275, SCALE * 90)
    front(m, first)
    side(m, second)
    return HEAD.format(w=SCALE * 360, h=SCALE * 190) + "\n".join(first.parts + second.parts) + "\n</svg>\n"


if __name__ == "__main__":
    FIGURE.write_text(drawing(measures()), encoding="utf-8")
    print(f"written: {FIGURE.relative_to(ROOT)}")
