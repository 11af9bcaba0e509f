"""PlotJuggler can read what palmd sends, and palmd's layout for it names only published series."""

import contextlib
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import plotjuggler
import pytest
import rig_recording
import zmq
from waiting import wait

from palmd.daemon.bus import Bus
from palmd.events import ObjectEstimate, Unexplained
from palmd.messages import note_fields, object_fields, unexplained_fields
from palmd.pivot_quantities import PIVOT_TOPICS
from palmd.quantities import CONFIG, NOTE, OBJECT, UNEXPLAINED
from palmd.three_palms_quantities import PALM3_TOPICS
from palmd.topics import TOPICS

LAYOUT = Path(__file__).parents[3] / "config/plotjuggler.xml"
STAMP = ("v", "timestamp", "mono_ns", "seq")


def sent():
    """(topic, fields without timestamp) of every topic that the daemon sends."""
    recognised = ObjectEstimate(1.0, ("cup", "lid"), np.array([0.2, 0.7]), 0.1, 1)
    topics = {topic.name: topic for topic in TOPICS}
    for name, fields in rig_recording.published():
        if name in topics:
            yield topics[name], {key: value for key, value in fields.items() if key not in STAMP}
    yield OBJECT, object_fields(recognised)
    yield NOTE, note_fields(1.0, "put back")
    yield CONFIG, {"config_hash": "0", "yaml": "{}"}
    yield UNEXPLAINED, unexplained_fields(1.02, Unexplained(1.0))


@pytest.fixture(scope="module")
def wire(tmp_path_factory):
    """The frames of all topics as the daemon's bus sends them to a subscriber."""
    folder = tmp_path_factory.mktemp("bus")
    publish, command = (f"ipc://{folder}/{name}" for name in ("publish", "command"))
    messages = list(sent())
    found = []
    with contextlib.closing(Bus(publish, command)) as bus, zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.linger, socket.rcvhwm = 0, 0
        socket.connect(publish)
        socket.subscribe(b"")
        wait(lambda: bus.publish(*messages[0], 0.0, time.time()) or socket.poll(20), "the subscription to arrive", 0.0)
        while socket.poll(100):
            socket.recv_multipart()
        for topic, fields in messages:
            bus.publish(topic, dict(fields), 0.0, time.time())
        while len(found) < len(messages) and socket.poll(10_000):
            found.append(socket.recv_multipart())
    return found


def test_every_topic_of_two_palms_is_sent(wire):
    others = (*PIVOT_TOPICS.published, *PALM3_TOPICS.published)
    assert {frames[0].decode() for frames in wire} == {topic.name for topic in TOPICS if topic not in others}


def test_plotjuggler_can_read_every_message(wire):
    assert [(frames[0], plotjuggler.problems(frames)) for frames in wire if plotjuggler.problems(frames)] == []


def test_the_layout_names_only_published_series():
    root = ElementTree.parse(LAYOUT).getroot()
    curves = [curve.get("name") for curve in root.iter("curve")]
    known = {name for topic, fields in sent() for name in plotjuggler.series(topic.name, fields)}
    assert len(curves) > 30
    assert set(curves) <= known, set(curves) - known
