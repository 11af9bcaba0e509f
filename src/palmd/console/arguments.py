"""Kinds of arguments that several commands share; argparse tells what is wrong with one."""

from __future__ import annotations

import argparse
import difflib
import math
from collections.abc import Callable, Collection

_SHORTEST_S = 0.5


def one_of(names: Collection[str]) -> Callable[[str], str]:
    """One of the names; else it is said which of them may be meant, or which there are."""

    def name(text: str) -> str:
        if text in names:
            return text
        near = difflib.get_close_matches(text, names, n=1)
        raise argparse.ArgumentTypeError(
            f"there is no {text!r}; " + (f"is {near[0]} meant?" if near else f"there are {', '.join(names)}")
        )

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
        raise argparse.ArgumentTypeError(f"{value:g} s is no duration from {_SHORTEST_S:g} s")
    return value


def seconds_within(least_s: float, most_s: float) -> Callable[[str], float]:
    """A duration (s) that is neither shorter nor longer."""

    def seconds(text: str) -> float:
        value = float(text)
        if not least_s <= value <= most_s:
            raise argparse.ArgumentTypeError(f"{value:g} s is not within {least_s:g} to {most_s:g} s")
        return value

    return seconds
