"""`palmd rig`: the emulated rig as a process, its ports on pseudo-terminals, in real time.

Standard output gets one JSON line with the ports' paths and two ZeroMQ addresses, then nothing more. `truth`
publishes what is really there (`rig/truth` at 100 Hz, `rig/object` at 1 Hz) in the daemon's own three frames;
`control` takes `{id, cmd, args}` like the daemon's command socket:

    status      counts for end-to-end checks
    tricks      every mischief by name with its description
    mischief    {name, port?, strength?, after_s?, for_s?}: on; tells when, on the monotonic clock
    calm        {name, port?}: off
    new_object  a hand exchanges the object
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import gc
import json
import math
import os
import secrets
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import msgpack
import numpy as np
import zmq

from palmd.config.any_config import AnyConfig
from palmd.console.extras import require
from palmd.console.folders import socket_folder
from palmd.messages import stamp
from palmd.quantities import BODY, STALL, TRUTH, Topic
from palmd.rig import uinput
from palmd.rig.emulated import EmulatedRig
from palmd.rig.fault_injection import (
    ALL_FAULTS,
    PADS,
    InjectionError,
    PortName,
    order,
    parse,
)
from palmd.rig.line import LineWaiter, PtyLine, SocketLine
from palmd.rig.plant import AS_ASSUMED, PHYSICS
from palmd.rig.roller import KINDS as ROLLERS
from palmd.rig.shapes import EVERY_KIND, Body, cylinder
from palmd.rig.tally import Listener
from palmd.rig.uinput import UinputLine
from palmd.rig.world import default_config
from palmd.systems import LIVE, SYSTEMS, load_part
from palmd.topics import RIG_TOPICS
from palmd.yamlfile import ConfigError, load_any_config

Line = PtyLine | SocketLine | UinputLine

PERIOD_S = 1e-3
TRUTH_S, OBJECT_S, PARENT_S = 1.0 / TRUTH.rate_hz, 1.0 / BODY.rate_hz, 0.5
MARBLES: dict[str, tuple[PortName, ...]] = {pad.removeprefix("pad"): (pad,) for pad in PADS} | {"both": PADS}
_LATE_S, _STALLED_S = 2e-3, 20e-3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments, for `palmd rig`."""
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG", help="palmd.yaml; default: as shipped")
    parser.add_argument("--seed", type=int, help="which object, pads and noise; default: a random one, printed")
    add_object_arguments(parser)
    gauge = parser.add_mutually_exclusive_group()
    gauge.add_argument("--marble", choices=MARBLES, help="a marble rolls over this pad; then there is no object")
    gauge.add_argument("--cylinder", type=_cylinder, action="append", default=[], metavar="RADIUS_MM,MASS_G",
                       help="a turned cylinder is the object; given again: it is exchanged for that one")  # fmt: skip
    gauge.add_argument("--roller", choices=ROLLERS, help="it rolls down the gentler palm; then there is no object")
    gauge.add_argument("--by-hand", action="store_true", help="manual mode: a hand swings the empty palms")
    parser.add_argument(
        "--mischief",
        action="append",
        default=[],
        metavar="NAME[@PORT][,strength=X][,after=S][,for=S]",
        help=f"what goes wrong; may be given again; names: {', '.join(ALL_FAULTS)}",
    )
    parser.add_argument(
        "--uinput",
        action="store_true",
        help="emulated input devices are the kernel's own; a desktop beside it takes them too until palmd does",
    )
    parser.add_argument(
        "--ports", type=Path, metavar="FOLDER", help="where its ports are, made if need be; default: one of its own"
    )
    parser.add_argument(
        "--sockets", action="store_true", help="serial ports are UNIX sockets, which no busy machine holds up"
    )


def add_object_arguments(parser: argparse.ArgumentParser) -> None:
    """What sort of object there is, and who moves it: for `palmd rig` and whoever starts one."""
    parser.add_argument("--kind", choices=EVERY_KIND, help="what sort of object (default: rig; in MuJoCo ellipse)")
    parser.add_argument(
        "--physics", choices=PHYSICS, default=AS_ASSUMED.physics,
        help="who moves the object on two flat palms: palmd's own emulation, or the engine MuJoCo, which takes ellipses"
        " (default: %(default)s)",
    )  # fmt: skip


def run_rig(arguments: argparse.Namespace) -> int:
    """Runs the rig until SIGTERM, SIGINT or the parent's end; returns the exit status, 1 for bad input."""
    stop = StopSignal()
    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    seed = secrets.randbelow(2**31) if arguments.seed is None else arguments.seed
    if seed < 0:
        return _refuse(f"--seed must not be negative, got {seed}")
    try:
        config = load_any_config(arguments.config) if arguments.config else default_config()
        t = time.monotonic()
        world = _world(config, seed, arguments, t)
        for text in arguments.mischief:
            world.mischief.add(parse(text, t))
    except (ConfigError, ValueError) as error:
        return _refuse(str(error))
    if arguments.uinput and not uinput.available():
        return _refuse(
            f"--uinput: {uinput.UINPUT} cannot be written to (sudo modprobe uinput; as root, or by a udev rule)"
        )
    with contextlib.ExitStack() as leaving:
        try:
            folder = _folder(arguments.ports, max(world.ports, key=len), leaving)
        except FileExistsError:
            return _refuse(f"--ports: {arguments.ports} is not a folder")
        except OSError as error:
            return _refuse(f"--ports: {arguments.ports}: {error.strerror}")
        try:
            rig = RigProcess(world, folder, stop, input_devices=arguments.uinput, sockets=arguments.sockets)
        except OSError as error:
            return _refuse(f"its ports cannot be made in {folder}: {error.strerror}; --ports names another folder")
        with contextlib.suppress(BrokenPipeError):
            print(json.dumps(rig.addresses()), flush=True)
        rig.run()
    return 0


def _world(config: AnyConfig, seed: int, arguments: argparse.Namespace, t: float) -> EmulatedRig[Any]:
    made = load_part(LIVE[config.system].rig)
    physics = arguments.physics
    if physics == "mujoco":
        require("--physics mujoco", "mujoco", "mujoco")
        if arguments.kind not in (None, "ellipse"):
            raise ValueError(f"--physics mujoco takes --kind ellipse, not {arguments.kind}")
    gauges = {
        "marbles": MARBLES.get(arguments.marble),
        "bodies": arguments.cylinder,
        "roller": arguments.roller,
        "by_hand": arguments.by_hand,
        "options": replace(AS_ASSUMED, physics=physics) if physics != AS_ASSUMED.physics else None,
    }
    asked = {name: gauge for name, gauge in gauges.items() if gauge}
    if not asked.keys() <= made.gauges:
        words = SYSTEMS[config.system].words
        raise ValueError(f"marble, cylinder, roller, by-hand and physics are for two palms; this is {words}")
    kind = arguments.kind or ("ellipse" if physics == "mujoco" else "rig")
    world: EmulatedRig[Any] = made(config, seed, kind=kind, t=t, **asked)
    return world


def _folder(given: Path | None, longest: str, leaving: contextlib.ExitStack) -> Path:
    """Where the ports are, the `longest` name among them: the folder given, made if need be, or one for this run alone.

    That goes with `leaving`. Raises OSError.
    """
    if given is None:
        return Path(leaving.enter_context(socket_folder("palmd-rig-", longest)))
    given.mkdir(parents=True, exist_ok=True)
    if not os.access(given, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return given


def _cylinder(text: str) -> Body:
    try:
        radius_mm, mass_g = map(float, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be RADIUS_MM,MASS_G, such as 20,100; got {text}") from None
    if not (0.0 < radius_mm <= 200.0 and 0.0 < mass_g <= 5000.0):
        raise argparse.ArgumentTypeError(f"must be at most 200 mm and 5000 g, and more than 0; got {text}")
    return cylinder(radius_mm * 1e-3, mass_g * 1e-3)


def _refuse(text: str) -> int:
    print(text, file=sys.stderr)
    return 1


class StopSignal:
    """A signal handler that only remembers that it was called."""

    def __init__(self) -> None:
        self.made = False

    def __call__(self, _signal: int, _frame: FrameType | None) -> None:
        self.made = True


class RigProcess:
    """The world behind its ports and sockets. Ports are links in `folder`, as udev would name them."""

    def __init__(
        self,
        world: EmulatedRig[Any],
        folder: Path,
        stop: StopSignal,
        *,
        input_devices: bool = False,
        sockets: bool = False,
    ) -> None:
        """With `sockets` serial lines are sockets, with `input_devices` the others are input devices of the kernel's.

        Raises OSError for a port that cannot be made.
        """
        self.world = world
        self.ticks = self.late_ticks = self.stalls = 0
        self.latest_s = 0.0
        self._t_heard = math.inf  # the last tick's time
        self._stop = stop
        self._parent = os.getppid()
        self._seq = {topic.name: 0 for topic in RIG_TOPICS}
        noise = np.random.default_rng(world.seed)
        self._lines: dict[PortName, Line] = {}
        for port in world.ports:
            path, baud = folder / port, world.bauds[port]
            if input_devices and baud is None:
                self._lines[port] = UinputLine(path)
            elif sockets and baud is not None:
                self._lines[port] = SocketLine(path)
            else:
                self._lines[port] = PtyLine(path, baud, noise)
        self._listeners: dict[PortName, Listener] = {port: Listener(world.listener(port)) for port in world.ports}
        self._waiter = LineWaiter()
        for line in self._lines.values():
            self._move_plug(line)
        self._context = zmq.Context()
        self._truth = self._context.socket(zmq.PUB)
        self._control = self._context.socket(zmq.ROUTER)
        self._truth_address = _bind(self._truth)
        self._control_address = _bind(self._control)

    def addresses(self) -> dict[str, Any]:
        """What the JSON line says."""
        found: dict[str, Any] = {port: str(line.path) for port, line in self._lines.items()}
        return found | {
            "truth": self._truth_address,
            "control": self._control_address,
            "seed": self.world.seed,
        }

    def run(self) -> None:
        """Lives in real time, each millisecond, on absolute deadlines, until asked to stop."""
        gc.collect()
        gc.freeze()
        due = truth_due = object_due = parent_due = time.monotonic()
        try:
            while not self._stop.made:
                t = time.monotonic()
                self._note_lateness(t - due)
                self._tick(t)
                if t >= truth_due:
                    truth_due += TRUTH_S * (1 + int((t - truth_due) / TRUTH_S))
                    self._publish(self.world.topics[0], self.world.truth())
                    self._serve()
                if t >= object_due:
                    object_due = t + OBJECT_S
                    self._publish(self.world.topics[1], self.world.object_truth())
                if t >= parent_due:
                    parent_due = t + PARENT_S
                    self._stop.made |= os.getppid() != self._parent
                due = max(due + PERIOD_S, t)
                time.sleep(max(0.0, due - time.monotonic()))
        finally:
            for line in self._lines.values():
                line.unplug()
            self._context.destroy(linger=0)

    def _tick(self, t: float) -> None:
        """Hears the host, lives on to t (s), speaks.

        What is heard has been written since the last tick, and is taken for written then: where that tick is long ago,
        the world is told by how much it may be wrong.
        """
        world = self.world
        late_s, self._t_heard = max(t - self._t_heard - PERIOD_S, 0.0), t
        events = self._waiter.ready()
        for port, line in self._lines.items():
            if world.unplugged(port) == line.plugged:
                self._listeners[port].interrupted()
                self._move_plug(line)
                continue
            heard, flushed = line.read(events.get(line.fileno, 0))
            if flushed:
                world.opened(port)
            if heard:
                world.receive(port, heard, late_s)
        for port, said in world.advance(t).items():
            if not said:
                continue
            self._listeners[port].take(self._lines[port].write(said), t)

    def _move_plug(self, line: Line) -> None:
        if line.plugged:
            self._waiter.forget(line.fileno)
            line.unplug()
        else:
            line.plug()
            self._waiter.watch(line.fileno, edges=line.edges)

    def _note_lateness(self, late_s: float) -> None:
        self.ticks += 1
        self.late_ticks += late_s > _LATE_S
        self.latest_s = max(self.latest_s, late_s)
        if late_s > _STALLED_S:  # the daemon may rightly take it for silence
            self.stalls += 1
            self._publish(STALL, {"t_s": time.monotonic(), "lasted_s": late_s, "count": self.stalls})

    # -- sockets ------------------------------------------------------------------------------------------

    def _publish(self, topic: Topic, fields: dict[str, Any]) -> None:
        now = time.time()
        stamped = stamp(fields, now, self.world.t, self._seq[topic.name])
        self._seq[topic.name] += 1
        frames = [topic.frame, msgpack.packb(stamped), f"{now:.6f}".encode()]
        with contextlib.suppress(zmq.Again):
            self._truth.send_multipart(frames, zmq.NOBLOCK)

    def _serve(self) -> None:
        """Answers one command at most, so that a flood of them cannot stop the rig."""
        try:
            *envelope, request = self._control.recv_multipart(zmq.NOBLOCK)
        except zmq.Again:
            return
        with contextlib.suppress(zmq.Again, zmq.ZMQError):
            self._control.send_multipart([*envelope, msgpack.packb(self._answer(request))], zmq.NOBLOCK)

    def _answer(self, request: bytes) -> dict[str, Any]:
        identity = None
        try:
            message = msgpack.unpackb(request)
            identity = message.get("id")
            result = self._obey(message["cmd"], message.get("args") or {})
        except InjectionError as error:
            return {"id": identity, "ok": False, "error": str(error)}
        except Exception as error:  # whatever a stranger sends, the rig goes on
            return {"id": identity, "ok": False, "error": f"not a command: {type(error).__name__}: {error}"}
        return {"id": identity, "ok": True, "result": result}

    def _obey(self, command: str, args: dict[str, Any]) -> Any:
        world, t = self.world, self.world.t
        match command:
            case "status":
                return self._status()
            case "tricks":
                return {name: trick.description for name, trick in ALL_FAULTS.items()}
            case "mischief":
                orders = order(t=t, **args)
                world.mischief.add(orders)
                return {"t_on_s": orders[0].t_on}
            case "calm":
                world.mischief.cancel(args["name"], args.get("port"))
            case "new_object":
                world.new_object()
            case _:
                raise InjectionError(f"no command {command!r}; there are status, tricks, mischief, calm, new_object")
        return None

    def _status(self) -> dict[str, Any]:
        lines = {
            f"{port}_{what}": value
            for port, line in self._lines.items()
            for what, value in (
                ("bytes_sent", line.bytes_sent),
                ("bytes_lost", line.bytes_lost),
                ("bytes_heard", line.bytes_heard),
            )
        }
        sent = {
            f"{port}_sent_{what}": n
            for port, listener in self._listeners.items()
            for what, n in listener.as_dict().items()
        }
        pace = {
            "ticks": self.ticks,
            "late_ticks": self.late_ticks,
            "stalls": self.stalls,
            "latest_ms": self.latest_s * 1e3,
        }
        return self.world.status() | lines | sent | pace


def _bind(socket: zmq.Socket[bytes]) -> str:
    port = socket.bind_to_random_port("tcp://127.0.0.1")
    return f"tcp://127.0.0.1:{port}"
