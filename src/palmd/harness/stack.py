"""The emulated rig, a daemon on its ports, the recorder and the live page: each a process of ours, talked with here."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, Literal, Self

import yaml
import zmq

from palmd.bus.command_client import CommandClient
from palmd.bus.subscriber import Message, Subscriber
from palmd.config.any_config import AnyConfig, BusConfig
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.harness.processes import Child

START_S = 240.0  # compiling the observers on a slow machine
BUILDING_AFTER_S = 3.0
ANSWER_S = 5.0
LOOK_S = 0.1
ATTEMPTS = 3
PORTS = range(9872, 10872)  # below those that the system hands out itself
PAGE_PORTS = range(8787, 8887)

Name = Literal["rig", "daemon", "recorder", "page"]


class Stack:
    """Enter it and start what is needed; left, all of it is gone. Each of the four may be started anew.

    `told` is the emulated rig's JSON line, empty without one; `path` the daemon's configuration; `client` and
    `subscriber` are the daemon's, and the latter hears the rig's truth too.
    """

    child: ClassVar[type[Child]] = Child
    topics: ClassVar[tuple[str, ...]] = ("palm", "rig/")

    bus: BusConfig
    path: Path
    page = ""
    client: CommandClient
    subscriber: Subscriber

    def __init__(
        self,
        folder: Path,
        config: AnyConfig,
        runs: Path | None = None,
        *,
        give_up: Callable[[], bool] = lambda: False,
        tell: Callable[[str], None] = lambda _text: None,
        show: Callable[[str], None] = lambda _address: None,
    ) -> None:
        """`folder` takes configurations and what the processes say, `runs` the recordings (None: in `folder`).

        Once `give_up` returns true nothing is waited for; `tell` gets messages about slow steps. `show` gets the page's
        address as soon as it is served, which may be before the daemon publishes.
        """
        self._folder, self._config, self._runs = folder, config, runs or folder / "runs"
        self._give_up, self._tell, self._show = give_up, tell, show
        self._count = 0
        self.told: dict[str, Any] = {}
        self._lives: dict[str, ExitStack] = {}
        self.children: dict[Name, Child] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with ExitStack() as stack:
            for life in self._lives.values():
                stack.push(life)

    def begin(self, name: str, *arguments: str, **environment: str) -> Child:
        """A palmd command with a folder of its own; what had the name before ends first."""
        if name in self._lives:
            self._lives.pop(name).close()
        life = self._lives.setdefault(name, ExitStack())
        self._count += 1
        folder = self._folder / f"{self._count}-{name}"
        folder.mkdir()
        child = self.child(list(arguments), folder, environment)
        life.callback(child.stop)
        return child

    # ---- starting ----------------------------------------------------------------------------------------

    def start_rig(self, *arguments: str, config: Path | None = None) -> bool:
        """As a file says, by default as its daemon's configuration, imperfections besides.

        False when given up, CliError when there is no rig.
        """
        if config is None:
            config = self._folder / "rig.yaml"
            ends = (*(f"pad{palm}" for palm in range(1, 1 + len(self._config.pads.each()))), "arm")
            nowhere = dict(zip(ends, ends, strict=True))
            config.write_text(as_yaml(self._config, self._config.bus, nowhere, emulated=True), encoding="utf-8")
        child = self.children["rig"] = self.begin("rig", "rig", str(config), *arguments)
        line = child.first_line(START_S, self._give_up)
        if self._give_up():
            return False
        if line is None:
            raise not_started(child)
        self.told = json.loads(line)
        self._hand = self._lives["rig"].enter_context(CommandClient(self.told["control"], ANSWER_S))
        return True

    def start(self, *, record: bool, page: bool = False) -> bool:
        """The daemon at addresses that are free, and its recorder; False when given up, CliError without a daemon.

        The process of a `page` begins beside them; `start_page` waits for it.

        Somebody else may take the addresses while the daemon starts: then at others.
        """
        for _ in range(ATTEMPTS):
            self.configure(self._config, self.told)
            if page:
                self._begin_page()
            self.begin_daemon()
            if record:
                self.start_recorder()  # which listens before the daemon, which takes longer to start, publishes
            if self.until_heard():
                return True
            if self._give_up():
                return False
            if "is in use" not in self.children["daemon"].said():
                break
        raise not_started(self.children["daemon"])

    def configure(self, config: AnyConfig, ports: Mapping[str, str] | None = None) -> None:
        """What `begin_daemon` goes by: at addresses that are free, on other `ports` (by pad1, pad2, arm) if need be."""
        self.bus = free_addresses(config.bus)
        self.path = self._folder / "palmd.yaml"
        self.path.write_text(as_yaml(config, self.bus, ports, self._runs), encoding="utf-8")

    def begin_daemon(self, records: bool = False, /, **environment: str) -> None:
        """A daemon as it is configured, whoever hears it; it may start a recorder of its own."""
        quietly = () if records else ("--no-record",)
        self.children["daemon"] = self.begin("daemon", "run", str(self.path), *quietly, **environment)
        life = self._lives["daemon"]
        self.subscriber = life.enter_context(Subscriber(self.bus.publish, *self._truth(), topics=self.topics))
        self.client = life.enter_context(CommandClient(self.bus.command, ANSWER_S))

    def until_heard(self, hear: Callable[[Message], None] = lambda _message: None) -> bool:
        """Whether the daemon speaks; `hear` is given what the rig says meanwhile, and the daemon's first word."""
        daemon, t_begin = self.children["daemon"], time.monotonic()
        told = False
        while daemon.status is None and not self._give_up() and time.monotonic() < t_begin + START_S:
            for message in self.subscriber.until(time.monotonic() + LOOK_S):
                hear(message)
                if message.topic.startswith("palm"):
                    return True
            if "page" in self.children:
                self._served(self.children["page"].first_line(0.0))
            if not told and time.monotonic() > t_begin + BUILDING_AFTER_S:
                told = True
                self._tell("building the observers once, some 20 s…")
        return False

    def start_recorder(self) -> None:
        """It listens when this returns, unless it does not start at all, which ends nothing."""
        truth = [word for address in self._truth() for word in ("--truth", address)]
        arguments = ("record", str(self.path), *truth)
        self.children["recorder"] = self.begin("recorder", *arguments)
        self.children["recorder"].first_line(START_S, self._give_up)

    def _truth(self) -> list[str]:
        """Where the emulated rig tells its truth."""
        return [self.told["truth"]] if self.told else []

    def start_page(self) -> bool:
        """Whether there is a live page, at `page`; why not is what its process said."""
        for attempt in range(ATTEMPTS):  # somebody else may take the port in between
            page = self.children.get("page")
            if attempt or page is None or page.status is not None:
                self._begin_page()
            line = self.children["page"].first_line(START_S, self._give_up)
            if line is not None or self._give_up():
                break
        self._served(line)
        return bool(line)

    def _served(self, address: str | None) -> None:
        if address and address != self.page:
            self.page = address
            self._show(address)

    def _begin_page(self) -> None:
        self.page = ""
        where = ("--address", self.bus.publish, "--command", self.bus.command, "--truth", self.told["truth"],
                 "--config", str(self.path))  # fmt: skip
        port = str(_free_page_port())
        self.children["page"] = self.begin("page", "view", "--no-browser", *where, "--port", port)

    # ---- while it runs -----------------------------------------------------------------------------------

    def check_alive(self, *names: Name) -> None:
        """Raises CliError, with its own words, for one of these that has ended; all of them by default."""
        for name, child in self.children.items():
            if child.status is not None and (not names or name in names):
                raise CliError(RIG_FAILED, f"{child.name} ended with status {child.status}\n{child.said()}".strip())

    def ask_rig(self, command: str, **fields: Any) -> dict[str, Any]:
        """What the emulated rig answers; CliError when it refuses."""
        reply = self._hand.ask(command, fields)
        if not reply["ok"]:
            raise CliError(RIG_FAILED, f"the emulated rig refuses {command}: {reply.get('error')}")
        return reply["result"] or {}

    def rig_status(self) -> dict[str, Any]:
        """What the rig has counted."""
        return self.ask_rig("status")

    def recorded(self, patience_s: float) -> list[Path]:
        """End the recorder, which then packs what it has; its files."""
        recorder = self.children["recorder"]
        recorder.stop(patience_s)
        return [Path(line) for line in recorder.lines()[1:]]


def not_started(child: Child) -> CliError:
    """Its own words, and its status where the input was wrong."""
    status = BAD_INPUT if child.status == BAD_INPUT else RIG_FAILED
    return CliError(status, child.said() or f"palmd {child.name} did not start")


# ------------------------------------------------------------------------------------- addresses, configuration


def as_yaml(
    config: AnyConfig,
    bus: BusConfig,
    ports: Mapping[str, str] | None = None,
    runs: Path | None = None,
    *,
    emulated: bool = False,
) -> str:
    """The configuration with these addresses and, if given, these ports and this folder of recordings.

    What the emulated rig is off by only stands in its own (`emulated`): a daemon is not told.
    """
    values = config.model_dump(mode="json") | {"bus": bus.model_dump(mode="json")}
    if emulated:
        asked = config.rig.imperfections
        values["rig"]["imperfections"] = asked if isinstance(asked, str) else asked.model_dump()
    if runs is not None:
        values["record"]["directory"] = str(runs)
    if ports is not None:
        for palm in range(1, 1 + len(config.pads.each())):
            values["pads"][f"palm{palm}"]["port"] = ports[f"pad{palm}"]
        values["arm"]["port"] = ports["arm"]
    if values["plan"] is None:
        del values["plan"]
    return yaml.safe_dump(values, allow_unicode=True)


def free_addresses(wanted: BusConfig) -> BusConfig:
    """The wanted addresses where nobody has them, else the next free ports of this machine."""
    publish = _free(wanted.publish, taken="")
    return wanted.model_copy(update={"publish": publish, "command": _free(wanted.command, taken=publish)})


def _free(wanted: str, taken: str) -> str:
    for address in (wanted, *(f"tcp://127.0.0.1:{port}" for port in PORTS)):
        if address != taken and _is_free(address):
            return address
    raise CliError(RIG_FAILED, f"{wanted} is in use, and so are {PORTS[0]} to {PORTS[-1]}")


def _is_free(address: str) -> bool:
    with zmq.Context() as context, context.socket(zmq.PUB) as probe:
        try:
            probe.bind(address)
        except zmq.ZMQError:
            return False
    return True


def _free_page_port() -> int:
    """The first of the page's ports that nobody has, else any."""
    for port in PAGE_PORTS:
        with socket.socket() as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the page's server has it
            probe.bind(("127.0.0.1", port))
            return port
    return 0
