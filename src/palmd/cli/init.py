"""Asks for the parts of your rig and writes a checked configuration.

Enter accepts the value in brackets. No device is opened, nothing moves; `palmd calibrate` measures the rig afterwards.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

from palmd.config.pads import ST0001_TAXELS, TSF85_COLUMNS, TSF85_ROWS
from palmd.config.tabletop import PALM_LENGTH_MM, STRIP_COUNTS, STRIP_LENGTH_MM, STRIP_START_MM
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.shipped import shipped
from palmd.devices.pad import pad_note
from palmd.system.mechanism import PALMS

STANDARD_GRAVITY = 9.81
PLAN = "plans/explore.yaml"
REPORTED = "reported"
Meaning = TypeVar("Meaning")


@dataclass(frozen=True, slots=True)
class Prompt:
    """One question: its text, its default, and the parser of answers; `read` raises ValueError for invalid ones."""

    text: str
    default: str
    read: Callable[[str], Any] = str


def one_of(words: Collection[str]) -> Callable[[str], str]:
    """Reader of one of several words; unambiguous abbreviations are accepted."""

    def read(answer: str) -> str:
        found = [word for word in words if word.startswith(answer.lower())]
        if len(found) != 1:
            raise ValueError(f"one of {', '.join(words)}")
        return found[0]

    return read


YES_OR_NO = one_of(("yes", "no"))


def number(low: float, high: float) -> Callable[[str], float]:
    """Reader of a number within a range."""

    def read(answer: str) -> float:
        with suppress(ValueError):
            value = float(answer)
            if low <= value <= high:
                return value
        raise ValueError(f"a number from {low:g} to {high:g}")

    return read


def whole(*allowed: int) -> Callable[[str], int]:
    """Reader of one of several whole numbers."""

    def read(answer: str) -> int:
        if answer not in map(str, allowed):
            raise ValueError(f"one of {', '.join(map(str, allowed))}")
        return int(answer)

    return read


def or_word(word: str, meaning: Meaning, read: Callable[[str], float]) -> Callable[[str], float | Meaning]:
    """Reader that also accepts `word` or its beginning, and returns its `meaning`."""
    return lambda answer: meaning if answer and word.startswith(answer.lower()) else read(answer)


PADS = {
    "versapad": "Interlink VersaPads on serial lines",
    "strip": "force-sensing strips with palmd's firmware",
    "evdev": "touch devices of Linux: pressure trackpads, touchpads and touch screens",
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
    """A kind of pressure sensor array: description, allowed numbers of rows, and defaults."""

    meaning: str
    rows: tuple[int, ...]
    default_rows: int
    pitch_mm: float
    width_mm: float


_ST0001_ROWS = tuple(rows for rows in range(3, ST0001_TAXELS + 1) if ST0001_TAXELS % rows == 0)
ARRAYS = {
    "tsf85": Array("one or two modules of 7 x 4 (Robotiq TSF-85) in a row", TSF85_ROWS, max(TSF85_ROWS), 4.5, 3.0),
    "st0001": Array("60 taxels polled by Modbus (Synria ST-00-01)", _ST0001_ROWS, 15, 4.0, 2.8),
    "text": Array("numbers that a microcontroller prints, a line for each reading", tuple(range(3, 65)), 20, 3.0, 2.0),
}


def questions(answers: Mapping[str, Any]) -> Iterator[tuple[str, Prompt]]:
    """Yield the questions with their keys; later ones may depend on the `answers` so far."""
    yield "pads", Prompt(f"Kind of the pads\n{_choices(PADS)}", "strip", one_of(PADS))
    for palm in PALMS:
        yield f"pad{palm}", Prompt(f"Port of pad {palm}", PORTS.get(answers["pads"], PORT).format(palm))
    if answers["pads"] == "evdev":
        yield "counts_per_mm", Prompt("Its counts per mm, or reported: as reported by the device", REPORTED,
                                        or_word(REPORTED, REPORTED, number(1e-3, 1000)))  # fmt: skip
        yield "pressure", Prompt("Does it report a pressure, yes or no", "no", YES_OR_NO)
        yield "pad_zero", Prompt("Distance in mm from the axis to where it counts 0, for some its middle", "0",
                                 number(-1000, 1000))  # fmt: skip
        yield "pad_end", Prompt("Distance in mm from the axis to its far end", f"{PALM_LENGTH_MM:g}", number(10, 500))
    if answers["pads"] == "taxels":
        yield from _array_questions(answers)
    if answers["pads"] == "strip":
        yield "strip_start", Prompt("Distance in mm from the axis to the strip's active area",
                                    f"{STRIP_START_MM:g}", number(0, 100))  # fmt: skip
        yield "strip_length", Prompt("Length of the active area in mm", f"{STRIP_LENGTH_MM:g}", number(10, 500))
    yield "arm", Prompt(f"Actuator of the palms\n{_choices(ARMS)}", "dynamixel", one_of(ARMS))
    yield "port", Prompt("Its port", "/dev/palmd-arm")
    length = "120" if answers["arm"] == "adept" else f"{PALM_LENGTH_MM:g}"
    for palm in PALMS:
        yield f"palm{palm}", Prompt(f"Length of palm {palm} in mm", length, number(10, 2000))
    yield "tilt", Prompt("Tilt of the palms' plane from the horizontal in degrees (90: upright)", "90",
                           number(1, 90))  # fmt: skip
    kit = answers["pads"] == "strip" and answers["arm"] != "adept"  # its parts include a motor for each palm
    yield "vibrate", Prompt("Does a shaker or vibration motor on each palm vibrate it along itself, yes or no",
                            "yes" if kit else "no", YES_OR_NO)  # fmt: skip


def _array_questions(answers: Mapping[str, Any]) -> Iterator[tuple[str, Prompt]]:
    meanings = {name: each.meaning for name, each in ARRAYS.items()}
    yield "protocol", Prompt(f"Protocol of the arrays\n{_choices(meanings)}", "text", one_of(meanings))
    array = ARRAYS[answers["protocol"]]
    yield "rows", Prompt("Number of rows along the palm", str(array.default_rows), whole(*array.rows))
    if answers["protocol"] == "text":
        yield "columns", Prompt("Number of columns across the palm", "4", whole(*range(1, 65)))
    yield "pitch", Prompt("Pitch of the taxels in mm", f"{array.pitch_mm:g}", number(0.1, 20))
    yield "width", Prompt("Width in mm (standard deviation) of the pressure under a contact; at least half the pitch",
                          f"{array.width_mm:g}", number(0.1, 20))  # fmt: skip
    yield "first_row", Prompt("Distance in mm from the axis to the middle of the first row", "1", number(0, 300))


def _choices(words: Mapping[str, str]) -> str:
    return "\n".join(f"  {word:10} {meaning}" for word, meaning in words.items()) + "\nWhich"


def configuration(answers: Mapping[str, Any]) -> dict[str, Any]:
    """Build the configuration from the answers, as in the file, without defaults."""
    rig: dict[str, Any] = {}
    if answers["tilt"] != 90.0:
        rig["gravity_m_s2"] = round(STANDARD_GRAVITY * math.sin(math.radians(answers["tilt"])), 4)
    rig["vibration"] = {"relation": "independent" if answers["vibrate"] == "yes" else "none"}
    arm: dict[str, Any] = {"kind": answers["arm"], "port": answers["port"]}
    if answers["arm"] != "adept":
        rig["hinge"] = "fixed"
    lengths = [answers[f"palm{palm}"] for palm in PALMS]
    rig |= {f"palm{palm}_length_mm": length for palm, length in zip(PALMS, lengths, strict=True)}
    if answers["arm"] == "adept":
        rig["base_mm"] = [lengths[0], 0.0]
    pad: dict[str, Any] = {"kind": answers["pads"]}
    if answers["pads"] == "evdev":
        pad |= {
            "zero_mm": answers["pad_zero"],
            "length_mm": answers["pad_end"],
            "pressure": answers["pressure"] == "yes",
        }
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
    protocol, rows, pitch, width, first = (answers[key] for key in ("protocol", "rows", "pitch", "width", "first_row"))
    columns = {"tsf85": TSF85_COLUMNS, "st0001": ST0001_TAXELS // rows}.get(protocol) or answers["columns"]
    return {
        "protocol": protocol, "rows": rows, "columns": columns, "pitch_mm": pitch,
        "contact_width_mm": width, "zero_mm": first, "length_mm": round(first + (rows - 0.5) * pitch, 3),
    }  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("output", nargs="?", type=Path, default=Path("palmd.yaml"), metavar="FILE",
                        help="the configuration to write (default: %(default)s)")  # fmt: skip
    parser.add_argument("--force", action="store_true", help="overwrite existing files")


def run(arguments: argparse.Namespace) -> int:
    """Write the configuration, and the exploring plan beside it; CliError if they cannot be written."""
    path: Path = arguments.output
    if path.exists() and not arguments.force:
        raise CliError(BAD_INPUT, f"{path} exists: name another file, or give --force")
    answers: dict[str, Any] = {}
    for key, question in questions(answers):
        answers[key] = ask(question)
        if key == "pads" and (note := pad_note(answers[key])):
            print(f"Note: {note}.", file=sys.stderr)
    try:
        _write(path, configuration(answers))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: {error.strerror}") from None
    _checked(path)
    print(f"written: {path}\nnext:    palmd doctor {path}")
    return 0


def ask(question: Prompt, command: str = "init") -> Any:
    """Ask until the answer is valid and return it; CliError at the end of the input."""
    while True:
        print(f"{question.text} [{question.default}]: ", end="", flush=True, file=sys.stderr)
        line = sys.stdin.readline()
        if not line:
            print(file=sys.stderr)
            raise CliError(
                BAD_INPUT, f"no answer: run palmd {command} at a terminal, or provide one line for each answer"
            )
        try:
            return question.read(line.strip() or question.default)
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
