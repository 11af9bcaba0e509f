"""Every state that the supervisor can reach, and every transition from it: `abstract_rig` defines the events."""

from collections import deque
from dataclasses import dataclass, field

import pytest
from abstract_rig import Rig, next_events

from palmd.daemon.lifecycle import COMMANDED, State
from palmd.faults import FAULTS, FaultMonitor
from palmd.harness.rules import Rules

pytestmark = pytest.mark.timeout(3600)  # a busy machine needs long for half a million ticks

FEW = ("arm", "start", "stop", "reset")


@dataclass
class Node:
    """A state of rig and daemon, as far as behaviour depends on it, and the transitions from it."""

    state: State
    moving: bool
    running: bool
    tracking: bool
    ways: dict[str, int] = field(default_factory=dict)
    granted: dict[str, bool] = field(default_factory=dict)
    broken: list[str] = field(default_factory=list)
    faults: frozenset[str] = frozenset()
    retreating: bool = False


def explored(rig, *commands):
    """All nodes that `rig` can reach, itself the first."""
    keys, nodes, waiting = {}, [], deque()

    def number(rig):
        key = rig.key()
        if key not in keys:
            keys[key] = len(nodes)
            nodes.append(Node(rig.state, rig.motion.moving, rig.motion.running, rig.arm.host.tracking))
            nodes[-1].retreating = rig.motion.retreating
            nodes[-1].faults = frozenset(fault.code for fault in rig.faults.active)
            waiting.append((rig, nodes[-1]))
        return keys[key]

    number(rig)
    while waiting:
        rig, node = waiting.popleft()
        copy = rig.copies()
        for name, do in next_events(rig, *([commands] if commands else [])):
            after = copy()
            do(after)
            node.ways[name] = number(after)
            node.granted[name] = name in after.granted
            node.broken += [f"{name}: {what}" for what in after.broken]
    return nodes


def reached(nodes, start, without):
    """The nodes that can be reached from some nodes without these events."""
    found, waiting = {*start}, [*start]
    while waiting:
        for name, after in nodes[waiting.pop()].ways.items():
            if name not in without and after not in found:
                found.add(after)
                waiting.append(after)
    return [nodes[number] for number in found]


@pytest.fixture(scope="module")
def nodes():
    return explored(Rig(fits=False))


def test_every_state_of_the_lifecycle_is_reached(nodes):
    assert {node.state for node in nodes} == {*State}
    assert len(nodes) > 3000


def test_no_transition_breaks_a_rule(nodes):
    assert [what for node in nodes for what in node.broken] == []


def test_the_arm_follows_only_after_arm_and_moves_only_after_start_or_jog(nodes):
    at_rest = [n for n, node in enumerate(nodes) if node.state in (State.IDLE, State.FAULT) and not node.moving]
    arming = {n for n in at_rest if any(nodes[after].state in COMMANDED for after in nodes[n].ways.values())}
    assert not arming  # neither idle nor fault is one step from an arm that follows
    assert not any(node.state in COMMANDED or node.tracking for node in reached(nodes, [0], {"arm"}))
    assert not any(node.moving for node in reached(nodes, [0], {"start", "jog"}))


def test_stop_is_possible_everywhere_and_ends_every_motion(nodes):
    for node in nodes:
        assert node.granted["stop"]
        after = nodes[node.ways["stop"]]
        assert after.state not in COMMANDED
        if after.retreating:  # from an arm that does not move the set-point is first withdrawn
            after = nodes[after.ways["tick"]]
        assert not after.tracking
        assert not after.moving


def test_after_hold_or_stop_nothing_moves_without_a_new_command(nodes):
    """Not even by a start that was given before and waited for its plan to be compiled."""
    after = {node.ways[name] for node in nodes for name in ("hold", "stop") if node.granted[name]}
    still = [number for number in after if not nodes[number].moving]
    assert not any(node.moving for node in reached(nodes, still, {"start", "jog"}))


def test_an_operator_can_move_the_palms_again_from_every_state(nodes):
    leading = [[] for _ in nodes]
    for number, node in enumerate(nodes):
        for after in node.ways.values():
            leading[after].append(number)
    waiting = [number for number, node in enumerate(nodes) if node.running]
    found = {*waiting}
    while waiting:
        for before in leading[waiting.pop()]:
            if before not in found:
                found.add(before)
                waiting.append(before)
    assert len(found) == len(nodes)


def test_after_a_fault_or_a_stop_autostart_starts_nothing():
    nodes = explored(Rig(autostart=True), *FEW)
    assert any(node.running for node in reached(nodes, [0], {"arm", "start"}))  # autostart works otherwise
    stopped = {node.ways["stop"] for node in nodes} | {n for n, node in enumerate(nodes) if node.state is State.FAULT}
    assert not any(node.state in COMMANDED for node in reached(nodes, stopped, {"arm"}))
    assert [what for node in nodes for what in node.broken] == []


@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault.latch != "no"], ids=lambda fault: fault.code)
def test_a_latched_fault_stays_until_reset_and_ends_with_it(fault):
    monitor = FaultMonitor()
    for t in (0.0, fault.debounce_s + 0.01):
        monitor.update({fault.code}, t, armed=True)
    monitor.reset()
    assert monitor.active == (fault,)  # its cause persists
    monitor.update(set(), 10.0, armed=True)
    assert monitor.active == (fault,)
    monitor.reset()
    assert monitor.active == ()
    assert fault.clears != "itself"


def test_violations_of_rules_are_detected():
    rules = Rules(State.READY)
    assert rules.tick([], [(State.READY, State.TRACKING)]) == ["from ready to tracking without a granted arm"]
    assert rules.look(State.TRACKING, [], running=True) == ["a plan runs without a granted start"]
    assert rules.look(State.TRACKING, ["hold"], running=False) == ["the state is tracking while a hold fault stands"]
    assert rules.look(State.HOLD, ["stop"], running=False) == ["the state is hold while a stop fault stands"]
    assert rules.look(State.READY, [], running=True) == ["a plan runs in state ready"]
    assert rules.tick([], [(State.TRACKING, State.IDLE)]) == ["nothing leads from tracking to idle"]
    assert rules.tick([], [(State.READY, State.FAULT)]) == ["the state was idle, and changed from ready"]
