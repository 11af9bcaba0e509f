"""Drawing of the tabletop rig with dimensions, and figures of its assembly steps. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

from tools.tabletop.geometry import Tabletop
from tools.tabletop.svg import BODY, FOAM, METAL, NEW, SERVO, STRIP, THIN, Point, View, document

ANGLES_DEG = (45.0, 135.0)  # of the palms, from the world X axis
OBJECT_MM = 20.0  # radius of the drawn object


def drawing(g: Tabletop) -> str:
    """Return the drawing: front, side and one palm, with dimensions in mm."""
    scale = 2.6
    views = [
        View(scale * 95, scale * 92, scale),
        View(scale * 265, scale * 92, scale),
        View(scale * 25, scale * 245, 1.6 * scale),
        View(scale * 205, scale * 245, 1.6 * scale),
    ]
    for view, draw in zip(views, (_front, _side, _palm_from_side, _palm_from_above), strict=True):
        draw(g, view)
    return document(scale * 360, scale * 310, views)


def _along(angle_deg: float, s: float, off: float) -> Point:
    """Return the point at s along a palm, at the distance `off` towards the object between the palms."""
    angle = math.radians(angle_deg)
    side = 1.0 if angle_deg < 90.0 else -1.0
    normal = (-math.sin(angle) * side, math.cos(angle) * side)
    return s * math.cos(angle) + off * normal[0], s * math.sin(angle) + off * normal[1]


def _carrier(g: Tabletop) -> list[tuple[str, tuple[float, float, float, float]]]:
    """Return style and x0, x1, z0, z1 of foam pads, carrier, end wall and motor, seen across the palm."""
    radius, wall = g.motor_diameter / 2, g.palm_length - g.motor_wall
    starts = [g.foam_first + number * g.foam_pitch for number in range(g.foam_pads)]
    return [
        *((FOAM, (start, start + g.foam_length, -g.surface, -g.carrier_under)) for start in starts),
        (NEW, (g.palm_start, g.palm_length, -g.carrier_under, -g.carrier_top)),
        (NEW, (wall, g.palm_length, -g.motor_depth - radius, -g.carrier_top)),
        (METAL, (g.motor_start, wall, -g.motor_depth - radius, -g.motor_depth + radius)),
    ]


def _front(g: Tabletop, view: View) -> None:
    """View along the axis, as in palmd's world frame."""
    low, half = -g.axis_height, g.base_length / 2
    wide = g.servo_width / 2 + g.bracket_side
    view.box(-half, half, low - g.base_thickness, low, BODY)
    view.box(-wide, wide, low, g.servo_axis, BODY)
    view.box(-g.servo_width / 2, g.servo_width / 2, g.servo_axis - g.servo_height, g.servo_axis, SERVO)
    for number, angle in enumerate(ANGLES_DEG, 1):
        arm = ((0.0, -g.surface), (g.arm_length, -g.surface), (g.arm_length, -g.arm_depth), (0.0, -g.arm_depth))
        under = -g.surface - g.palm_thickness
        plate = (
            (g.palm_start, -g.surface), (g.palm_length, -g.surface), (g.palm_length, under), (g.palm_start, under),
        )  # fmt: skip
        view.circle(0.0, 0.0, g.cheek_radius, BODY)
        for part in (arm, plate):
            view.shape([_along(angle, *corner) for corner in part], BODY)
        for style, (x0, x1, z0, z1) in _carrier(g):
            view.shape([_along(angle, *corner) for corner in ((x0, z0), (x1, z0), (x1, z1), (x0, z1))], style)
        view.line(_along(angle, g.strip_start, 0.0), _along(angle, g.strip_end, 0.0), STRIP)
        view.text(*_along(angle, g.palm_length + 9, -4), f"palm {number}")
    view.circle(0.0, 0.0, g.pin / 2, 'fill="white" stroke="black"')
    height = OBJECT_MM * math.sqrt(2.0)
    view.circle(0.0, height, OBJECT_MM, 'fill="none" stroke="#5e81ac" stroke-dasharray="5 4"')
    view.text(0.0, height, "object")
    view.line((0.0, 0.0), (half, 0.0), THIN)
    view.dimension((half - 8, low), (half - 8, 0.0), "axis_height", g.axis_height)
    view.dimension((-half, low - 14), (half, low - 14), "base_length", g.base_length)
    view.text(0.0, low - 24, "front: palm 1 turns by φ1, palm 2 by φ1 + φ2; servo 1 is behind")


def _side(g: Tabletop, view: View) -> None:
    """View across the axis, servo 1 (behind) on the right; palms upright."""
    low = -g.axis_height
    view.box(-g.base_width / 2, g.base_width / 2, low - g.base_thickness, low, BODY)
    for way in (1, -1):
        _half(g, view, way, 0.0, {})
    view.line((-g.base_width / 2, 0.0), (g.base_width / 2, 0.0), THIN)
    view.dimension((-g.palm_width / 2, 82.0), (g.palm_width / 2, 82.0), "palm_width", g.palm_width)
    view.dimension((-g.base_width / 2, low - 14), (g.base_width / 2, low - 14), "base_width", g.base_width)
    view.dimension((g.servo_start, 24.0), (g.bracket_start, 24.0), "servo_depth", g.servo_depth)
    view.text(0.0, low - 24, "side: one axis through both shafts, pins and bearings")


def _half(g: Tabletop, view: View, way: int, shift: float, new: Mapping[str, str]) -> None:
    """An upright palm with servo and bracket, `way` 1 for palm 1 and -1 for palm 2; `new` has styles by part."""

    def at(y0: float, y1: float, z0: float, z1: float, part: str, style: str = BODY) -> None:
        ends = sorted((way * y0 + shift, way * y1 + shift))
        view.box(ends[0], ends[1], z0, z1, new.get(part, style))

    low, half, hidden = -g.axis_height, g.palm_width / 2, new.get("hidden", "")
    if "bracket" not in hidden:
        at(g.bracket_start, g.bracket_start + g.bracket_thickness, low, g.servo_axis, "bracket")
        at(g.bracket_start - g.foot_length, g.bracket_start, low, low + g.bracket_thickness, "bracket")
    if "servo" not in hidden:
        at(g.servo_start, g.bracket_start, g.servo_axis - g.servo_height, g.servo_axis, "servo", SERVO)
        at(g.cheek_end, g.servo_start, -g.horn_circle / 2, g.horn_circle / 2, "horn", METAL)
    at(-half, half, g.palm_start, g.palm_length, "palm")
    at(half, g.cheek_end, g.arm_start, g.arm_length, "palm")
    at(g.cheek_start, g.cheek_end, -g.cheek_radius, g.arm_length, "palm")
    at(-g.eye_start - g.bearing_width, -g.eye_start, -g.eye_radius, 2 * g.eye_radius, "palm")
    r = g.bearing_outer / 2
    at(-g.eye_start - g.bearing_width, -g.eye_start, -r, r, "bearing", METAL)
    if "pin" not in hidden:
        at(g.eye_start, g.eye_start + g.pin_length, -g.pin / 2, g.pin / 2, "pin", METAL)
    if "carrier" not in hidden:
        at(-g.carrier_width / 2, g.carrier_width / 2, g.palm_start, g.palm_length, "carrier")
        radius = g.motor_diameter / 2
        at(-radius, radius, g.motor_start, g.palm_length - g.motor_wall, "motor", METAL)
    if "strip" not in hidden:
        at(-g.strip_width / 2, g.strip_width / 2, g.strip_start, g.strip_end, "strip", 'fill="#bf616a" stroke="none"')


def _palm_from_side(g: Tabletop, view: View) -> None:
    """One palm; the strip's surface passes through the axis."""
    under = -g.surface - g.palm_thickness
    view.box(0.0, g.arm_length, -g.arm_depth, -g.surface, BODY)
    view.circle(0.0, 0.0, g.cheek_radius, BODY)
    view.box(g.palm_start, g.palm_length, under, -g.surface, BODY)
    for style, (x0, x1, z0, z1) in _carrier(g):
        view.box(x0, x1, z0, z1, style)
    view.line((g.strip_start, 0.0), (g.strip_end, 0.0), STRIP)
    view.circle(0.0, 0.0, g.pin / 2, 'fill="white" stroke="black"')
    view.line((-14.0, 0.0), (g.palm_length + 4, 0.0), THIN)
    view.dimension((0.0, 24.0), (g.palm_length, 24.0), "palm_length", g.palm_length)
    view.dimension((g.strip_start, 16.0), (g.strip_end, 16.0), "strip_length", g.strip_length)
    view.text(g.strip_start, 9.0, f"strip begins at {g.strip_start:g}", "start", ' data-name="strip_start"')
    view.dimension((g.palm_length + 3, under), (g.palm_length + 3, -g.surface), "palm_thickness", g.palm_thickness, 0.0)
    view.dimension((0.0, -20.0), (g.arm_length, -20.0), "arm_length", g.arm_length)
    view.text(0.0, -27.0, f"palm, from the servo's side; plate {g.surface:g} below the axis:", "start")
    layers = (
        ("foam_thickness", "foam"), ("carrier_thickness", "carrier"), ("strip_thickness", "strip"),
        ("skin_thickness", "skin"),
    )  # fmt: skip
    for number, (name, words) in enumerate(layers):
        words = f"{words} {getattr(g, name):g}"
        view.text(18.0 * number, -31.0, words, "start", f' data-name="{name}"')
    view.text(0.0, -35.0, f"motor, Ø {g.motor_diameter:g}", "start", ' data-name="motor_diameter"')
    view.text(24.0, -35.0, f"thick {g.motor_thickness:g}", "start", ' data-name="motor_thickness"')
    view.text(44.0, -35.0, "moves along the palm, axis in the middle of the foam", "start")


def _palm_from_above(g: Tabletop, view: View) -> None:
    """The same palm, seen onto the strip."""
    _plan(g, view, 1, 0.0, {"hidden": "servo"})
    half, tail = g.palm_width / 2, g.strip_end + g.strip_edge
    across = (half + g.cheek_start) / 2
    for x in (g.arm_length - 4, g.arm_length - 10):
        view.circle(x, across, g.end_hole / 2, 'fill="white" stroke="black"')
    view.box(tail, tail + g.tail_slot, -g.tail_width / 2, g.tail_width / 2, 'fill="white" stroke="black"')
    view.dimension((g.palm_length + 4, -half), (g.palm_length + 4, half), "palm_width", g.palm_width, 0.0)
    view.text(0.0, -22.0, "palm, onto the strip; its leads go through the slot", "start")


def _plan(g: Tabletop, view: View, way: int, shift: float, new: Mapping[str, str]) -> None:
    """A palm lying flat, seen onto the strip: palm 1 for `way` 1, palm 2 for -1, at `shift` from the axis."""

    def at(x0: float, x1: float, y0: float, y1: float, style: str) -> None:
        (x0, x1), (y0, y1) = sorted((way * (x0 + shift), way * (x1 + shift))), sorted((way * y0, way * y1))
        view.box(x0, x1, y0, y1, style)

    half, hidden, eye_end = g.palm_width / 2, new.get("hidden", ""), g.eye_start + g.bearing_width
    palm = new.get("palm", BODY)
    at(0.0, g.arm_length, g.cheek_start, g.cheek_end, palm)
    at(g.arm_start, g.arm_length, half - 1, g.cheek_end, palm)
    at(-g.cheek_radius, g.cheek_radius, g.cheek_start, g.cheek_end, palm)
    at(-g.eye_radius, 2 * g.eye_radius, -eye_end, -g.eye_start, palm)
    at(-g.bearing_outer / 2, g.bearing_outer / 2, -eye_end, -g.eye_start, METAL)
    at(g.palm_start, g.palm_length, -half, half, palm)
    if "carrier" not in hidden:
        for start in (g.foam_first + number * g.foam_pitch for number in range(g.foam_pads)):
            at(start, start + g.foam_length, -half, half, FOAM)
        width, radius = g.carrier_width / 2, g.motor_diameter / 2
        at(g.palm_start, g.palm_length, -width, width, NEW)
        at(g.motor_start, g.palm_length - g.motor_wall, -radius, radius, METAL)
    if "strip" not in hidden:
        width = g.strip_width / 2
        at(g.strip_start, g.strip_end, -width, width, 'fill="#e5b9bd" stroke="#bf616a"')
    if "servo" not in hidden:
        at(-g.servo_width / 2, g.servo_width / 2, g.servo_start, g.bracket_start, SERVO)


STEPS = (
    "1 bearing into the eye",
    "2 servo on the cheek",
    "3 palms together, then the pins",
    "4 motor and carrier, on foam",
    "5 strip and skin",
    "6 bracket on the servo",
    "7 brackets on the base",
)


def assembly(g: Tabletop) -> str:
    """Return the assembly steps; new parts are yellow. Views across the axis; step 3 from above, palms lying flat."""
    scale, wide, high, columns = 1.5, 190.0, 190.0, 4
    views = [
        View(scale * wide * (number % columns + 0.5), scale * (high * (number // columns) + 105.0), scale)
        for number in range(len(STEPS))
    ]
    bare = {"hidden": "carrier strip servo bracket pin"}
    _half(g, views[0], 1, 0.0, {**bare, "bearing": NEW})
    _half(g, views[1], 1, 0.0, {"hidden": "carrier strip bracket pin", "servo": NEW, "horn": NEW})
    for way in (1, -1):
        _plan(g, views[2], way, 12.0, {"hidden": "carrier strip"})
        low, high = sorted((way * g.eye_start, way * (g.eye_start - g.pin_length)))
        views[2].box(-g.pin / 2, g.pin / 2, low, high, NEW)
        _half(g, views[3], way, 0.0, {"hidden": "bracket strip", "carrier": NEW, "motor": NEW})
        _half(g, views[4], way, 0.0, {"hidden": "bracket", "strip": NEW})
        _half(g, views[5], way, 0.0, {"bracket": NEW})
        _half(g, views[6], way, 0.0, {})
    low = -g.axis_height
    views[6].box(-g.base_width / 2, g.base_width / 2, low - g.base_thickness, low, NEW)
    for view, words in zip(views, STEPS, strict=True):
        view.text(0.0, low - 16, words)
    return document(scale * wide * columns, scale * high * 2, views)
