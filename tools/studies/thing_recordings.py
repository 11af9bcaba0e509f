"""Recordings of an object in the emulated rig without wires: an event log, the truth, and what was shown of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palmd.config.plans import ExploreSpec
from palmd.config.two_palms import Drawn, PlanSpec, rig_description
from palmd.events import Event
from palmd.harness.wireless import Wireless
from palmd.messages import events_of
from palmd.motion.rollout_predictor import BINS
from palmd.observer import Simulated
from palmd.quantities import EVENTS
from palmd.record.eventlog import EventLog
from palmd.rig.plant import FrictionSurface, PlantOptions
from palmd.rig.shapes import Body
from palmd.rig.simulate import Line
from palmd.rig.world import default_config
from tools.studies.exploring_watch import ExplorationWatch
from tools.studies.silent_observer import SilentObserver


class ThingRecording(NamedTuple):
    """What the daemon was fed, the body as `rig/object` tells it, and the share of its normals that were touched."""

    log: EventLog
    truth: Line
    shown: float


def recorded(
    body: Body,
    plan: PlanSpec,
    seed: int,
    seconds: float,
    imperfections: Drawn,
    options: PlantOptions,
    surface: FrictionSurface | None = None,
) -> ThingRecording:
    """So many seconds of the plan. One that explores does so by what the observer and its smoother find.

    Against `surface`, by default a random one. The same arguments, the same bits. Raises PlanError for a plan that
    leaves the default limits, WirelessError where the daemon does not get ready.
    """
    config = default_config(imperfections)
    rig = rig_description(config)
    explores = any(isinstance(segment, ExploreSpec) for segment in plan.segments)
    found_by = {"smoothing": Simulated(rig)} if explores else {"estimator": SilentObserver()}
    wireless = Wireless(config, plan, seed, options=options, body=body, surface=surface, **found_by)
    wireless.start()
    pads = tuple(pad.length for pad in rig.pads)
    fed = list[Event]()
    watch = ExplorationWatch(np.ones(BINS, dtype=np.bool_), pads, wireless.t)
    for instant in wireless.run(seconds):
        watch.take(instant)
        fed += events_of(instant.messages[EVENTS.name])
    return ThingRecording(EventLog(rig, tuple(fed)), wireless.world.object_truth(), watch.coverage)
