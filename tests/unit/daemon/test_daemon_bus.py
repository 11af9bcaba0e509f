"""The daemon's sockets, with real clients."""

import os
import time

import msgpack
import pytest
import zmq
from waiting import wait

from palmd.bus.command_client import CommandClient, own_name
from palmd.daemon import bus as daemon_bus
from palmd.daemon.bus import FRAMES_PER_TICK, MAX_FRAMES, PUBLISH_HIGH_WATER, Bus, BusError
from palmd.daemon.command_queue import MAX_WAITING, PER_TICK
from palmd.daemon.commands import Reply
from palmd.daemon.ownership import NOBODY_KEY
from palmd.messages import info_fields, state_fields
from palmd.quantities import INFO, STATE
from palmd.rig.world import default_config

TIMEOUT_MS = 20_000


class Rig:
    """A bus and its clients."""

    def __init__(self, folder):
        self.publish, self.command = f"ipc://{folder}/p", f"ipc://{folder}/c"
        self.bus = Bus(self.publish, self.command)
        self.context = zmq.Context()
        self.clients = []

    def client(self, kind, address):
        socket = self.context.socket(kind)
        socket.setsockopt(zmq.RCVTIMEO, TIMEOUT_MS)
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(address)
        self.clients.append(socket)
        return socket

    def received(self, count=1):
        """At least `count` requests, in order of arrival."""
        requests, t_end = [], time.monotonic() + TIMEOUT_MS / 1e3
        while len(requests) < count and time.monotonic() < t_end:
            requests += self.bus.receive()
        return requests

    def close(self):
        self.context.destroy(linger=0)
        self.bus.close()


@pytest.fixture
def rig(tmp_path):
    rig = Rig(tmp_path)
    yield rig
    rig.close()


def call(**message):
    return msgpack.packb(message)


@pytest.mark.parametrize("kind", [zmq.REQ, zmq.DEALER])
def test_a_client_gets_its_answers_in_one_frame(rig, kind):
    client = rig.client(kind, rig.command)
    for ident, error, result in ((1, None, {"result": {"state": "idle"}}), ("x", "arm refused: no", {})):
        client.send(call(id=ident, cmd="arm"))
        (request,) = rig.received()
        assert request.name == "arm"
        rig.bus.reply(Reply(request, error, result.get("result")))
        (frame,) = client.recv_multipart()
        refusal = {} if error is None else {"error": error}
        assert msgpack.unpackb(frame) == {"id": ident, "ok": error is None} | result | refusal


def test_a_client_is_named_by_what_it_sends_or_by_its_address(rig):
    client = rig.client(zmq.DEALER, rig.command)
    client.send(call(id=1, cmd="arm", **{"from": "my script"}))
    client.send(call(id=2, cmd="arm"))
    with CommandClient(rig.command, 1.0) as named:
        named.post("arm")
        whos = [request.who for request in rig.received(3)]
    assert {"my script", own_name()} < set(whos)
    assert sum(who.startswith("a program") for who in whos) == 1
    assert own_name().endswith(f"process {os.getpid()}")


@pytest.mark.parametrize(
    "frames", [[b""], [b"junk"], [b"", b"", b""], [call(cmd="arm"), b"more"], [b"", call(id=9, cmd="fly")]]
)
def test_a_malformed_request_is_answered_and_not_passed_on(rig, frames):
    client = rig.client(zmq.DEALER, rig.command)
    client.send_multipart(frames)
    deadline = time.monotonic() + TIMEOUT_MS / 1e3
    while rig.bus.counters.malformed == 0 and time.monotonic() < deadline:
        assert rig.bus.receive() == []
    *_, answer = client.recv_multipart()
    fields = msgpack.unpackb(answer)
    assert fields["ok"] is False
    assert fields["error"]


def test_a_flood_is_read_in_portions(rig):
    client = rig.client(zmq.DEALER, rig.command)
    for i in range(20):
        client.send(call(id=i, cmd="status"))
    client.send(b"end")  # a socket keeps the order: when this message has come, all have
    time.sleep(0.1)
    portions = [rig.bus.receive() for _ in range(6)]
    assert [len(portion) for portion in portions] == [PER_TICK] * 5 + [0]
    assert [request.id for portion in portions for request in portion] == list(range(20))


def crowded(rig, commands):
    """Sends each request from a client of its own; the requests served in the following ticks, by client number."""
    clients = [rig.client(zmq.DEALER, rig.command) for _ in commands]
    for number, (client, command) in enumerate(zip(clients, commands, strict=True)):
        before = rig.bus.counters.commands
        client.send(call(id=number, cmd=command))
        rig.bus._commands.poll(TIMEOUT_MS)
        rig.bus._enqueue_received(NOBODY_KEY)
        assert rig.bus.counters.commands == before + 1
    given = []
    while portion := rig.bus.receive():
        ordinary = [request for request in portion if request.name not in ("stop", "hold")]
        assert len(ordinary) <= PER_TICK
        given += [(request.id, request.name) for request in portion]
    return clients, given


def refusal(client):
    fields = msgpack.unpackb(client.recv_multipart()[-1])
    assert fields["ok"] is False
    return fields["error"]


def test_a_request_to_a_full_queue_is_refused(rig):
    clients, given = crowded(rig, ["arm"] * (MAX_WAITING + 2))
    assert given == [(number, "arm") for number in range(MAX_WAITING)]
    for client in clients[MAX_WAITING:]:
        assert refusal(client).startswith("arm refused: busy")
    assert rig.bus.counters.crowded == 2


def test_a_stop_overtakes_other_requests_and_moving_ones_are_then_refused(rig):
    clients, given = crowded(rig, [*("arm", "start") * (MAX_WAITING // 2), "stop", "start"])
    assert given[0] == (MAX_WAITING, "stop")
    assert not [name for _, name in given[1:] if name != "start"]
    for client, command in zip(clients[:MAX_WAITING], ("arm", "start") * (MAX_WAITING // 2), strict=True):
        assert refusal(client) == f"{command} refused: a stop has overtaken it"


@pytest.mark.parametrize(("waits", "comes"), [("hold", "stop"), ("stop", "hold")])
def test_a_queue_full_of_stops_accepts_a_hold_and_vice_versa(rig, waits, comes):
    clients, given = crowded(rig, [waits] * MAX_WAITING + [comes, waits])
    assert given == [*((number, waits) for number in range(MAX_WAITING)), (MAX_WAITING, comes)]
    assert refusal(clients[-1]) == f"{waits} refused: a {waits} is already waiting"


def test_a_client_that_sends_without_end_does_not_delay_others(rig):
    greedy, modest = rig.client(zmq.DEALER, rig.command), rig.client(zmq.DEALER, rig.command)
    for number in range(60):
        greedy.send(call(id=number, cmd="status"))
    modest.send(call(id="mine", cmd="hold"))
    time.sleep(0.2)
    portions = [rig.bus.receive() for _ in range(30)]
    assert "mine" in [request.id for portion in portions[:3] for request in portion]
    assert sum(map(len, portions)) == 61
    assert rig.bus.counters.crowded == 0


def test_a_message_of_very_many_frames_is_read_in_portions_and_answered_once(rig):
    client = rig.client(zmq.DEALER, rig.command)
    client.send_multipart([b""] * 2000)
    client.send(call(id=7, cmd="status"))
    portions, requests = 0, []
    read = rig.bus._commands.recv
    frames = 0

    def counted(*args, **how):
        nonlocal frames
        frame = read(*args, **how)
        frames += 1
        return frame

    rig.bus._commands.recv = counted
    t_end = time.monotonic() + TIMEOUT_MS / 1e3
    while not requests and time.monotonic() < t_end:
        before = frames
        requests += rig.bus.receive()
        assert frames - before < FRAMES_PER_TICK + MAX_FRAMES
        portions += frames > before
    assert [request.id for request in requests] == [7]
    assert portions >= 2000 // (FRAMES_PER_TICK + MAX_FRAMES)
    assert rig.bus.counters.malformed == 1
    assert msgpack.unpackb(client.recv_multipart()[-1])["ok"] is False


def test_a_reply_to_a_vanished_client_is_dropped(rig):
    client = rig.client(zmq.DEALER, rig.command)
    client.send(call(id=1, cmd="status"))
    (request,) = rig.received()
    client.close()
    rig.bus.reply(Reply(request, None, {}))


def until_subscribed(client, publish):
    """A subscription takes a moment to arrive; earlier messages wait in the client."""
    wait(lambda: publish() or client.poll(20), "the subscription to arrive", pause_s=0.0)


def test_messages_have_the_three_frames_that_plotjuggler_reads(rig):
    client = rig.client(zmq.SUB, rig.publish)
    client.subscribe(b"palm/")
    until_subscribed(client, lambda: rig.bus.publish(STATE, state_fields("idle", []), 12.5, 1.7e9))
    topic, payload, stamp = client.recv_multipart()
    assert topic == b"palm/state"
    assert float(stamp.decode("ascii")) == 1.7e9
    fields = msgpack.unpackb(payload)
    assert (fields["v"], fields["timestamp"], fields["mono_ns"]) == (1, 1.7e9, 12_500_000_000)


def test_each_topic_has_its_own_sequence_number(rig):
    client = rig.client(zmq.SUB, rig.publish)
    client.subscribe(b"")
    until_subscribed(client, lambda: rig.bus.publish(INFO, info_fields("0", "shape", default_config()), 0.0, 0.0))
    for _ in range(3):
        rig.bus.publish(STATE, state_fields("idle", []), 0.0, 0.0)
    seen = []
    while len(seen) < 3 and client.poll(TIMEOUT_MS):
        topic, payload, _ = client.recv_multipart()
        if topic == b"palm/state":
            seen.append(msgpack.unpackb(payload)["seq"])
    assert seen == [0, 1, 2]


def test_a_subscriber_that_does_not_read_blocks_nothing(rig):
    client = rig.client(zmq.SUB, rig.publish)
    client.subscribe(b"")
    fields = {"state": "x" * 10_000, "faults": [], "severities": [], "hints": []}
    begun = time.monotonic()
    for _ in range(2000):
        rig.bus.publish(STATE, dict(fields), 0.0, 0.0)
    assert time.monotonic() - begun < 2.0


def test_the_last_messages_are_sent_before_the_sockets_close(tmp_path, monkeypatch):
    monkeypatch.setattr(daemon_bus, "LINGER_MS", TIMEOUT_MS)
    rig = Rig(tmp_path)
    client = rig.client(zmq.SUB, rig.publish)
    client.setsockopt(zmq.RCVHWM, 0)
    client.subscribe(b"")
    until_subscribed(client, lambda: rig.bus.publish(INFO, info_fields("0", "shape", default_config()), 0.0, 0.0))
    count = PUBLISH_HIGH_WATER // 10
    for _ in range(count):
        rig.bus.publish(STATE, {"state": "x" * 20_000}, 0.0, 0.0)
    rig.bus.close()
    seen = 0
    while seen < count and client.poll(TIMEOUT_MS):
        seen += client.recv_multipart()[0] == b"palm/state"
    rig.close()
    assert seen == count


@pytest.mark.parametrize("key", ["publish", "command"])
def test_an_address_in_use_is_reported_with_its_key(key):
    context = zmq.Context()
    socket = context.socket(zmq.REP)
    taken = f"tcp://127.0.0.1:{socket.bind_to_random_port('tcp://127.0.0.1')}"
    addresses = {"publish": "tcp://127.0.0.1:*", "command": "tcp://127.0.0.1:*", key: taken}
    with pytest.raises(BusError, match=f"bus.{key}: {taken} is in use"):
        Bus(**addresses)
    context.destroy(linger=0)


def test_an_impossible_address_is_reported(tmp_path):
    with pytest.raises(BusError, match=r"bus\.publish: ipc:///no/such/folder/x cannot be bound"):
        Bus("ipc:///no/such/folder/x", f"ipc://{tmp_path}/c")


def messages(client, wait_ms=TIMEOUT_MS):
    """The numbers of all messages until none arrives."""
    seqs = []
    while client.poll(200 if seqs else wait_ms):
        seqs.append(msgpack.unpackb(client.recv_multipart()[1])["seq"])
    return seqs


def subscribed(rig):
    """A client that receives every message sent from now on, whatever is held back."""
    client = rig.client(zmq.SUB, rig.publish)
    client.subscribe(b"")
    until_subscribed(client, lambda: rig.bus._publisher.send_multipart((b"", b"", b"")))
    while client.poll(100):
        client.recv_multipart()
    return client


def tick(rig, t=None):
    rig.bus.publish(STATE, {"state": "idle"}, time.monotonic() if t is None else t, 0.0)


def test_a_recorder_that_connects_while_messages_are_held_back_misses_none(rig):
    """Meanwhile the loop publishes, reads and answers; no message is sent before the recorder has connected."""
    rig.bus.buffer_until("recorder", 60.0)
    for _ in range(2 * daemon_bus.BACKLOG_PER_PUBLISH):
        tick(rig)
    subscriber = subscribed(rig)
    recorder = rig.client(zmq.DEALER, rig.command)
    recorder.send(call(id=1, cmd="status"))
    assert [request.name for request in rig.received()] == ["status"]
    tick(rig)
    assert not subscriber.poll(300)
    recorder.send(call(id=2, cmd="recorder", args={"bytes": 0, "messages": 0, "lost": 0}))
    assert [request.name for request in rig.received()] == ["recorder"]
    soon = time.monotonic() + daemon_bus.SUBSCRIBE_GRACE_S
    for _ in range(3):
        tick(rig, soon)
    assert messages(subscriber) == list(range(2 * daemon_bus.BACKLOG_PER_PUBLISH + 4))


def test_held_back_messages_are_sent_a_few_at_a_time(rig):
    """Otherwise one tick would have to send the messages of half a second."""
    rig.bus.buffer_until("recorder", 60.0)
    for _ in range(5 * daemon_bus.BACKLOG_PER_PUBLISH):
        tick(rig)
    subscriber = subscribed(rig)
    tick(rig, time.monotonic() + 61.0)
    assert len(messages(subscriber)) == daemon_bus.BACKLOG_PER_PUBLISH
    assert rig.bus.counters.published == 5 * daemon_bus.BACKLOG_PER_PUBLISH + 1


def test_messages_are_held_back_for_a_limited_time_and_not_lost_at_the_end(rig):
    """The time counts from the opening of the addresses, including the daemon's start."""
    rig.bus._t_open -= 61.0
    subscriber = subscribed(rig)
    rig.bus.buffer_until("recorder", 60.0, since_open=True)
    tick(rig)
    assert messages(subscriber) == [0]
    rig.bus.buffer_until("recorder", 60.0)
    tick(rig)
    rig.bus.close()
    assert messages(subscriber) == [1]
