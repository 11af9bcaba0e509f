"""A recorded run of the daemon's real core, its smoother included, on the emulated rig without wires."""

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

SECONDS = 5.0  # it is valid after 3.1
SHAKER = VibrationConfig(relation="independent", frequency_hz=250, speed_m_s=0.012)
PLAN = PlanSpec.model_validate(
    {
        "name": "rock",
        "repeat": "forever",
        "segments": [{"sine": {"phi1_deg": 25, "phi2_deg": 10}, "frequency_hz": [0.41, 0.57], "duration_s": 20}],
    }
)
_KEPT = tempfile.TemporaryDirectory(prefix="palmd-test-lived-")


@cache
def configured():
    """A rig whose palms' vibration is known."""
    config = default_config()
    return config.model_copy(update={"rig": config.rig.model_copy(update={"vibration": SHAKER})})


@cache
def published():
    """(topic, fields) as they would go to the bus, and the rig's truth among them."""
    config = configured()
    lived = TwoPalmsLoop(config, PLAN, 0, smoothing=observer.Simulated(rig_description(config)))
    told, numbers = [], {}

    def publish(topic, fields, t):
        number = numbers[topic] = numbers.get(topic, -1) + 1
        told.append((topic, stamp(dict(fields), recorded.T0 + t, t, number)))

    def tick():
        # every tick must be kept, also those in which commands are waited for
        instant = live()
        publish("rig/truth", instant.truth, instant.t)
        for topic, fields in instant.messages.items():
            publish(topic, fields, instant.t)
        if numbers[ESTIMATE.name] % 100 == 0:
            publish("rig/object", lived.world.object_truth(), instant.t)
            publish(INFO.name, info_fields("0.1.0", "shape", configured()), instant.t)
            publish(LOOP.name, loop_fields(), instant.t)
        return instant

    live, lived.tick = lived.tick, tick
    lived.start()
    for _ in lived.run(SECONDS):
        pass
    return told


def loop_fields():
    """`palm/loop` as the loop makes it, with a counter or two of each family."""
    named = {field.name: 0.5 for field in LOOP.quantities if not field.name.endswith("*") and field.kind == "number"}
    families = {f"{field.name[:-1]}bytes": 7 for field in LOOP.quantities if field.name.endswith("*")}
    return named | families | {"backend": "c"}


def raw(topic, fields):
    """As the recorder stores it, a moment after it was sent."""
    t_ns = round(fields["timestamp"] * 1e9)
    return RawMessage(topic, t_ns + 1_000_000, t_ns, fields["seq"], msgpack.packb(fields))


@cache
def path():
    """The finished run."""
    folder = Path(_KEPT.name)
    file = RunFile(folder, preface(configured(), recorded.BEGIN.isoformat()), recorded.BEGIN)
    for topic, fields in published():
        file.write(raw(topic, fields))
    file.finish()
    pack(file.path, file.path)
    return file.path
