"""Wiring diagram of the tabletop rig. Pure."""

from __future__ import annotations

from tools.tabletop.svg import BODY, METAL, SERVO, View, document

WIRE = 'fill="none" stroke="{}" stroke-width="2"'
POWER, BUS, USB, SIGNAL = "#bf616a", "#5e81ac", "#4c566a", "#a3be8c"
STRIP_PINS = (("A0", "drive line, end at the hinge"), ("A1", "sense line"), ("A2", "drive line, other end"))
"""Pins of tools/strip/strip.ino."""
MOTOR_PINS = ("SDA", "SCL", "5 V", "GND")
"""The same board's pins for the driver of the palm's vibration motor."""


def wiring() -> str:
    """Return the diagram: host, adapter, supply, servos, boards and strips."""
    view = View(10.0, 470.0, 1.0)

    def box(x: float, y: float, words: str, below: str = "", style: str = BODY, width: float = 130.0) -> None:
        view.box(x, x + width, y, y + 46.0, style)
        view.text(x + width / 2, y + 26.0, words)
        view.text(x + width / 2, y + 10.0, below)

    def wire(colour: str, *corners: tuple[float, float]) -> None:
        points = " ".join("{:.1f},{:.1f}".format(*view.at(*corner)) for corner in corners)
        view.parts.append(f'<polyline points="{points}" {WIRE.format(colour)}/>')

    box(0, 180, "computer", "runs palmd", width=110)
    box(190, 380, "servo adapter", "U2D2")
    box(400, 380, "power hub")
    box(400, 300, "12 V supply", "3 A", style=METAL)
    box(620, 400, "servo 1", "id 1, palm 1", style=SERVO)
    box(620, 330, "servo 2", "id 2, palm 2", style=SERVO)
    wire(USB, (110, 210), (150, 210), (150, 403), (190, 403))
    view.text(150, 410, "USB", "end")
    wire(BUS, (320, 403), (400, 403))
    view.text(360, 410, "TTL, 3 pins")
    wire(BUS, (530, 403), (575, 403), (575, 423), (620, 423))
    wire(BUS, (685, 400), (685, 376))
    view.text(692, 384, "servo to servo", "start")
    wire(POWER, (465, 346), (465, 380))
    view.text(473, 359, "switch: emergency stop", "start")
    for number, y in enumerate((190.0, 0.0), 1):
        box(190, y, f"strip board {number}", "ATmega32U4")
        box(560, y, f"strip {number}", f"palm {number}", style=SERVO, width=190)
        wire(USB, (110, 200), (140, 200), (140, y + 23), (190, y + 23))
        for (pin, what), offset in zip(STRIP_PINS, (38.0, 23.0, 8.0), strict=True):
            wire(SIGNAL, (320, y + offset), (560, y + offset))
            view.text(326, y + offset + 3, pin, "start")
            view.text(555, y + offset + 3, what, "end")
        wire(SIGNAL, (320, y - 14), (430, y - 14), (430, y + 23))
        view.text(326, y - 11, "A3", "start")
        view.circle(430, y + 23, 3, f'fill="{SIGNAL}"')
        view.box(422, 438, y - 6, y + 6, 'fill="white" stroke="black"')
        view.text(444, y - 8, "10 kΩ", "start")
        box(400, y - 90, "motor driver", "DRV2605L")
        box(620, y - 90, f"motor {number}", f"on carrier {number}", style=METAL)
        wire(SIGNAL, (255, y), (255, y - 67), (400, y - 67))
        view.text(262, y - 61, ", ".join(MOTOR_PINS), "start")
        wire(SIGNAL, (530, y - 67), (620, y - 67))
        view.text(575, y - 61, "OUT+, OUT−")
        if number > 1:
            view.text(200, y - 18, "D4 to GND", "middle")
    view.text(
        0,
        -130,
        "The strips' boards and the motors take their supply from USB. Only the servos are on 12 V.",
        "start",
    )
    return document(840.0, 620.0, [view])
