"""An object explored in the emulated rig without wires, as its recording tells it: an event log, and the truth."""

from __future__ import annotations

from palmd.config import Drawn, ExploreGoal, rig_description
from palmd.harness.wireless import Wireless
from palmd.lab.exploring_plans import plan
from palmd.messages import events_of
from palmd.observer import Simulated
from palmd.quantities import EVENTS
from palmd.record.eventlog import EventLog
from palmd.rig.plant import FrictionSurface, PlantOptions
from palmd.rig.shapes import Body
from palmd.rig.simulate import Line
from palmd.rig.world import default_config


def explored(
    body: Body,
    seed: int,
    seconds: float,
    imperfections: Drawn,
    options: PlantOptions,
    surface: FrictionSurface | None = None,
) -> tuple[EventLog, Line]:
    """What the daemon was fed from the start of the exploration on, and the body as `rig/object` tells it.

    Against `surface`, by default a random one. The same arguments, the same bits. Raises WirelessError where the daemon
    does not get ready.
    """
    config = default_config(imperfections)
    rig = rig_description(config)
    spec = plan("explore", config, ExploreGoal(coverage=1.0, time_limit_s=seconds), seed)
    wireless = Wireless(config, spec, seed, options=options, smoothing=Simulated(rig), body=body, surface=surface)
    wireless.start()
    fed = [event for instant in wireless.run(seconds) for event in events_of(instant.messages[EVENTS.name])]
    return EventLog(rig, tuple(fed)), wireless.world.object_truth()
