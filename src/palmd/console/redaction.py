"""Removes passwords, tokens, secret keys and names of home folders from text. Pure."""

from __future__ import annotations

import re

REMOVED = "(removed)"

_NAMED = re.compile(
    r"""(?im)^(?P<head>.*?\b[\w-]*(?:passw|secret|token|api_?key|credential)[\w-]*["']?\s*[:=]\s*)(?P<value>[^,}\n]*[^,}\s])"""
)
_CURVE = re.compile(r"(?<![0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#])[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}(?![\w.])")
_USER_IN_ADDRESS = re.compile(r"(?<=://)[^/@\s:]+(?::[^/@\s]*)?@")
_HOME = re.compile(r"/home/[^/\s\"',:]+|/Users/[^/\s\"',:]+")


def redacted(text: str) -> str:
    """Return the text with secrets replaced by `REMOVED` and home folders by `~`."""
    text = _NAMED.sub(lambda found: found["head"] + REMOVED, text)
    text = _USER_IN_ADDRESS.sub(f"{REMOVED}@", text)
    text = _CURVE.sub(lambda found: REMOVED if _is_key(found[0]) else found[0], text)
    return _HOME.sub("~", text)


def _is_key(word: str) -> bool:
    """Whether a word of 40 characters can be a CURVE key in Z85: lower, upper and digits, and no path."""
    kinds = (str.islower, str.isupper, str.isdigit)
    return all(any(map(kind, word)) for kind in kinds) and word.count("/") < 4
