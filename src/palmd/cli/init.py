"""Asks what your rig is made of and writes a configuration of it, checked.

Enter takes what stands in brackets. Nothing is opened, nothing moves; what a rig measures is for `palmd calibrate`.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from palmd.config.pads import ST0001_TAXELS, TSF85_COLUMNS, TSF85_ROWS
from palmd.config.tabletop import STRIP_COUNTS, TABLETOP
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.shipped import shipped
from palmd.devices.pad import pad_note
from palmd.system.mechanism import PALMS

STANDARD_GRAVITY = 9.81
PLAN = "plans/explore.yaml"


@dataclass(frozen=True, slots=True)
class Prompt:
    """One question: what it asks, what Enter means, and what an answer may be; `read` raises ValueError for others."""

    text: str
    usual: str
    read: Callable[[str], Any] = str


def one_of(meanings: Mapping[str, str]) -> Callable[[str], str]:
    """Of some words; their first letters will do where they tell them apart."""

    def read(answer: str) -> str:
        found = [word for word in meanings if word.startswith(answer.lower())]
        if len(found) != 1:
            raise ValueError(f"one of {', '.join(meanings)}")
        return found[0]

    return read


def number(low: float, high: float) -> Callable[[str], float]:
    """Of a range."""

    def read(answer: str) -> float:
        value = float(answer)
        if not low <= value <= high:
            raise ValueError
        return value

    def said(answer: str) -> float:
        try:
            return read(answer)
        except ValueError:
            raise ValueError(f"a number from {low:g} to {high:g}") from None

    return said


def whole(*allowed: int) -> Callable[[str], int]:
    """One of some whole numbers."""

    def read(answer: str) -> int:
        if answer not in map(str, allowed):
            raise ValueError(f"one of {', '.join(map(str, allowed))}")
        return int(answer)

    return read


REPORTED = "reported"


def reported_or(read: Callable[[str], float]) -> Callable[[str], float | str]:
    """What `read` takes, or the word for what a device reports itself."""

    def either(answer: str) -> float | str:
        return REPORTED if answer and REPORTED.startswith(answer.lower()) else read(answer)

    return either


PADS = {
    "versapad": "Interlink VersaPads on serial lines",
    "strip": "force-sensing strips with palmd's firmware",
    "evdev": "touch devices that Linux knows, touchpads and touch screens",
    "taxels": "arrays of pressure sensors on serial lines",
}
ARMS = {
    "adept": f"an Adept arm that holds palm {PALMS[-1]}",
    "dynamixel": "two DYNAMIXEL servos about a fixed axis",
    "feetech": "two Feetech servos about a fixed axis",
}
PORTS = {"evdev": "/dev/input/by-path/palmd-pad{}"}
PORT = "/dev/palmd-pad{}"


@dataclass(frozen=True, slots=True)
class Array:
    """A kind of array of pressure sensors: what it is, how many rows it may have, and usually has, and its pitch."""

    meaning: str
    rows: tuple[int, ...]
    usual_rows: int
    pitch_mm: float


_ST0001_ROWS = tuple(rows for rows in range(3, ST0001_TAXELS + 1) if ST0001_TAXELS % rows == 0)
ARRAYS = {
    "tsf85": Array("one or two modules of 7 x 4 (Robotiq TSF-85) in a row", TSF85_ROWS, max(TSF85_ROWS), 4.5),
    "st0001": Array("60 taxels asked by Modbus (Synria ST-00-01)", _ST0001_ROWS, 15, 4.0),
    "text": Array("numbers that a microcontroller prints, a line for each reading", tuple(range(3, 65)), 20, 3.0),
}


def questions(answers: Mapping[str, Any]) -> Iterator[tuple[str, Prompt]]:
    """Each with its key; what comes later may depend on the `answers` so far."""
    yield "pads", Prompt(f"The pads are\n{_listed(PADS)}", "strip", one_of(PADS))
    for palm in PALMS:
        yield f"pad{palm}", Prompt(f"Pad {palm} is at", PORTS.get(answers["pads"], PORT).format(palm))
    if answers["pads"] == "evdev":
        yield "counts_per_mm", Prompt("Its units for each mm, or reported: as the device reports them", REPORTED,
                                        reported_or(number(1e-3, 1000)))  # fmt: skip
        yield "pressure", Prompt("Does it tell a pressure, yes or no", "no", one_of({"yes": "", "no": ""}))
    if answers["pads"] == "taxels":
        yield from _of_an_array(answers)
    if answers["pads"] == "strip":
        yield "strip_start", Prompt("A strip begins to sense so many mm from the axis", f"{TABLETOP.strip_start:g}",
                                    number(0, 100))  # fmt: skip
        yield "strip_length", Prompt("It senses over so many mm", f"{TABLETOP.strip_length:g}", number(10, 500))
    yield "arm", Prompt(f"The palms are turned by\n{_listed(ARMS)}", "dynamixel", one_of(ARMS))
    yield "port", Prompt("It is at", "/dev/palmd-arm")
    length = "120" if answers["arm"] == "adept" else f"{TABLETOP.palm_length:g}"
    for palm in PALMS:
        yield f"palm{palm}", Prompt(f"Palm {palm} is so many mm long", length, number(10, 2000))
    yield "tilt", Prompt("The palms' plane is tilted from the horizontal by so many degrees (90: upright)", "90",
                           number(1, 90))  # fmt: skip


def _of_an_array(answers: Mapping[str, Any]) -> Iterator[tuple[str, Prompt]]:
    meanings = {name: each.meaning for name, each in ARRAYS.items()}
    yield "protocol", Prompt(f"An array speaks\n{_listed(meanings)}", "text", one_of(meanings))
    array = ARRAYS[answers["protocol"]]
    yield "rows", Prompt("It has so many rows along the palm", str(array.usual_rows), whole(*array.rows))
    if answers["protocol"] == "text":
        yield "columns", Prompt("and so many columns across it", "4", whole(*range(1, 65)))
    yield "pitch", Prompt("Neighbouring taxels are so many mm apart", f"{array.pitch_mm:g}", number(0.1, 20))
    yield "first_row", Prompt("The middle of the first row is so many mm from the axis", "1", number(0, 300))


def _listed(words: Mapping[str, str]) -> str:
    return "\n".join(f"  {word:10} {meaning}" for word, meaning in words.items()) + "\nWhich"


def configuration(answers: Mapping[str, Any]) -> dict[str, Any]:
    """What the answers come to, as it stands in the file; what has its default is left out."""
    rig: dict[str, Any] = {}
    if answers["tilt"] != 90.0:
        rig["gravity_m_s2"] = round(STANDARD_GRAVITY * math.sin(math.radians(answers["tilt"])), 4)
    arm: dict[str, Any] = {"kind": answers["arm"], "port": answers["port"]}
    if answers["arm"] != "adept":
        rig["hinge"] = "fixed"
    lengths = [answers[f"palm{palm}"] for palm in PALMS]
    rig |= {f"palm{palm}_length_mm": length for palm, length in zip(PALMS, lengths, strict=True)}
    if answers["arm"] == "adept":
        rig["base_mm"] = [lengths[0], 0.0]
    pad: dict[str, Any] = {"kind": answers["pads"]}
    if answers["pads"] == "evdev":
        pad |= {"zero_mm": 0.0, "pressure": answers["pressure"] == "yes"}
        if answers["counts_per_mm"] != REPORTED:
            pad["counts_per_mm"] = answers["counts_per_mm"]
    if answers["pads"] == "strip":
        start, active = answers["strip_start"], answers["strip_length"]
        pad |= {"zero_mm": start, "length_mm": start + active, "counts_per_mm": round(STRIP_COUNTS / active, 2)}
    if answers["pads"] == "taxels":
        pad |= _array(answers)
    pads = {f"palm{palm}": pad | {"port": answers[f"pad{palm}"]} for palm in PALMS}
    return {"rig": rig, "pads": pads, "arm": arm, "plan": PLAN}


def _array(answers: Mapping[str, Any]) -> dict[str, Any]:
    protocol, rows, pitch, first = (answers[key] for key in ("protocol", "rows", "pitch", "first_row"))
    columns = {"tsf85": TSF85_COLUMNS, "st0001": ST0001_TAXELS // rows}.get(protocol) or answers["columns"]
    return {
        "protocol": protocol, "rows": rows, "columns": columns, "pitch_mm": pitch, "zero_mm": first,
        "length_mm": round(first + (rows - 0.5) * pitch, 3),
    }  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("output", nargs="?", type=Path, default=Path("palmd.yaml"), metavar="FILE",
                        help="the configuration to write (default: %(default)s)")  # fmt: skip
    parser.add_argument("--force", action="store_true", help="write over what is there")


def run(arguments: argparse.Namespace) -> int:
    """Writes the configuration, and the exploring plan beside it; CliError when nothing can be written."""
    path: Path = arguments.output
    if path.exists() and not arguments.force:
        raise CliError(BAD_INPUT, f"{path} is there already: name another file, or give --force")
    answers: dict[str, Any] = {}
    for key, question in questions(answers):
        answers[key] = asked(question)
        if key == "pads" and (note := pad_note(answers[key])):
            print(f"Note: {note}.", file=sys.stderr)
    try:
        _write(path, configuration(answers))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: {error.strerror}") from None
    _checked(path)
    print(f"written: {path}\nnext:    palmd doctor {path}")
    return 0


def asked(question: Prompt, command: str = "init") -> Any:
    """The answer; asked again until it is one, CliError when nobody answers."""
    while True:
        print(f"{question.text} [{question.usual}]: ", end="", flush=True, file=sys.stderr)
        line = sys.stdin.readline()
        if not line:
            print(file=sys.stderr)
            raise CliError(
                BAD_INPUT, f"nobody answers: palmd {command} asks at a terminal, or takes a line for each answer"
            )
        try:
            return question.read(line.strip() or question.usual)
        except ValueError as error:
            print(f"  it must be {error}", file=sys.stderr)


def _write(path: Path, values: Mapping[str, Any]) -> None:
    plan = path.parent / PLAN
    plan.parent.mkdir(parents=True, exist_ok=True)
    if not plan.exists():
        plan.write_text(shipped(PLAN).read_text(encoding="utf-8"), encoding="utf-8")
    head = "# Written by palmd init. All keys and their defaults: docs/configuration.md\n"
    text = yaml.safe_dump(dict(values), sort_keys=False, default_flow_style=None, width=120)
    path.write_text(head + text, encoding="utf-8")


def _checked(path: Path) -> None:
    from palmd.motion.check import check_files

    if errors := check_files([path]):
        raise CliError(BAD_INPUT, "\n".join(errors))
