"""A fault that needs a broken observer, in a run without wires: the daemon itself has no place to put one in."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

from palmd import observer
from palmd.config import PlanSpec, rig_description
from palmd.events import Estimate
from palmd.harness.wireless import Wireless
from palmd.lab.fault_reaction import Reaction, ReactionWatch
from palmd.lab.fault_rows import FaultRow
from palmd.rig.world import default_config

BREAKS_AFTER_S = 3.0
WATCHED_S = 1.0


class ModelError(Exception):
    """What a broken model raises."""


class _Breakable:
    """An observer that does its work until it is broken."""

    def __init__(self, sound: Any) -> None:
        self._sound = sound
        self.how: Literal["raises", "nan"] | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sound, name)

    def estimate(self, t: float) -> Estimate:
        """As the sound one's, or an error, or NaN that is called valid."""
        estimate: Estimate = self._sound.estimate(t)
        if self.how == "raises":
            raise ModelError("the model is broken")
        return dataclasses.replace(estimate, valid=True, r1=math.nan) if self.how == "nan" else estimate


def provoke(row: FaultRow, how: Literal["raises", "nan"], spec: PlanSpec, seed: int) -> Reaction:
    """Run the plan, break the observer while the palms turn, and look on."""
    config = default_config()
    breakable = _Breakable(observer.make("shape", rig_description(config), seed))
    run = Wireless(config, spec, seed, estimator=breakable)
    run.start()
    for _ in run.run(BREAKS_AFTER_S):
        pass
    watch = ReactionWatch()
    t_cause = run.t
    breakable.how = how
    while run.t < t_cause + WATCHED_S:
        instant = run.tick()
        stamped = {"mono_ns": instant.t * 1e9}
        watch.take("rig/truth", instant.truth | stamped)
        if "palm/state" in instant.messages:
            watch.take("palm/state", dict(instant.messages["palm/state"]) | stamped)
    return watch.reaction(row, t_cause)
