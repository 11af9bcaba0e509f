"""Kinds of arguments that several commands share; argparse tells what is wrong with one."""

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
    """Says what is wrong with an argument in the user's words, where argparse speaks of its own types and choices."""

    def error(self, message: str) -> NoReturn:
        """Ends with usage, the message and status 2."""
        message = _NO_VALUE.sub(lambda m: f"must be {_kind(m[1])}, got {m[2]}", message)
        super().error(_NO_CHOICE.sub(lambda m: no_such(m[1].strip("'"), re.findall(r"[^', ]+", m[2])), message))


def _kind(converter: str) -> str:
    return "a whole number" if converter in _WHOLE else "a number"


def no_such(text: str, names: Collection[str]) -> str:
    """That it is none of the names, and which may be meant, or which there are."""
    near = difflib.get_close_matches(text, names, n=1)
    return f"there is no {text!r}; " + (f"is {near[0]} meant?" if near else f"there are {', '.join(names)}")


def one_of(names: Collection[str]) -> Callable[[str], str]:
    """One of the names; else it is said which of them may be meant, or which there are."""

    def name(text: str) -> str:
        if text in names:
            return text
        raise argparse.ArgumentTypeError(no_such(text, names))

    return name


def count(text: str) -> int:
    """A whole number from 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is less than 1")
    return value


def seed(text: str) -> int:
    """A whole number from 0."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} is negative")
    return value


def seconds(text: str) -> float:
    """A duration that leaves something to see (s)."""
    value = float(text)
    if not _SHORTEST_S <= value < math.inf:
        raise argparse.ArgumentTypeError(f"must be {_SHORTEST_S:g} s or more, got {text}")
    return value


def seconds_within(least_s: float, most_s: float) -> Callable[[str], float]:
    """A duration (s) that is neither shorter nor longer."""

    def seconds(text: str) -> float:
        value = float(text)
        if not least_s <= value <= most_s:
            raise argparse.ArgumentTypeError(f"{value:g} s is not within {least_s:g} to {most_s:g} s")
        return value

    return seconds
