"""A recorded run of the daemon's real core, including its smoother, on the emulated rig without wires."""

import tempfile
from functools import cache
from pathlib import Path

import msgpack
import recorded

from palmd import observer
from palmd.config.two_palms import PlanSpec, rig_description
from palmd.config.vibration import VibrationConfig
from palmd.messages import info_fields, stamp
from palmd.quantities import ESTIMATE, INFO, LOOP
from palmd.record.mcapfile import RawMessage
from palmd.record.metadata import preface
from palmd.record.runfile import RunFile, pack
from palmd.rig.world import default_config
from tools.closed_loop import TwoPalmsLoop

SECONDS = 5.0  # the estimate is valid after 3.1 s
SHAKER = VibrationConfig(relation="independent", frequency_hz=250, speed_m_s=0.012)
PLAN = PlanSpec.model_validate(
    {
        "name": "rock",
        "repeat": "forever",
        "segments": [{"sine": {"phi1_deg": 25, "phi2_deg": 10}, "frequency_hz": [0.41, 0.57], "duration_s": 20}],
    }
)
_KEPT = tempfile.TemporaryDirectory(prefix="palmd-test-recording-")


@cache
def configured():
    """A rig whose vibration is known."""
    config = default_config()
    return config.model_copy(update={"rig": config.rig.model_copy(update={"vibration": SHAKER})})


@cache
def published():
    """(topic, fields) as published on the bus, and the rig's truth."""
    config = configured()
    stand = TwoPalmsLoop(config, PLAN, 0, smoothing=observer.Simulated(rig_description(config)))
    sent, numbers = [], {}

    def publish(topic, fields, t):
        number = numbers[topic] = numbers.get(topic, -1) + 1
        sent.append((topic, stamp(dict(fields), recorded.T0 + t, t, number)))

    def tick():
        # keeps every tick, also those that wait for commands
        instant = live()
        publish("rig/truth", instant.truth, instant.t)
        for topic, fields in instant.messages.items():
            publish(topic, fields, instant.t)
        if numbers[ESTIMATE.name] % 100 == 0:
            publish("rig/object", stand.world.object_truth(), instant.t)
            publish(INFO.name, info_fields("0.1.0", "shape", configured()), instant.t)
            publish(LOOP.name, loop_fields(), instant.t)
        return instant

    live, stand.tick = stand.tick, tick
    stand.start()
    for _ in stand.run(SECONDS):
        pass
    return sent


def loop_fields():
    """`palm/loop` as the loop publishes it, with one or two counters of each family."""
    named = {field.name: 0.5 for field in LOOP.quantities if not field.name.endswith("*") and field.kind == "number"}
    families = {f"{field.name[:-1]}bytes": 7 for field in LOOP.quantities if field.name.endswith("*")}
    return named | families | {"backend": "c"}


def raw(topic, fields):
    """A message as the recorder stores it, shortly after it was sent."""
    t_ns = round(fields["timestamp"] * 1e9)
    return RawMessage(topic, t_ns + 1_000_000, t_ns, fields["seq"], msgpack.packb(fields))


@cache
def path():
    """The finished recording."""
    folder = Path(_KEPT.name)
    file = RunFile(folder, preface(configured(), recorded.BEGIN.isoformat()), recorded.BEGIN)
    for topic, fields in published():
        file.write(raw(topic, fields))
    file.finish()
    pack(file.path, file.path)
    return file.path
