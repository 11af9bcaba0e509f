"""Bill of materials of the tabletop rig: read from parts.yaml, written as a page and as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from palmd.config.two_palms import LimitsConfig
from tools.tabletop import loads
from tools.tabletop.geometry import TABLETOP, Tabletop

SOURCE = Path(__file__).with_name("parts.yaml")
STALL_NM = 1.4
"""Stall torque of the weakest servo in the list, an XL430-W250 at 11.1 V."""
COLUMNS = ("part", "quantity", "choice", "maker", "number", "specification", "price_usd", "note", "source")


@dataclass(frozen=True, slots=True)
class Choice:
    """One product: a manufacturer's number with its source, or a specification."""

    specification: str = ""
    maker: str = ""
    number: str = ""
    source: str = ""
    price_usd: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        """Raise ValueError for a number without a source, and for neither number nor specification."""
        if bool(self.number) == bool(self.specification) or (self.number and not (self.maker and self.source)):
            raise ValueError(f"needs a manufacturer's number with its source, or a specification: {self}")

    @property
    def words(self) -> str:
        """Text in the table."""
        name = f"{self.maker} {self.number}" if self.number else self.specification
        price = f", about {self.price_usd:.0f} US$" if self.price_usd is not None else ""
        return name + price + (f" ({self.note})" if self.note else "")


@dataclass(frozen=True, slots=True)
class Part:
    """A part, its quantity, and suitable products."""

    name: str
    quantity: int
    choices: tuple[Choice, ...]
    note: str = ""


@dataclass(frozen=True, slots=True)
class PartsList:
    """All parts; `sources` by name, read in the month `read`."""

    read: str
    sources: Mapping[str, str]
    parts: tuple[Part, ...]


def parts_list(path: Path = SOURCE) -> PartsList:
    """Read the list; raises ValueError, KeyError or TypeError for an invalid file."""
    raw: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    parts = tuple(
        Part(
            each["name"], each["quantity"], tuple(Choice(**choice) for choice in each["choices"]), each.get("note", "")
        )
        for each in raw["parts"]
    )
    unknown = {choice.source for part in parts for choice in part.choices if choice.source} - raw["sources"].keys()
    if unknown:
        raise ValueError(f"{path}: unknown source {', '.join(sorted(unknown))}")
    return PartsList(raw["read"], raw["sources"], parts)


def as_csv(found: PartsList) -> str:
    """Return the list as CSV, one row per product."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(COLUMNS)
    for part in found.parts:
        for number, choice in enumerate(part.choices, 1):
            price = "" if choice.price_usd is None else f"{choice.price_usd:g}"
            note = "; ".join(filter(None, (choice.note, part.note if number == 1 else "")))
            rows.writerow((part.name, part.quantity, number, choice.maker, choice.number, choice.specification, price,
                           note, found.sources.get(choice.source, "")))  # fmt: skip
    return out.getvalue()


def page() -> str:
    """Return the text of docs/start/parts.md."""
    found = parts_list()
    rows = [
        (str(part.quantity or "–"), part.name, "<br>or ".join(choice.words for choice in part.choices), part.note)
        for part in found.parts
    ]
    return _PAGE.format(
        read=found.read,
        rows="\n".join(f"| {' | '.join(row)} |" for row in rows),
        active=TABLETOP.strip_length,
        loads="\n".join(f"| {what} | {value} |" for what, value in _loads(TABLETOP).items()),
        sources="\n".join(f"- {name}: {text}" for name, text in found.sources.items()),
    )


def _loads(g: Tabletop) -> dict[str, str]:
    worst = loads.worst(g, LimitsConfig())
    give = loads.deflection_mm(g, worst.force_n, worst.s_mm)
    usual = loads.deflection_mm(g, 0.1 * loads.GRAVITY_M_S2 / 2**0.5, 20.0)
    phi1, phi2 = worst.angles_deg
    mount, motors = loads.mount(g), " and ".join(f"{each:.0f}" for each in loads.MOTORS_HZ)
    soft, stiff = (loads.mount(g, each) for each in loads.FOAM_RANGE)
    slow, fast = min(loads.MOTORS_HZ), max(loads.MOTORS_HZ)
    force, usual_n = loads.motor_force_n(), 0.1 * loads.GRAVITY_M_S2 / 2**0.5
    object_hz = math.sqrt(mount.normal_n_m / 0.1) / (2.0 * math.pi)
    return {
        "printed palm": f"{loads.palm_mass_kg(g) * 1e3:.0f} g",
        "largest object": f"{loads.LARGEST_KG * 1e3:.0f} g, radius {loads.LARGEST_RADIUS_MM:g} mm",
        "largest torque on a servo": f"{worst.torque_nm:.2f} N·m, at φ1 {phi1:g}°, φ2 {phi2:g}°:"
        f" {worst.force_n:.1f} N at {worst.s_mm:.0f} mm",
        f"stall torque of the weakest servo, {STALL_NM:g} N·m, over that": f"{STALL_NM / worst.torque_nm:.1f}",
        "deflection of the palm there": f"{give:.2f} mm, {math.degrees(give / worst.s_mm):.2f}°",
        "deflection under an object of 100 g, 20 mm from the axis": f"{usual * 1e3:.0f} µm",
        "mass that vibrates: carrier, strip, skin, motor (1 g assumed)": f"{mount.mass_kg * 1e3:.1f} g",
        "shear stiffness of the foam": f"{mount.shear_n_m * 1e-3:.0f} kN/m, {soft.shear_n_m * 1e-3:.0f} to"
        f" {stiff.shear_n_m * 1e-3:.0f} with the softest foam, and the stiffest at twice its stiffness at rest",
        "resonance f_c of the carrier along the palm": f"{mount.resonance_hz:.0f} Hz, {soft.resonance_hz:.0f} to"
        f" {stiff.resonance_hz:.0f} Hz",
        f"frequencies of the motors, {motors} Hz, over f_c": f"{fast / mount.resonance_hz:.2f}, at most"
        f" {fast / soft.resonance_hz:.2f}; 0.5 to 2 must be avoided",
        "amplitude of the speed, motors of 1 g RMS on 100 g at full drive": f"{mount.speed_m_s(force, slow) * 1e3:.0f}"
        f" mm/s, {stiff.speed_m_s(force, slow) * 1e3:.0f} to {soft.speed_m_s(force, slow) * 1e3:.0f} mm/s;"
        " 12 mm/s is wanted, 9 mm/s the least for a friction of 0.3",
        "sinking of the carrier at the largest force": f"{mount.sink_mm(worst.force_n, worst.s_mm) * 1e3:.0f} µm, tilt"
        f" {math.degrees(mount.tilt_rad(worst.force_n, worst.s_mm)):.2f}°",
        "sinking under an object of 100 g, 20 mm from the axis": f"{mount.sink_mm(usual_n, 20.0) * 1e3:.0f} µm",
        "an object of 100 g on the foam resonates at": f"{object_hz:.0f} Hz, too near to the motors: see"
        " [limits of the mount](tabletop.md#limits-of-the-vibrating-mount)",
    }


_PAGE = """# Parts of the tabletop rig

`make kit` writes this list as `build/kit/parts.csv`. Prices are approximate, for one piece, from the manufacturers'
pages of {read}; parts without a price were not looked up. No such rig has been built yet: measure each part before
you print.

| | part | what to buy | what matters |
| --- | --- | --- | --- |
{rows}

## The strip's length

The drawing is for an active length of {active:g} mm. Interlink's strip is cut at 1, 2 or 3 inch, which gives other
active lengths. Cut it, measure where its active area begins and ends, and adapt parts and configuration:

<!-- not run: takes a minute and OpenSCAD; tests/unit/test_kit.py makes and checks the parts -->
```sh
make kit KIT="--set strip_length=73.7 --set palm_length=88"
palmd init my.yaml
```

## Weights and forces

| | |
| --- | --- |
{loads}

`tools/tabletop/loads.py` has the formulas; the tests check the limits.

## Why no steppers

A stepper driven by a text protocol, such as Grbl's, was considered and is not supported:

- **It reports what it was commanded, not where it is.** After a lost step the reported angle is wrong, and palmd cannot
  notice it, because set-point and report agree. The outline is then wrong too. A servo reports its encoder.
- **The protocols are made for milling.** Grbl queues moves, while palmd replaces its goal every 10 ms. It recommends at
  most 5 to 10 status reports a second, while palmd holds the motion when a report is 80 ms old. It has no watchdog:
  when the host dies it finishes the queued moves.
- **It takes more than two files.** Another make of servos takes two, because host, scripts and conformance test are
  common to all ([devices](../reference/devices.md#how-to-add-a-kind)). A stepper needs its own of each.

## Sources

{sources}
"""
