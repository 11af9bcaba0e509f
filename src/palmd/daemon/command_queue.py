"""Queue of received commands: the order of execution, and which commands are rejected as busy. Pure.

While no more commands wait than a tick executes, they are executed in order of arrival. Otherwise `stop` and `hold` go
first, then the client in control, then the commands of other clients in turn, and status requests last.
"""

from __future__ import annotations

from collections import Counter

from palmd.daemon.commands import COMMANDS, Request
from palmd.daemon.ownership import ALWAYS_OBEYED, client_of

PER_TICK = 4
"""Commands executed in a tick; `stop` and `hold` do not count."""

MAX_WAITING = 32
"""Commands that may wait; further ones are rejected unless they have priority over one that waits."""

MAX_OWNER_EXTRA = 8
"""Further commands of the client in control that may wait."""

Key = tuple[str, str, str]
Refusal = tuple[Request, str]
Waiting = tuple[Request, Key]

_OWNER, _COMMAND, _QUESTION = range(3)


class CommandQueue:
    """Bounded queue of commands. Safe in the loop: the work is bounded by its length."""

    def __init__(self) -> None:
        self._waiting: list[Waiting] = []
        self._count: Counter[Key] = Counter()

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, request: Request, owner: Key) -> Refusal | None:
        """Queue a command; returns a rejected command and the reason, or None.

        If the queue is full, the rejected command is this one or one that had to make room.
        """
        key = client_of(request).key
        if len(self._waiting) >= MAX_WAITING:
            if request.name in ALWAYS_OBEYED:
                if any(each.name == request.name for each, _ in self._waiting):
                    return request, f"a {request.name} is already waiting"
            elif key != owner or self._count[key] >= MAX_OWNER_EXTRA:
                victim = self._victim(request, key, owner)
                if victim is None:
                    return request, self._busy(key)
                why = self._busy(victim[1])
                self._keep([each for each in self._waiting if each is not victim])
                self._append(request, key)
                return victim[0], why
        self._append(request, key)
        return None

    def take(self, owner: Key) -> tuple[list[Request], list[Refusal]]:
        """The commands to execute in this tick, and rejected ones: moving commands that a stop has overtaken."""
        if len(self._waiting) <= PER_TICK:
            served = [request for request, _ in self._waiting]
            self._keep([])
            return served, []
        last = max((number for number, (each, _) in enumerate(self._waiting) if each.name in ALWAYS_OBEYED), default=-1)
        urgent, refused, left = [], [], []
        for number, (each, key) in enumerate(self._waiting):
            if each.name in ALWAYS_OBEYED:
                urgent.append(each)
            elif number < last and COMMANDS[each.name].moves:
                refused.append((each, f"a {self._waiting[last][0].name} has overtaken it"))
            else:
                left.append((each, key))
        turns = _by_turns(left, owner)
        self._keep([left[number] for number in sorted(turns[PER_TICK:])])
        return urgent + [left[number][0] for number in turns[:PER_TICK]], refused

    def _victim(self, request: Request, key: Key, owner: Key) -> Waiting | None:
        """The waiting command to reject in favour of this one, or None.

        The newest one of the lowest priority, from the client with most waiting commands.
        """
        rank, mine = _rank(request, key, owner), self._count[key]
        if rank == _QUESTION and mine:
            return None
        worst = (rank, mine + 1, MAX_WAITING + MAX_OWNER_EXTRA)
        found: Waiting | None = None
        for number, waiting in enumerate(self._waiting):
            priority = (_rank(*waiting, owner), self._count[waiting[1]], number)
            if priority > worst and waiting[0].name not in ALWAYS_OBEYED:
                worst, found = priority, waiting
        return found

    def _busy(self, key: Key) -> str:
        return (
            f"busy: {self._count[key]} commands of this client and {len(self._waiting)} in total are waiting; try again"
        )

    def _append(self, request: Request, key: Key) -> None:
        self._waiting.append((request, key))
        self._count[key] += 1

    def _keep(self, waiting: list[Waiting]) -> None:
        self._waiting = waiting
        self._count = Counter([key for _, key in waiting])


def _rank(request: Request, key: Key, owner: Key) -> int:
    if key == owner:
        return _OWNER
    return _QUESTION if request.name == "status" else _COMMAND


def _by_turns(waiting: list[Waiting], owner: Key) -> list[int]:
    """Indices in order of execution: the owner's first, then each other client's first before any second one."""
    turns: Counter[Key] = Counter()
    order = []
    for number, (request, key) in enumerate(waiting):
        turns[key] += 1
        order.append((_rank(request, key, owner), 0 if key == owner else turns[key], number))
    return [number for *_, number in sorted(order)]
