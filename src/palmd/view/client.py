"""One connected page, with a bounded send queue."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterable

from websockets.asyncio.server import ServerConnection

from palmd.view import wire
from palmd.view.daemon_link import Payload

MAX_ANSWERS = 16


class PageClient:
    """A page that receives one batch at a time; frames that come while it is busy are dropped and counted."""

    def __init__(self, connection: ServerConnection, operator: bool, name: str) -> None:
        """`operator`: whether it may send commands; `name`: its client name at the daemon."""
        self.operator = operator
        self.name = name
        self.lost = 0
        self.waiting: list[str] = []  # its commands without an answer
        self._connection = connection
        self._answers: deque[str] = deque(maxlen=MAX_ANSWERS)
        self._batch: bytes | None = None
        self._behind = True  # it lacks the last message of some topics
        self._due = asyncio.Event()

    def offer(self, frame: int, commandable: bool, messages: list[Payload], latest: Iterable[Payload]) -> None:
        """Queue the messages of a frame; a page that has missed some gets the last message of every topic instead."""
        if self._batch is not None:
            self.lost += 1
            self._behind = True
            return
        self._batch = wire.batch(frame, self.lost, commandable, latest if self._behind else messages)
        self._behind = False
        self._due.set()

    def send_answer(self, answer: str) -> None:
        """Queue the answer to one of its orders."""
        self._answers.append(answer)
        self._due.set()

    async def close(self, code: int, reason: str) -> None:
        """End the connection."""
        await self._connection.close(code, reason)

    async def serve(self) -> None:
        """Send the queued data until the connection ends."""
        while True:
            await self._due.wait()
            self._due.clear()
            while self._answers:
                await self._connection.send(self._answers.popleft())
            if self._batch is not None:
                await self._connection.send(self._batch)
                self._batch = None
