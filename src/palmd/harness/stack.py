"""The emulated rig, a daemon on its ports, the recorder and the live page as child processes, and their clients."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import yaml
import zmq

from palmd.bus.command_client import CommandClient
from palmd.bus.subscriber import Message, Subscriber
from palmd.config.any_config import AnyConfig, BusConfig
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.harness.processes import Child

START_S = 240.0  # enough for compiling the observers on a slow machine
BUILDING_AFTER_S = 3.0
ANSWER_S = 5.0
LOOK_S = 0.1
ATTEMPTS = 3
PORTS = range(9872, 10872)  # below the system's ephemeral ports
PAGE_PORTS = range(8787, 8887)

Name = Literal["rig", "daemon", "recorder", "page"]


class Stack:
    """Enter it and start what is needed; everything ends when it is left. Each process may be restarted.

    `rig_info` is the emulated rig's JSON line, empty without one; `path` the daemon's configuration; `client` and
    `subscriber` are connected to the daemon, and the latter receives the rig's truth too.
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
        notify: Callable[[str], None] = lambda _text: None,
        show: Callable[[str], None] = lambda _address: None,
    ) -> None:
        """`folder` is for configurations and the processes' output, `runs` for recordings (None: in `folder`).

        Waiting ends once `give_up` returns True; `notify` gets messages about slow steps. `show` gets the page's
        address as soon as it is served, possibly before the daemon publishes.
        """
        self._folder, self._config, self._runs = folder, config, runs or folder / "runs"
        self._give_up, self._notify, self._show = give_up, notify, show
        self._count = 0
        self.rig_info: dict[str, Any] = {}
        self._exit_stacks: dict[str, ExitStack] = {}
        self.children: dict[Name, Child] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with ExitStack() as stack:
            for exit_stack in self._exit_stacks.values():
                stack.push(exit_stack)

    def begin(self, name: str, *arguments: str, **environment: str) -> Child:
        """Start a palmd command with its own folder; the process that had the name before is ended first."""
        if name in self._exit_stacks:
            self._exit_stacks.pop(name).close()
        exit_stack = self._exit_stacks.setdefault(name, ExitStack())
        self._count += 1
        folder = self._folder / f"{self._count}-{name}"
        folder.mkdir()
        child = self.child(list(arguments), folder, environment)
        exit_stack.callback(child.stop)
        return child

    # ---- starting ----------------------------------------------------------------------------------------

    def start_rig(self, *arguments: str, config: Path | None = None) -> bool:
        """Start the rig described in a file, by default the daemon's configuration including its imperfections.

        False if given up, CliError if the rig does not start.
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
        self.rig_info = json.loads(line)
        self._rig_client = self._exit_stacks["rig"].enter_context(CommandClient(self.rig_info["control"], ANSWER_S))
        return True

    def start(self, *, record: bool, page: bool = False) -> bool:
        """Start the daemon at free addresses, and its recorder; False if given up, CliError if the daemon fails.

        The process of a `page` is started with them; `start_page` waits for it. If another process takes the addresses
        meanwhile, other addresses are tried.
        """
        for _ in range(ATTEMPTS):
            self.configure(self._config, self.rig_info)
            if page:
                self._begin_page()
            self.begin_daemon()
            if record:
                self.start_recorder()  # listens before the daemon publishes, which takes longer to start
            if self.wait_for_daemon():
                return True
            if self._give_up():
                return False
            if "is in use" not in self.children["daemon"].error_output():
                break
        raise not_started(self.children["daemon"])

    def configure(self, config: AnyConfig, ports: Mapping[str, str] | None = None) -> None:
        """Write the daemon's configuration: with free addresses, and other `ports` (by pad1, pad2, arm) if given."""
        self.bus = free_addresses(config.bus)
        self.path = self._folder / "palmd.yaml"
        self.path.write_text(as_yaml(config, self.bus, ports, self._runs), encoding="utf-8")

    def begin_daemon(self, records: bool = False, /, **environment: str) -> None:
        """Start the configured daemon and connect to it; it may start its own recorder."""
        quietly = () if records else ("--no-record",)
        self.children["daemon"] = self.begin("daemon", "run", str(self.path), *quietly, **environment)
        exit_stack = self._exit_stacks["daemon"]
        self.subscriber = exit_stack.enter_context(Subscriber(self.bus.publish, *self._truth(), topics=self.topics))
        self.client = exit_stack.enter_context(CommandClient(self.bus.command, ANSWER_S))

    def wait_for_daemon(self, on_message: Callable[[Message], None] = lambda _message: None) -> bool:
        """Wait for the daemon's first message; returns whether it came. `on_message` gets all messages until then."""
        daemon, t_begin = self.children["daemon"], time.monotonic()
        notified = False
        while daemon.status is None and not self._watch_page() and time.monotonic() < t_begin + START_S:
            for message in self.subscriber.until(time.monotonic() + LOOK_S):
                on_message(message)
                if message.topic.startswith("palm"):
                    return True
            if not notified and time.monotonic() > t_begin + BUILDING_AFTER_S:
                notified = True
                self._notify("building the observers once, some 20 s…")
        return False

    def start_recorder(self) -> None:
        """Start the recorder; it listens when this returns, unless it fails to start, which is not an error."""
        truth = [word for address in self._truth() for word in ("--truth", address)]
        arguments = ("record", str(self.path), *truth)
        self.children["recorder"] = self.begin("recorder", *arguments)
        self.children["recorder"].first_line(START_S, self._watch_page)

    def _truth(self) -> list[str]:
        """Addresses at which the emulated rig publishes the truth."""
        return [self.rig_info["truth"]] if self.rig_info else []

    def start_page(self) -> bool:
        """Wait for the live page and set `page`; returns whether there is one; its process reports why not."""
        for attempt in range(ATTEMPTS):  # another process may take the port in between
            page = self.children.get("page")
            if attempt or page is None or page.status is not None:
                self._begin_page()
            line = self.children["page"].first_line(START_S, self._give_up)
            if line is not None or self._give_up():
                break
        self._served(line)
        return bool(line)

    def _watch_page(self) -> bool:
        """Show the page's address once it is served; returns whether to give up."""
        if "page" in self.children:
            self._served(self.children["page"].first_line(0.0))
        return self._give_up()

    def _served(self, address: str | None) -> None:
        if address and address != self.page:
            self.page = address
            self._show(address)

    def _begin_page(self) -> None:
        self.page = ""
        where = ("--address", self.bus.publish, "--command", self.bus.command, "--truth", self.rig_info["truth"],
                 "--config", str(self.path))  # fmt: skip
        port = str(_free_page_port())
        self.children["page"] = self.begin("page", "view", "--no-browser", *where, "--port", port)

    # ---- while it runs -----------------------------------------------------------------------------------

    def check_alive(self, *names: Name) -> None:
        """Raises CliError with its error output if one of these processes, by default any, has ended."""
        for name, child in self.children.items():
            if child.status is not None and (not names or name in names):
                raise CliError(
                    RIG_FAILED, f"{child.name} ended with status {child.status}\n{child.error_output()}".strip()
                )

    def ask_rig(self, command: str, **fields: Any) -> dict[str, Any]:
        """The emulated rig's answer to a command; CliError if it refuses."""
        reply = self._rig_client.ask(command, fields)
        if not reply["ok"]:
            raise CliError(RIG_FAILED, f"the emulated rig refuses {command}: {reply.get('error')}")
        return reply["result"] or {}

    def rig_status(self) -> dict[str, Any]:
        """The rig's counters."""
        return self.ask_rig("status")

    def recorded(self, timeout_s: float) -> list[Path]:
        """End the recorder, which then packs its recording; returns its files."""
        recorder = self.children["recorder"]
        recorder.stop(timeout_s)
        return [Path(line) for line in recorder.lines()[1:]]


def not_started(child: Child) -> CliError:
    """CliError with the process's error output, and its status if the input was invalid."""
    status = BAD_INPUT if child.status == BAD_INPUT else RIG_FAILED
    return CliError(status, child.error_output() or f"palmd {child.name} did not start")


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

    The rig's imperfections are included only for the emulated rig (`emulated`): the daemon must not know them.
    """
    values = config.model_dump(mode="json") | {"bus": bus.model_dump(mode="json")}
    if emulated:
        imperfections = config.rig.imperfections
        values["rig"]["imperfections"] = imperfections if isinstance(imperfections, str) else imperfections.model_dump()
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
    """The wanted addresses if they are free, else the next free ports of this machine."""
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
    """The first free port of the page's range, else any."""
    for port in PAGE_PORTS:
        with socket.socket() as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the page's server sets it
            probe.bind(("127.0.0.1", port))
            return port
    return 0
