"""The command socket accepts arbitrary bytes."""

import time

import msgpack
import pytest
import zmq
from hypothesis import given, settings
from hypothesis import strategies as st

from palmd.daemon.bus import Bus
from palmd.daemon.commands import COMMANDS, CommandError, Request, parse

values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=20)
    | st.binary(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)
nearly_commands = st.fixed_dictionaries(
    {},
    optional={
        "id": values,
        "cmd": st.sampled_from([*COMMANDS, "fly"]) | values,
        "args": st.dictionaries(st.sampled_from(["path", "phi1_deg", "phi2_deg", "x"]), values) | values,
    },
)
packable = (values | nearly_commands).map(msgpack.packb)
payloads = st.binary(max_size=64) | packable | packable.map(lambda data: data[:-1])


def parsed(payload: bytes) -> Request | CommandError:
    try:
        return parse(payload)
    except CommandError as error:
        return error


@given(payloads)
def test_parse_returns_a_valid_request_or_raises_its_declared_error(payload):
    outcome = parsed(payload)
    if isinstance(outcome, CommandError):
        assert str(outcome)
        msgpack.packb(outcome.id)
    else:
        assert outcome.name in COMMANDS
        allowed = {argument.name for argument in COMMANDS[outcome.name].arguments}
        assert set(outcome.args) <= allowed


@pytest.fixture(scope="module")
def bus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bus")
    bus = Bus(f"ipc://{folder}/p", f"ipc://{folder}/c")
    context = zmq.Context()
    client = context.socket(zmq.DEALER)
    client.connect(f"ipc://{folder}/c")
    yield bus, client
    context.destroy(linger=0)
    bus.close()


@settings(max_examples=200, deadline=None)
@given(frames=st.lists(payloads, min_size=1, max_size=4))
def test_every_message_becomes_a_request_or_is_answered_with_an_error(bus, frames):
    bus, client = bus
    client.send_multipart(frames)
    before, t_end = bus.counters.commands, time.monotonic() + 5.0
    requests = []
    while bus.counters.commands == before:
        requests += bus.receive()
        assert time.monotonic() < t_end
    if requests:
        assert not client.poll(0)
        return
    assert client.poll(2000), "no answer"
    *_, answer = client.recv_multipart()
    fields = msgpack.unpackb(answer)
    assert fields["ok"] is False
    assert fields["error"]
    assert set(fields) == {"id", "ok", "error"}
