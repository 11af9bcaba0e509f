"""One page: what waits to be sent to it, which never grows."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterable

from websockets.asyncio.server import ServerConnection

from palmd.view import wire
from palmd.view.feed import Payload

ANSWERS_MOST = 16


class PageClient:
    """A page that takes one batch at a time; while it is busy with one, the next frames are dropped and counted."""

    def __init__(self, connection: ServerConnection, operator: bool, name: str) -> None:
        """`operator`: whether it may give commands; `name`: what the daemon calls it, as one of its clients."""
        self.operator = operator
        self.name = name
        self.lost = 0
        self.waiting: list[str] = []  # its orders that have no answer yet
        self._connection = connection
        self._answers: deque[str] = deque(maxlen=ANSWERS_MOST)
        self._batch: bytes | None = None
        self._behind = True  # it has not even the last message of every topic
        self._due = asyncio.Event()

    def offer(self, frame: int, commandable: bool, messages: list[Payload], latest: Iterable[Payload]) -> None:
        """The messages of a frame; a page that has missed some gets the last of every topic instead."""
        if self._batch is not None:
            self.lost += 1
            self._behind = True
            return
        self._batch = wire.batch(frame, self.lost, commandable, latest if self._behind else messages)
        self._behind = False
        self._due.set()

    def tell(self, answer: str) -> None:
        """An answer to an order of it."""
        self._answers.append(answer)
        self._due.set()

    async def close(self, code: int, reason: str) -> None:
        """End the connection."""
        await self._connection.close(code, reason)

    async def serve(self) -> None:
        """Send what there is as fast as it is taken, until the connection ends."""
        while True:
            await self._due.wait()
            self._due.clear()
            while self._answers:
                await self._connection.send(self._answers.popleft())
            if self._batch is not None:
                await self._connection.send(self._batch)
                self._batch = None
