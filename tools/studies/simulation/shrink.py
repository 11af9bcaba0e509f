"""The few happenings that break an invariant, out of the many among which it was found broken. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence

MOST_TRIES = 200


def shrunk(kept: Sequence[int], breaks: Callable[[Sequence[int]], bool], tries: int = MOST_TRIES) -> list[int]:
    """A smallest part of `kept` that still `breaks`, none of which can be left out: Zeller's ddmin.

    At most so many tries are made; what is left by then is given back.
    """
    kept, parts, made = list(kept), 2, 0
    while len(kept) > 1 and made < tries:
        size = max(1, len(kept) // parts)
        for start in range(0, len(kept), size):
            rest = kept[:start] + kept[start + size :]
            made += 1
            if rest and breaks(rest):
                kept, parts = rest, max(parts - 1, 2)
                break
            if made >= tries:
                return kept
        else:
            if size == 1:
                break
            parts = min(2 * parts, len(kept))
    return kept if kept and not breaks([]) else []
