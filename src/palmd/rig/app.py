"""`palmd rig`: the emulated rig as a process, with its ports on pseudo-terminals, in real time.

It prints one JSON line with the ports' paths and two ZeroMQ addresses. `truth` publishes the true state (`rig/truth` at
100 Hz, `rig/object` at 1 Hz) in the daemon's format of three frames; `control` takes `{id, cmd, args}` like the
daemon's command socket:

    status      counters for end-to-end checks
    faults      all injectable faults by name, with descriptions
    inject      {name, port?, strength?, after_s?, for_s?}: inject a fault; returns its start on the monotonic clock
    clear       {name, port?}: end a fault
    new_object  exchange the object
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

from palmd.aliases import RIG_OPTIONS, RIG_REQUESTS, aliases_of, standard_name
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
from palmd.rig.line import EmulatedLine, LineWaiter, PtyLine, SocketLine
from palmd.rig.plant import AS_ASSUMED, PHYSICS
from palmd.rig.roller import KINDS as ROLLERS
from palmd.rig.shapes import EVERY_KIND, Body, cylinder
from palmd.rig.tally import Decoder
from palmd.rig.uinput import UinputLine
from palmd.rig.world import default_config
from palmd.systems import LIVE, SYSTEMS, load_part
from palmd.topics import RIG_TOPICS
from palmd.yamlfile import ConfigError, load_any_config

PERIOD_S = 1e-3
TRUTH_S, OBJECT_S, PARENT_S = 1.0 / TRUTH.rate_hz, 1.0 / BODY.rate_hz, 0.5
MARBLES: dict[str, tuple[PortName, ...]] = {pad.removeprefix("pad"): (pad,) for pad in PADS} | {"both": PADS}
_LATE_S, _STALLED_S = 2e-3, 20e-3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments, for `palmd rig`."""
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG", help="palmd.yaml; default: as shipped")
    parser.add_argument("--seed", type=int, help="seed of object, pads and noise; default: a random one, printed")
    add_object_arguments(parser)
    gauge = parser.add_mutually_exclusive_group()
    gauge.add_argument("--marble", choices=MARBLES, help="a marble rolls over this pad; there is no other object")
    gauge.add_argument("--cylinder", type=_cylinder, action="append", default=[], metavar="RADIUS_MM,MASS_G",
                       help="the object is this solid cylinder; repeat for the ones it is exchanged for")  # fmt: skip
    gauge.add_argument("--roller", choices=ROLLERS, help="it rolls down the gentler palm; there is no other object")
    gauge.add_argument("--by-hand", action="store_true", help="manual mode: a hand swings the empty palms")
    parser.add_argument(
        "--inject",
        action="append",
        default=[],
        metavar="NAME[@PORT][,strength=X][,after=S][,for=S]",
        help=f"inject a fault; may be repeated; names: {', '.join(ALL_FAULTS)}",
    )
    for alias in aliases_of(RIG_OPTIONS):
        target = alias.standard.removeprefix("--")
        parser.add_argument(alias.former, dest=target, action="append", help=argparse.SUPPRESS)
    parser.add_argument(
        "--uinput",
        action="store_true",
        help="emulate input devices by the kernel's uinput; a desktop receives their events until palmd opens them",
    )
    parser.add_argument(
        "--ports", type=Path, metavar="FOLDER", help="folder of its ports, created if needed; default: a temporary one"
    )
    parser.add_argument(
        "--sockets", action="store_true", help="serial ports are UNIX sockets, which a busy machine does not delay"
    )


def add_object_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that select the object and the physics engine: for `palmd rig` and for commands that start one."""
    parser.add_argument("--kind", choices=EVERY_KIND, help="kind of object (default: rig; with MuJoCo ellipse)")
    parser.add_argument(
        "--physics", choices=PHYSICS, default=AS_ASSUMED.physics,
        help="what moves the object on two flat palms: palmd's own emulation, or the engine MuJoCo, for ellipses"
        " (default: %(default)s)",
    )  # fmt: skip


def run_rig(arguments: argparse.Namespace) -> int:
    """Run the rig until SIGTERM, SIGINT or the end of the parent process; returns the exit status, 1 for bad input."""
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
        for text in arguments.inject:
            world.fault_injector.add(parse(text, t))
    except (ConfigError, ValueError) as error:
        return _refuse(str(error))
    if arguments.uinput and not uinput.available():
        return _refuse(
            f"--uinput: {uinput.UINPUT} is not writable (run sudo modprobe uinput, and as root or with a udev rule)"
        )
    with contextlib.ExitStack() as exit_stack:
        try:
            folder = _folder(arguments.ports, max(world.ports, key=len), exit_stack)
        except FileExistsError:
            return _refuse(f"--ports: {arguments.ports} is not a folder")
        except OSError as error:
            return _refuse(f"--ports: {arguments.ports}: {error.strerror}")
        try:
            rig = RigProcess(world, folder, stop, input_devices=arguments.uinput, sockets=arguments.sockets)
        except OSError as error:
            return _refuse(f"cannot create ports in {folder}: {error.strerror}; choose another folder with --ports")
        with contextlib.suppress(BrokenPipeError):
            print(json.dumps(rig.addresses()), flush=True)
        rig.run()
    return 0


def _world(config: AnyConfig, seed: int, arguments: argparse.Namespace, t: float) -> EmulatedRig[Any]:
    rig_class = load_part(LIVE[config.system].rig)
    physics = arguments.physics
    if physics == "mujoco":
        require("--physics mujoco", "mujoco", "mujoco")
        if arguments.kind not in (None, "ellipse"):
            raise ValueError(f"--physics mujoco takes --kind ellipse, not {arguments.kind}")
    extra_arguments = {
        "marbles": MARBLES.get(arguments.marble),
        "bodies": arguments.cylinder,
        "roller": arguments.roller,
        "by_hand": arguments.by_hand,
        "options": replace(AS_ASSUMED, physics=physics) if physics != AS_ASSUMED.physics else None,
    }
    given = {name: gauge for name, gauge in extra_arguments.items() if gauge}
    if not given.keys() <= rig_class.extra_arguments:
        words = SYSTEMS[config.system].words
        raise ValueError(f"--marble, --cylinder, --roller, --by-hand and --physics need two palms; this is {words}")
    kind = arguments.kind or ("ellipse" if physics == "mujoco" else "rig")
    world: EmulatedRig[Any] = rig_class(config, seed, kind=kind, t=t, **given)
    return world


def _folder(given: Path | None, longest_name: str, exit_stack: contextlib.ExitStack) -> Path:
    """The folder of the ports: the one given, created if needed, or a temporary one that `exit_stack` removes.

    longest_name: of the ports, as paths of sockets are limited. Raises OSError.
    """
    if given is None:
        return Path(exit_stack.enter_context(socket_folder("palmd-rig-", longest_name)))
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
    """A signal handler that only records that it was called."""

    def __init__(self) -> None:
        self.made = False

    def __call__(self, _signal: int, _frame: FrameType | None) -> None:
        self.made = True


class RigProcess:
    """The world behind its ports and sockets. Ports are links in `folder`, as udev would name them.

    All bytes that a port has accepted are also decoded here, for comparison with the real host.
    """

    def __init__(
        self,
        world: EmulatedRig[Any],
        folder: Path,
        stop: StopSignal,
        *,
        input_devices: bool = False,
        sockets: bool = False,
    ) -> None:
        """With `sockets` serial lines are sockets; with `input_devices` the other pads are kernel input devices.

        Raises OSError if a port cannot be created.
        """
        self.world = world
        self.ticks = self.late_ticks = self.stalls = 0
        self.latest_s = 0.0
        self._t_last_tick = math.inf  # the last tick's time
        self._stop = stop
        self._parent = os.getppid()
        self._seq = {topic.name: 0 for topic in RIG_TOPICS}
        noise = np.random.default_rng(world.seed)
        self._lines: dict[PortName, EmulatedLine] = {}
        for port in world.ports:
            path, baud = folder / port, world.bauds[port]
            if input_devices and baud is None:
                self._lines[port] = UinputLine(path)
            elif sockets and baud is not None:
                self._lines[port] = SocketLine(path)
            else:
                self._lines[port] = PtyLine(path, baud, noise)
        self._reference: dict[PortName, Decoder] = {port: world.make_decoder(port) for port in world.ports}
        self._waiter = LineWaiter()
        for line in self._lines.values():
            self._toggle_plug(line)
        self._context = zmq.Context()
        self._truth = self._context.socket(zmq.PUB)
        self._control = self._context.socket(zmq.ROUTER)
        self._truth_address = _bind(self._truth)
        self._control_address = _bind(self._control)

    def addresses(self) -> dict[str, Any]:
        """The fields of the JSON line."""
        found: dict[str, Any] = {port: str(line.path) for port, line in self._lines.items()}
        return found | {
            "truth": self._truth_address,
            "control": self._control_address,
            "seed": self.world.seed,
        }

    def run(self) -> None:
        """Run in real time, one tick per millisecond on absolute deadlines, until a stop is requested."""
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
        """Receive from the host, advance to t (s), transmit.

        Data read now was written after the last tick, and is dated to that tick; if that was long ago, the world is
        given the possible delay.
        """
        world = self.world
        late_s, self._t_last_tick = max(t - self._t_last_tick - PERIOD_S, 0.0), t
        events = self._waiter.ready()
        for port, line in self._lines.items():
            if world.unplugged(port) == line.plugged:
                self._reference[port].reset()
                self._toggle_plug(line)
                continue
            data, flushed = line.read(events.get(line.fileno, 0))
            if flushed:
                world.opened(port)
            if data:
                world.receive(port, data, late_s)
        for port, sent in world.advance(t).items():
            if not sent:
                continue
            self._reference[port].feed(self._lines[port].write(sent), t)

    def _toggle_plug(self, line: EmulatedLine) -> None:
        if line.plugged:
            self._waiter.forget(line.fileno)
            line.unplug()
        else:
            line.plug()
            self._waiter.watch(line.fileno, edge_triggered=line.edge_triggered)

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
        """Answer at most one command, so that a flood of commands cannot stop the rig."""
        try:
            *envelope, request = self._control.recv_multipart(zmq.NOBLOCK)
        except zmq.Again:
            return
        with contextlib.suppress(zmq.Again, zmq.ZMQError):
            self._control.send_multipart([*envelope, msgpack.packb(self._reply(request))], zmq.NOBLOCK)

    def _reply(self, request: bytes) -> dict[str, Any]:
        identity = None
        try:
            message = msgpack.unpackb(request)
            identity = message.get("id")
            result = self._execute(message["cmd"], message.get("args") or {})
        except InjectionError as error:
            return {"id": identity, "ok": False, "error": str(error)}
        except Exception as error:  # whatever a stranger sends, the rig goes on
            return {"id": identity, "ok": False, "error": f"invalid command: {type(error).__name__}: {error}"}
        return {"id": identity, "ok": True, "result": result}

    def _execute(self, command: str, args: dict[str, Any]) -> Any:
        world, t = self.world, self.world.t
        match standard_name(RIG_REQUESTS, command):
            case "status":
                return self._status()
            case "faults":
                return {name: fault.description for name, fault in ALL_FAULTS.items()}
            case "inject":
                orders = order(t=t, **args)
                world.fault_injector.add(orders)
                return {"t_on_s": orders[0].t_on}
            case "clear":
                world.fault_injector.cancel(args["name"], args.get("port"))
            case "new_object":
                world.new_object()
            case _:
                raise InjectionError(f"unknown command {command!r}; known: status, faults, inject, clear, new_object")
        return None

    def _status(self) -> dict[str, Any]:
        lines = {
            f"{port}_{what}": getattr(line, what)
            for port, line in self._lines.items()
            for what in ("bytes_sent", "bytes_lost", "bytes_heard")
        }
        decoded = {
            f"{port}_sent_{what}": n
            for port, decoder in self._reference.items()
            for what, n in {**decoder.counters.as_dict(), "pending": decoder.pending}.items()
        }
        timing = {
            "ticks": self.ticks,
            "late_ticks": self.late_ticks,
            "stalls": self.stalls,
            "latest_ms": self.latest_s * 1e3,
        }
        return self.world.status() | lines | decoded | timing


def _bind(socket: zmq.Socket[bytes]) -> str:
    port = socket.bind_to_random_port("tcp://127.0.0.1")
    return f"tcp://127.0.0.1:{port}"
