"""Messages without their third frame, for readers that cannot handle it: sent, and read by palmd's own programs."""

import contextlib
import time

import msgpack
import pytest
import zmq
from waiting import wait

from palmd.bus.subscriber import Subscriber
from palmd.config.two_palms import Config
from palmd.daemon.bus import Bus
from palmd.quantities import STATE


def test_messages_have_three_frames_unless_the_configuration_says_two():
    base = {"pads": {"palm1": {"port": "a"}, "palm2": {"port": "b"}}, "arm": {"port": "c"}}
    assert Config.model_validate(base).bus.frames == 3
    assert Config.model_validate(base | {"bus": {"frames": 2}}).bus.frames == 2
    with pytest.raises(ValueError, match="frames"):
        Config.model_validate(base | {"bus": {"frames": 4}})


@pytest.mark.parametrize("count", [2, 3])
def test_the_configured_number_of_frames_is_sent_and_palmds_subscriber_reads_both(tmp_path, count):
    publish, command = (f"ipc://{tmp_path}/{name}" for name in ("publish", "command"))
    with (
        contextlib.closing(Bus(publish, command, frames=count)) as bus,
        zmq.Context() as context,
        context.socket(zmq.SUB) as plain,
        Subscriber(publish, topics=(STATE.name,)) as own,
    ):
        plain.linger = 0
        plain.connect(publish)
        plain.subscribe(b"")
        fields = {"state": "ready"}
        wait(lambda: bus.publish(STATE, dict(fields), 0.0, time.time()) or plain.poll(20), "the subscription", 0.0)
        frames = plain.recv_multipart()
        assert len(frames) == count
        received = msgpack.unpackb(frames[1])
        assert received["timestamp"] == pytest.approx(time.time(), abs=60.0), "in the map in any case"
        messages = []

        def heard():
            bus.publish(STATE, dict(fields), 0.0, time.time())
            messages.extend(own.until(time.monotonic() + 0.05))
            return messages

        wait(heard, "palmd's own subscriber", 0.0)
        assert messages[0].fields["state"] == "ready"
