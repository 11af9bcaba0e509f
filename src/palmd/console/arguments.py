"""Argument types shared by several commands, with error messages for argparse."""

from __future__ import annotations

import argparse
import difflib
import math
import re
from collections.abc import Callable, Collection
from typing import NoReturn

_SHORTEST_S = 0.5
_NO_VALUE = re.compile(r"invalid (\w+) value: (.*)$")
_NO_CHOICE = re.compile(r"invalid choice: (.*) \(choose from (.*)\)$")
_WHOLE = ("int", "count", "seed")


class Parser(argparse.ArgumentParser):
    """ArgumentParser with plain error messages for wrong types and choices."""

    def error(self, message: str) -> NoReturn:
        """Print usage and the message, and exit with status 2."""
        message = _NO_VALUE.sub(lambda m: f"must be {_kind(m[1])}, got {m[2]}", message)
        super().error(_NO_CHOICE.sub(lambda m: no_such(m[1].strip("'"), re.findall(r"[^', ]+", m[2])), message))


def _kind(converter: str) -> str:
    return "a whole number" if converter in _WHOLE else "a number"


def no_such(text: str, names: Collection[str]) -> str:
    """Error text for an unknown name: the closest name, or all names."""
    near = difflib.get_close_matches(text, names, n=1)
    return f"there is no {text!r}; " + (f"did you mean {near[0]!r}?" if near else f"choose from {', '.join(names)}")


def one_of(names: Collection[str]) -> Callable[[str], str]:
    """Argument type: one of the names; the error text has the closest name, or all names."""

    def name(text: str) -> str:
        if text in names:
            return text
        raise argparse.ArgumentTypeError(no_such(text, names))

    return name


def count(text: str) -> int:
    """Argument type: a whole number from 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is less than 1")
    return value


def seed(text: str) -> int:
    """Argument type: a whole number from 0."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} is negative")
    return value


def seconds(text: str) -> float:
    """Argument type: a duration (s) of at least 0.5 s."""
    value = float(text)
    if not _SHORTEST_S <= value < math.inf:
        raise argparse.ArgumentTypeError(f"must be {_SHORTEST_S:g} s or more, got {text}")
    return value


def positive(most: float = math.inf) -> Callable[[str], float]:
    """Argument type: a number more than 0, at most `most`."""

    def number(text: str) -> float:
        value = float(text)
        if not 0.0 < value <= most or math.isinf(value):
            limit = "" if math.isinf(most) else f" and at most {most:g}"
            raise argparse.ArgumentTypeError(f"must be more than 0{limit}, got {text}")
        return value

    return number


def between(low: float, high: float, unit: str = "") -> Callable[[str], float]:
    """Argument type: a number from `low` to `high`; `unit` is for the error text."""

    def number(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"must be {low:g} to {high:g}{unit}, got {text}")
        return value

    return number


def whole_between(low: int, high: int) -> Callable[[str], int]:
    """Argument type: a whole number from `low` to `high`."""

    def count(text: str) -> int:
        value = int(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"must be {low} to {high}, got {text}")
        return value

    return count
