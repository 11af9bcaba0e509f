"""Who has control: a table of sequences, and properties of every sequence."""

from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmd.daemon.commands import COMMANDS, LEASE_MAX_S, Request
from palmd.daemon.ownership import ALWAYS_OBEYED, LEASE_S, NOBODY_KEY, Control, client_of

A, B = (client_of(Request("arm", client=name)) for name in ("a", "b"))


@dataclass
class Story:
    """Control after some requests: `(client, t, gains, lease)`."""

    control: Control = field(default_factory=Control)
    lost: list[str] = field(default_factory=list)

    def until(self, t):
        gone = self.control.expire(t)
        self.lost += [gone.name] if gone else []

    def send(self, client, t, *, gains=True, lease_s=None):
        self.until(t)
        self.control.renew(client, t, lease_s)
        if gains and self.control.other(client) is None:
            self.control.gain(client, t)


@pytest.mark.parametrize(
    ("requests", "t", "owner", "lost"),
    [
        ([(A, 0.0, {})], LEASE_S, "a", []),
        ([(A, 0.0, {})], LEASE_S + 0.01, "", []),
        ([(A, 0.0, {}), (A, 4.0, {"gains": False})], 8.9, "a", []),  # any request renews the lease
        ([(A, 0.0, {}), (B, 4.0, {"gains": False})], 5.1, "", []),  # but only the client's own
        ([(A, 0.0, {}), (B, 1.0, {})], 1.0, "a", []),
        ([(A, 0.0, {}), (B, 5.1, {})], 5.1, "b", []),
        ([(A, 0.0, {"lease_s": 20.0})], 19.9, "a", []),
        ([(A, 0.0, {"lease_s": 20.0})], 20.1, "", ["a"]),
        ([(A, 0.0, {"lease_s": 0.5})], 0.6, "", ["a"]),
        ([(A, 0.0, {"lease_s": 2.0}), (A, 1.9, {"gains": False})], 3.8, "a", []),  # the declaration stays valid
        ([(A, 0.0, {"lease_s": 2.0, "gains": False}), (A, 1.0, {})], 3.1, "", ["a"]),  # declared in advance
        ([(A, 0.0, {"lease_s": 2.0}), (A, 3.0, {})], 7.9, "a", ["a"]),  # it ends with the lease
        ([(A, 0.0, {"lease_s": 9.0}), (A, 1.0, {"lease_s": 1.0})], 2.1, "", ["a"]),
    ],
)
def test_control_after_a_sequence_of_requests(requests, t, owner, lost):
    story = Story()
    for client, at, how in requests:
        story.send(client, at, **how)
    story.until(t)
    assert (story.control.name, story.lost) == (owner, lost)


def test_clients_are_identified_by_their_name_or_connection_and_their_key():
    one, other = (b"\x01one",), (b"\x01two",)
    assert client_of(Request("arm", client="x", route=one)) == client_of(Request("stop", client="x", route=other))
    assert client_of(Request("arm", route=one)) == client_of(Request("stop", route=one))
    assert client_of(Request("arm", route=one)).key != client_of(Request("arm", route=other)).key
    assert client_of(Request("arm", client="x", member="ann")).key != client_of(Request("arm", client="x")).key
    assert client_of(Request("arm", client="6f6e65", route=one)).key != client_of(Request("arm", route=one)).key
    assert all(client_of(Request("arm", route=route)).name for route in (None, one))


def test_declared_leases_do_not_accumulate():
    control = Control()
    control.renew(A, 0.0, 60.0)
    control.gain(A, 0.0)
    for number in range(1000):
        control.renew(client_of(Request("status", client=f"c{number}")), 0.01, 60.0)
    assert len(control._declared) <= 64
    assert control.attended  # the client in control is never forgotten


REQUESTS = st.lists(
    st.tuples(
        st.floats(0.0, 10.0),
        st.sampled_from(["a", "b", "c"]),
        st.sampled_from(sorted(COMMANDS)),
        st.none() | st.floats(0.01, LEASE_MAX_S),
        st.booleans(),
    ),
    max_size=40,
)


@given(REQUESTS)
def test_control_changes_only_by_take_hold_or_stop(requests):
    control, t = Control(), 0.0
    heard = {}
    for dt, name, command, lease_s, take in requests:
        t += dt
        before = control.key
        control.expire(t)
        if control.key == NOBODY_KEY and before != NOBODY_KEY:
            assert t - heard[before][0] > heard[before][1] - 1e-9
        client = client_of(Request(command, client=name))
        control.renew(client, t, lease_s)
        _, before_s, declared = heard.get(client.key, (0.0, LEASE_S, False))
        if lease_s is not None:
            heard[client.key] = t, lease_s, True
        elif declared and t <= heard[client.key][0] + before_s:
            heard[client.key] = t, before_s, True
        else:
            heard[client.key] = t, LEASE_S, False
        holder = control.key
        allowed = command in ALWAYS_OBEYED or take or control.other(client) is None
        if allowed and (COMMANDS[command].moves or command in ALWAYS_OBEYED):
            control.gain(client, t)
            assert control.key == client.key
            assert control.attended == heard[client.key][2]
        else:
            assert control.key == holder
