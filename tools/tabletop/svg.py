"""Writes drawings as SVG: views with shapes in mm, y upwards."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Point = tuple[float, float]

HEAD = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {w:.0f} {h:.0f}" font-family="sans-serif" font-size="12">
<rect width="100%" height="100%" fill="white"/>
<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto-start-reverse">
<path d="M0 0 8 4 0 8z"/></marker></defs>
"""
BODY = 'fill="#d8dee9" stroke="#3b4252"'
SERVO = 'fill="#eceff4" stroke="#3b4252"'
NEW = 'fill="#ebcb8b" stroke="#3b4252"'
METAL = 'fill="#81a1c1" stroke="#3b4252"'
FOAM = 'fill="#a3be8c" stroke="#3b4252"'
STRIP = 'stroke="#bf616a" stroke-width="3"'
THIN = 'stroke="#4c566a" stroke-dasharray="6 3 1 3"'
TIPS = 'stroke="black" marker-start="url(#tip)" marker-end="url(#tip)"'


class View:
    """One view: lengths in mm relative to an origin on the page."""

    def __init__(self, x: float, y: float, scale: float) -> None:
        self._x, self._y, self.scale = x, y, scale
        self.parts: list[str] = []

    def at(self, x: float, y: float) -> Point:
        """Return the position of a point on the page."""
        return self._x + self.scale * x, self._y - self.scale * y

    def shape(self, points: Iterable[Point], style: str) -> None:
        """Add a closed polygon."""
        corners = " ".join("{:.1f},{:.1f}".format(*self.at(*point)) for point in points)
        self.parts.append(f'<polygon points="{corners}" {style}/>')

    def box(self, x0: float, x1: float, y0: float, y1: float, style: str) -> None:
        """Add a rectangle between two corners."""
        self.shape([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], style)

    def circle(self, x: float, y: float, radius: float, style: str) -> None:
        """Add a circle around a point."""
        cx, cy = self.at(x, y)
        self.parts.append(f'<circle cx="{cx:.1f}" cy="{cy:.1f}" r="{self.scale * radius:.1f}" {style}/>')

    def line(self, start: Point, end: Point, style: str) -> None:
        """Add a line between two points."""
        (x1, y1), (x2, y2) = self.at(*start), self.at(*end)
        self.parts.append(f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" {style}/>')

    def text(self, x: float, y: float, words: str, anchor: str = "middle", extra: str = "") -> None:
        """Add one line of text."""
        px, py = self.at(x, y)
        self.parts.append(f'<text x="{px:.1f}" y="{py:.1f}" text-anchor="{anchor}"{extra}>{words}</text>')

    def dimension(self, start: Point, end: Point, name: str, value: float, side: float = 1.5) -> None:
        """Add a dimension between two points, marked with its name; the value of a vertical one is beside it."""
        self.line(start, end, TIPS)
        beside = 4.0 if start[0] == end[0] else 0.0
        middle = (0.5 * (start[0] + end[0]) + beside, 0.5 * (start[1] + end[1]) + side)
        self.text(*middle, f"{value:g}", extra=f' data-name="{name}"')


def document(width: float, height: float, views: Sequence[View]) -> str:
    """Return the complete SVG."""
    body = "\n".join(part for view in views for part in view.parts)
    return HEAD.format(w=width, h=height) + body + "\n</svg>\n"
