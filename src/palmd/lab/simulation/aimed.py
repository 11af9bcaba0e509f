"""Runs that aim at one state with one fault in it, so that every command finds it there: drawn from one number. Pure.

What is drawn at random seldom has a rare fault in a rare state just when a command comes. Here the state is brought
about, the fault's cause is on for as long as the commands come, one by one, and the state is brought about again
before each.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

import msgpack

from palmd.daemon.commands import COMMANDS
from palmd.daemon.lifecycle import State
from palmd.faults import Fault
from palmd.lab.simulation.causes import CAUSES
from palmd.lab.simulation.happenings import (
    LONGEST_S,
    PARTS,
    PLAN_TEXTS,
    Broken,
    Bytes,
    Happening,
    Scenario,
    Slow,
    Stall,
    Told,
    Trick,
)
from palmd.lab.simulation.reached import rows, unreachable
from palmd.rig.fault_injection import INJECTABLE_FAULTS, PADS, PORTS

PAIRS: tuple[tuple[State, Fault | None], ...] = tuple(
    dict.fromkeys((state, fault) for state, fault, _ in rows() if unreachable(state, fault) is None)
)
"""What can be aimed at; a number aims at the pair that is as far along, round and round."""

BEGUN_S, STATE_S, CAUSE_S, FELT_S = 0.6, 1.2, 2.6, 1.4
"""When the arm has been armed, the state is brought about, the cause comes; and for how long before the commands do."""

GREETING_S = 0.003, 0.028
"""When the ports are open and the arm has not said hello yet."""

EACH_S, STEP_S = 0.9, 0.22
"""From one command to the next, and between those that bring the state about before it."""

LIVELY, EXPLORES = 1, 3
_BY_ITSELF = frozenset({"left", "restart"})
_SLOW_FAULTS = {"estimate-lost": 11.0, "recorder-silent": 3.5, "estimate-inconsistent": 3.0, "explorer-silent": 4.0}
_SUREST = {"lifted": "lift", "silent": "mute", "batched": "burst", "garbled": "garble"}
_SURELY = 0.8
"""By what a code ends with: what brings a fault about more surely than its other causes, and how often it is taken."""

_MANY, _FEW = (1.0, 3.0), (0.03, 0.1)
"""By how much stronger a trick is than usual; a line of thirty bytes is seldom whole where one in twenty is damaged."""

_OF_REAL_OBSERVER = ("estimate-inconsistent", "samples-too-late")
_WAY: dict[State, tuple[str, ...]] = {
    State.IDLE: (),
    State.READY: ("stop",),
    State.TRACKING: ("arm", "start"),
    State.HOLD: ("arm", "start", "hold"),
    State.FAULT: (),
}
_RECORDED: dict[str, object] = {"bytes": 1.0, "messages": 1.0, "lost": 0.0}
_ENDING = ("recorder", "reset", "stop")  # some faults: they come last


def aimed(number: int) -> Scenario:
    """The run of a number: the same in every process and on every machine."""
    rng = random.Random(number)
    state, fault = PAIRS[number % len(PAIRS)]
    code = "" if fault is None else fault.code
    t = CAUSE_S + _SLOW_FAULTS.get(code, FELT_S)
    probes = [name for name in COMMANDS if name not in _ENDING]
    rng.shuffle(probes)
    probes += rng.sample(_ENDING, len(_ENDING))
    until = t + EACH_S * len(probes)
    found = [*_brought(state, code, until, rng)]
    if fault is None and state is State.IDLE:
        found = [_told(rng.uniform(*GREETING_S), name, rng) for name in COMMANDS]  # later something is missing
    elif fault is not None:
        found += _cause(_drawn(code, rng), code, until - CAUSE_S, rng)
    for name in probes:
        way = _WAY[state]
        found += [_told(t + STEP_S * k, each, rng) for k, each in enumerate(way)]
        found.append(_told(t + STEP_S * len(way) + rng.uniform(0.0, 0.1), name, rng))
        t += EACH_S
    found.sort(key=lambda each: each.t)
    plan = EXPLORES if code == "explorer-silent" else LIVELY
    return Scenario(
        number, plan, False, 0.3, (rng.choice((0.001, 0.004)),) * len(PORTS), tuple(found), tuple(range(len(found))),
        thorough=code in _OF_REAL_OBSERVER, trouble_s=until, alone_s=until,
    )  # fmt: skip


def _brought(state: State, code: str, until: float, rng: random.Random) -> Iterator[Happening]:
    """What brings the state about."""
    if state in (State.TRACKING, State.HOLD, State.FAULT):
        yield _told(BEGUN_S, "arm", rng)
        if rng.random() < 0.8:
            yield _told(BEGUN_S + 2 * STEP_S, "start", rng)
    if state is State.HOLD:
        yield _told(STATE_S + 2 * STEP_S, "hold", rng)
    elif state is State.IDLE:
        port = rng.choice([each for each in PORTS if not code.startswith(each)])
        yield Trick(STATE_S, "unplug", port, 1.0, until - STATE_S)
    elif state is State.FAULT:
        yield from (_fault_of_arm if rng.random() < 0.5 else _fault_of_observer)(until)


def _fault_of_arm(until: float) -> Iterator[Happening]:
    yield Trick(STATE_S + 2 * STEP_S, "estop", "arm", 1.0, until - STATE_S)


def _fault_of_observer(_until: float) -> Iterator[Happening]:
    yield Broken(STATE_S + 2 * STEP_S, "raises", 0.3)


def _drawn(code: str, rng: random.Random) -> str:
    """One of a fault's causes."""
    names = sorted(CAUSES[code] - _BY_ITSELF)
    sure = _SUREST.get(code.partition("-")[2])
    surest = [name for name in names if name.partition("@")[0] == sure]
    return rng.choice(surest if surest and rng.random() < _SURELY else names)


def _cause(name: str, code: str, for_s: float, rng: random.Random) -> Iterator[Happening]:
    """What brings the fault about, from `CAUSE_S` on."""
    what, _, port = name.partition("@")
    t = CAUSE_S
    match what:
        case "bytes":
            for k in range(int(for_s / 0.1)):
                yield Bytes(t + 0.1 * k, port, rng.choice(("doubled", "lost", "stray")), rng.randbytes(20))
        case "stall":
            stall_s, every_s = rng.choice(((0.03, 0.06), (0.06, 0.2), (0.15, 0.5)))
            for k in range(int(for_s / every_s)):
                yield Stall(t + every_s * k, rng.choice(PARTS), stall_s)
        case "slow":
            yield Slow(t, "explorer", 4.0, for_s)
        case "broken":
            blind = code in ("estimate-lost", "explorer-silent")
            yield Broken(t, "blind" if blind else rng.choice(("raises", "nan", "blind")), for_s)
        case "told":
            yield from _said(code, t, for_s, rng)
        case _:
            trick = INJECTABLE_FAULTS[what]
            lasts_s = for_s if what != "unplug" or port not in PADS else min(for_s, 2 * LONGEST_S)
            some = _FEW if code == "arm-garbled" else _MANY
            strength = trick.strength * rng.choice(some)
            yield Trick(t, what, port or None, min(strength, 1.0) if what in ("drop", "garble") else strength, lasts_s)


def _said(code: str, t: float, for_s: float, rng: random.Random) -> Iterator[Happening]:
    """What a client's word brings about; a recorder's is heard each second, or once."""
    match code:
        case "recorder-failed":
            for k in range(int(for_s)):
                yield _message(t + k, "recorder", {**_RECORDED, "problem": "no space left"}, rng)
        case "recorder-silent":
            yield _message(t, "recorder", _RECORDED, rng)
        case _:
            yield _message(t, "plan", {"path": "sent.yaml", "text": PLAN_TEXTS[2]}, rng)
            yield _told(t + 0.1, "start", rng)


def _told(t: float, name: str, rng: random.Random) -> Told:
    args: dict[str, dict[str, object]] = {
        "plan": {"path": "sent.yaml", "text": PLAN_TEXTS[rng.randrange(2)]},
        "jog": {"phi1_deg": 0.1},
        "note": {"text": "here"},
        "recorder": _RECORDED,
    }
    return _message(t, name, args.get(name, {}), rng)


def _message(t: float, name: str, args: dict[str, object], rng: random.Random) -> Told:
    client = rng.randrange(2)
    message = {"id": rng.randrange(1 << 30), "cmd": name, "args": args, "from": f"client {client}"}
    return Told(t, client, msgpack.packb(message))
