"""A daemon's bus without a daemon: it answers commands and publishes what a test wants."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from palmd.daemon.bus import Bus
from palmd.daemon.commands import Reply, Request


@contextmanager
def bus_daemon(
    folder: Path, answer: Callable[[Request], Reply], publish: Callable[[Bus], None] = lambda _bus: None
) -> Iterator[tuple[str, str]]:
    """Addresses of its publisher and its command socket; `publish` is called a few hundred times a second."""
    addresses = f"ipc://{folder}/publish", f"ipc://{folder}/command"
    bus, over = Bus(*addresses), threading.Event()

    def serve() -> None:
        while not over.wait(0.002):
            publish(bus)
            for request in bus.receive():
                bus.reply(answer(request))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield addresses
    finally:
        over.set()
        thread.join()
        bus.close()
