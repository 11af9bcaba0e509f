"""Random events of a simulated run: drawn completely from one seed in advance, so that any of them can be omitted.
Pure.

Every event contains all its parameters. Seed and numbers of the kept events repeat a run bit for bit.
"""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import msgpack

from palmd.daemon.commands import COMMANDS, Argument
from palmd.rig.fault_injection import INJECTABLE_FAULTS, PORTS, PortName

TROUBLE_S, CALM_S = 22.0, 8.0
"""Duration of the events, and recovery time after the last one has ended (s)."""

LEASES_S = (0.2, 2.0, 5.0, 100.0)
"""Declared leases (s): the last is refused; the longest valid one ends, and is reported, before the calm does."""

RATE_HZ = 100.0
"""Tick rate of the shipped daemon (Hz)."""

FIRST_S = 0.2
MOST_CLIENTS = 4
BURST_S = 0.05
LONGEST_S = 3.0

Part = Literal["between", "take in", "observe", "decide", "publish"]
PARTS: tuple[Part, ...] = ("between", "take in", "observe", "decide", "publish")


@dataclass(frozen=True, slots=True)
class ScheduledFault:
    """A fault injected into the emulated rig, with strength and duration."""

    t: float
    name: str
    port: PortName | None
    strength: float
    for_s: float


@dataclass(frozen=True, slots=True)
class ClientRequest:
    """A client's message to the command socket: a command or arbitrary bytes."""

    t: float
    client: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class Stall:
    """The daemon's process stands still for so long, in this part of its period."""

    t: float
    part: Part
    for_s: float


@dataclass(frozen=True, slots=True)
class Bytes:
    """The next bytes that the host reads at a port are doubled, lost, or preceded by stray bytes."""

    t: float
    port: PortName
    how: Literal["doubled", "lost", "stray"]
    stray: bytes = b""


@dataclass(frozen=True, slots=True)
class Slow:
    """A helper beside the loop takes so long for its work within `for_s`."""

    t: float
    who: Literal["planner", "explorer", "smoother"]
    takes_s: float
    for_s: float


@dataclass(frozen=True, slots=True)
class ClockStep:
    """The wall clock is set by so many seconds."""

    t: float
    by_s: float


@dataclass(frozen=True, slots=True)
class Restart:
    """The daemon ends, killed or on request, and another one starts `after_s` later."""

    t: float
    killed: bool
    after_s: float


@dataclass(frozen=True, slots=True)
class Broken:
    """The observer raises, marks NaN as valid, knows nothing, or predicts wrongly."""

    t: float
    how: Literal["raises", "nan", "blind", "misses"]
    for_s: float


RandomEvent = ScheduledFault | ClientRequest | Stall | Bytes | Slow | ClockStep | Restart | Broken


@dataclass(frozen=True, slots=True)
class Scenario:
    """All parameters of one run. `kept` are the numbers of the `events` among those drawn.

    `eager_s`: period of the operator who restarts the motion; `latency_s`: delivery period of each port's adapter.
    `thorough`: with the real observer and plant. `trouble_s`: duration of the events; until `alone_s` only drawn
    clients give commands. `calm_s`: recovery time after the last event. `coarse`: a light rig with longer steps.
    `rate_hz`: tick rate of the daemon.
    """

    seed: int
    plan: int
    autostart: bool
    eager_s: float
    latency_s: tuple[float, ...]
    events: tuple[RandomEvent, ...]
    kept: tuple[int, ...]
    thorough: bool = False
    trouble_s: float = TROUBLE_S
    alone_s: float = 0.0
    calm_s: float = CALM_S
    coarse: bool = False
    rate_hz: float = RATE_HZ

    def keeping(self, kept: Iterable[int]) -> Scenario:
        """The same run with these events only, by their numbers among those drawn."""
        mine = dict(zip(self.kept, self.events, strict=True))
        some = tuple(number for number in sorted(set(kept)) if number in mine)
        return replace(self, events=tuple(mine[number] for number in some), kept=some)


PLANS = 4
THOROUGH_EVERY = 64
"""One seed in so many has the real observer and plant."""


COARSE_LATENCY_S = 0.004


def coarsened(scenario: Scenario) -> Scenario:
    """The same run for half of the processor time: longer steps, and adapters that deliver less often."""
    return replace(scenario, coarse=True, latency_s=(COARSE_LATENCY_S,) * len(PORTS))


def drawn(seed: int) -> Scenario:
    """The run of a seed: the same in every process and on every machine."""
    rng = random.Random(seed)
    plan, autostart, eager_s = rng.randrange(PLANS), rng.random() < 0.1, rng.uniform(0.05, 0.8)
    latency_s = tuple(rng.choice((0.001, 0.002, 0.004)) for _ in PORTS)
    clients = 1 + rng.randrange(MOST_CLIENTS)
    found: list[RandomEvent] = []
    for _ in range(rng.randrange(1, 13)):
        t = rng.uniform(FIRST_S, TROUBLE_S - LONGEST_S)
        together = 1 if rng.random() < 0.6 else rng.randrange(2, 6)
        found += [_one(t + rng.uniform(0.0, BURST_S), rng) for _ in range(together)]
    for _ in range(rng.randrange(0, 60)):
        found.append(_request(rng.uniform(FIRST_S, TROUBLE_S), rng.randrange(clients), rng))
    if rng.random() < 0.1:
        t = rng.uniform(FIRST_S, TROUBLE_S)
        found += [_request(t + rng.uniform(0.0, BURST_S), rng.randrange(clients), rng) for _ in range(100)]
    found.sort(key=lambda each: each.t)
    events = tuple(found)
    numbers = tuple(range(len(events)))
    thorough = seed % THOROUGH_EVERY == THOROUGH_EVERY - 1
    alone_s = TROUBLE_S if autostart else 0.0
    return Scenario(seed, plan, autostart, eager_s, latency_s, events, numbers, thorough, alone_s=alone_s)


def _one(t: float, rng: random.Random) -> RandomEvent:
    """Bytes that are no command."""
    short = rng.choice((0.03, 0.3, 1.0, LONGEST_S))
    for_s = rng.uniform(0.2, 1.0) * short
    match rng.choices(("trick", "bytes", "stall", "slow", "clock", "restart", "broken"), (50, 15, 12, 6, 3, 5, 5))[0]:
        case "trick":
            trick = INJECTABLE_FAULTS[rng.choice(sorted(INJECTABLE_FAULTS))]
            port = rng.choice(trick.ports) if trick.ports else None
            strength = min(trick.strength * rng.choice((0.2, 1.0, 3.0)), 1.0 if trick.name in ("drop", "garble") else 9)
            return ScheduledFault(t, trick.name, port, strength, for_s)
        case "bytes":
            stray = rng.randbytes(rng.randrange(1, 40))
            return Bytes(t, rng.choice(PORTS), rng.choice(("doubled", "lost", "stray")), stray)
        case "stall":
            return Stall(t, rng.choice(PARTS), rng.choice((0.004, 0.012, 0.03, 0.06, 0.15, 0.4, 1.2)))
        case "slow":
            return Slow(t, rng.choice(("planner", "explorer", "smoother")), rng.choice((0.05, 0.5, 4.0)), LONGEST_S)
        case "clock":
            return ClockStep(t, rng.choice((-3600.0, -0.5, 0.5, 3600.0)))
        case "restart":
            return Restart(t, rng.random() < 0.6, rng.uniform(0.0, 1.0))
    return Broken(t, rng.choice(("raises", "nan", "blind")), for_s)


_WEIGHTS = {"status": 2, "arm": 8, "start": 10, "hold": 6, "stop": 4, "reset": 6, "plan": 4, "jog": 10, "note": 1}


def _request(t: float, client: int, rng: random.Random) -> ClientRequest:
    name = rng.choices(sorted(COMMANDS), [_WEIGHTS.get(each, 1) for each in sorted(COMMANDS)])[0]
    args = {each.name: _value(each, rng) for each in COMMANDS[name].arguments if each.required or rng.random() < 0.6}
    if name == "plan":
        args = {"path": "sent.yaml", "text": PLAN_TEXTS[rng.randrange(len(PLAN_TEXTS))]}
    message = {"id": rng.randrange(1 << 30), "cmd": name, "args": args, "from": f"client {client}"}
    if rng.random() < 0.2:
        message["lease_s"] = rng.choice(LEASES_S)
    payload: bytes = msgpack.packb(message)
    if rng.random() < 0.05:
        cut = bytearray(payload)
        cut[rng.randrange(len(cut))] ^= 1 << rng.randrange(8)
        payload = bytes(cut[: rng.randrange(1, len(cut) + 1)])
    return ClientRequest(t, client, payload)


def _value(argument: Argument, rng: random.Random) -> object:
    if argument.kind == "flag":
        return rng.random() < 0.5
    if argument.kind == "text":
        return rng.choice(("a word", "ärger", "x" * 90))
    low, high = max(argument.low, -1e6), min(argument.high, 1e6)
    return rng.choice((rng.uniform(low, high), 0.02 * low, 0.02 * high, 0.0, high * 1.01))


PLAN_TEXTS = (
    "name: sent\nrepeat: forever\nsegments:\n- move: {phi1_deg: 50, phi2_deg: 85}\n  duration_s: 0.4\n"
    "- sine: {phi1_deg: 10, phi2_deg: 6}\n  frequency_hz: 0.7\n  duration_s: 5\n",
    "name: short\nsegments:\n- move: {phi1_deg: 40, phi2_deg: 95}\n  duration_s: 0.5\n",
    "name: too fast\nsegments:\n- move: {phi1_deg: 100, phi2_deg: 40}\n  duration_s: 0.01\n",
    "name: [broken\n",
)

EXPLORE_TEXT = (
    "name: explore\nsegments:\n- move: {phi1_deg: 45, phi2_deg: 90}\n  duration_s: 1.0\n"
    "- explore: {coverage: 0.95, time_limit_s: 90}\n"
)
