"""Characters that look like ASCII characters but are not: minus signs, no-break spaces, smart quotes. Pure."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass

_QUOTES = {"\u2018": "'", "\u2019": "'", "\u201a": "'", "\u2032": "'", "\u00b4": "'", "\u02bc": "'"}
_OTHERS = _QUOTES | {"\u2212": "-", "\u02d7": "-", "\u066b": ".", "\u00b7": ".", "\u2044": "/", "\u066c": ","}
_NON_ASCII = re.compile(r"[^\t\n\r -~]")
_LONGEST = 30  # longest text that is considered a number
_INVISIBLE = ("Cf", "Zl", "Zp", "Cc")
_GROUPED = re.compile(r"(?<=\d)[ '_](?=\d{3}(\D|$))")
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")


@dataclass(frozen=True, slots=True)
class NonAsciiCharacter:
    """A non-ASCII character, its index in the text, and whether it is inside quotes."""

    index: int
    character: str
    quoted: bool

    @property
    def is_invisible(self) -> bool:
        """Whether it is displayed as nothing or as a space."""
        return unicodedata.category(self.character) in (*_INVISIBLE, "Zs")


def non_ascii_characters(text: str) -> Iterator[NonAsciiCharacter]:
    """The non-ASCII characters of a YAML text outside of comments."""
    if not _NON_ASCII.search(text):
        return
    quote, before, comment = "", "\n", False
    for index, character in enumerate(text):
        if character in "\n\r":
            comment = False
        elif not comment and quote:
            quote = "" if character == quote and before != "\\" else quote
        elif not comment and character == "#" and before.isspace():
            comment = True
        elif not comment and character in "\"'" and (before.isspace() or before in "[{,:-"):
            quote = character
        if not comment and _NON_ASCII.match(character):
            yield NonAsciiCharacter(index, character, bool(quote))
        before = character


def is_letter(character: str) -> bool:
    """Whether it is a letter other than an accented ASCII letter."""
    return ascii_equivalent(character) is None and not unicodedata.normalize("NFKD", character)[0].isascii()


def ascii_equivalent(character: str) -> str | None:
    """The ASCII character that it looks like; empty if invisible, None if it looks like none."""
    if character.isascii():
        return character if character.isprintable() else ""
    category = unicodedata.category(character)
    if category == "Zs":
        return " "
    if category in _INVISIBLE:
        return ""
    if character in _OTHERS:
        return _OTHERS[character]
    if category == "Pd":
        return "-"
    if category in ("Pi", "Pf") or character in "\u201e\u2033":
        return '"'
    if category == "Nd":
        return str(unicodedata.digit(character))
    plain = "" if category == "No" else unicodedata.normalize("NFKC", character)
    return plain if len(plain) == 1 and plain.isascii() else None


def describe_character(character: str) -> str:
    """The character's code point and name, and what to write instead."""
    name = unicodedata.name(character, "a control character")
    replacement = ascii_equivalent(character)
    advice = {None: "write an ASCII character", "": "it is invisible: delete it", " ": "write a space"}
    return f"U+{ord(character):04X} {name}: {advice.get(replacement, f'write {replacement}')}"


def intended_number(text: str) -> str:
    """The number that a text probably means, in YAML notation; empty if it means none."""
    plain = "".join(each if (other := ascii_equivalent(each)) is None else other for each in text).strip(" '\"")
    plain = _GROUPED.sub("", plain)
    octal = re.fullmatch(r"([-+]?)0o([0-7]+)", plain)
    if octal:
        return f"{octal[1]}{int(octal[2], 8)}"
    if len(plain) > _LONGEST or not _NUMBER.fullmatch(plain) or plain.count(",") > 1:
        return ""
    mantissa, _, exponent = plain.replace(",", ".").lower().partition("e")
    if exponent:
        return f"{float(mantissa)}e{int(exponent):+d}"
    return str(float(mantissa)) if "." in mantissa else str(int(mantissa))
