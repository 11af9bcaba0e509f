"""Whether an object stays held between two palms while they move, against the rig's truth, tick by tick. Pure.

Wedged is an object whose contacts see each other within both friction cones: palms can press it as hard as they like,
and it does not slide out. On a circle that is where the tangents are less than atan μ1 + atan μ2 apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from palmd.harness.wireless import Instant
from palmd.motion.rollout_predictor import MOST_FORCE
from palmd.quantities import ESTIMATE
from palmd.rig.world import World
from palmd.system.arcs import palm_points, tangents
from palmd.system.mechanism import JOINT_RATES, JOINTS, PALMS, SIDES, directions

NOTICED_S = 1.0
"""How soon after it has begun a mishap must have been noticed."""

_STANDING = 1e-3  # rad/s


def wedged(truth: dict[str, Any], frictions: Sequence[float], curvatures: Sequence[float]) -> bool:
    """Whether the object of a `rig/truth` is wedged between palms of these friction coefficients and curvatures."""
    joints, places = [truth[f"{joint}_rad"] for joint in JOINTS], [truth[f"s{palm}_m"] for palm in PALMS]
    one, two = palm_points(joints, places, curvatures)
    across = math.atan2(*(two - one)[::-1])  # from contact 1 to contact 2
    normals = (
        angle + side * math.pi / 2
        for side, angle in zip(SIDES, directions(tangents(joints, places, curvatures)), strict=True)
    )
    faced = zip((across, across + math.pi), normals, frictions, strict=True)
    return all(abs(math.remainder(way - normal, math.tau)) < math.atan(mu) for way, normal, mu in faced)


@dataclass(slots=True)
class HeldWatch:
    """Takes the ticks one by one; `mass` (kg), both palms' `frictions`, their `curvatures` (1/m).

    A mishap is that the object is wedged, pressed with more than `MOST_FORCE`, or does not touch both palms. It is
    noticed where `NOTICED_S` after its beginning at most the palms stand, or no estimate is valid. wedged, pressed:
    ticks; most_force: of a contact (m/s²); unnoticed: mishaps that were not.
    """

    mass: float
    frictions: Sequence[float]
    curvatures: Sequence[float]
    wedged: int = 0
    pressed: int = 0
    most_force: float = 0.0
    unnoticed: int = 0
    _since: float | None = None  # when the mishap in hand began, and whether it has been noticed or was not
    _judged: bool = False

    @classmethod
    def of(cls, world: World) -> HeldWatch:
        """Of the body that lies on the palms of that rig."""
        body, off = world.object_truth(), world.imperfections.friction
        frictions = tuple(body["mu"] * (1.0 + side * off) for side in SIDES)
        return cls(body["mass_kg"], frictions, world.config.rig.curvatures_per_m)

    def take(self, instant: Instant) -> None:
        """One tick."""
        t, truth = instant.t, instant.truth
        both = all(truth[f"contact{palm}"] for palm in PALMS)
        force = max(truth[f"f{palm}_n"] for palm in PALMS) / self.mass
        caught = both and wedged(truth, self.frictions, self.curvatures)
        self.most_force = max(self.most_force, force)
        self.wedged += caught
        self.pressed += force > MOST_FORCE
        amiss = caught or not both or force > MOST_FORCE
        if amiss and self._since is None:
            self._since, self._judged = t, False
        elif not amiss and self._judged:
            self._since = None
        if self._since is None or self._judged:
            return
        stands = all(abs(truth[f"{rate}_rad_s"]) < _STANDING for rate in JOINT_RATES)
        noticed = stands or not instant.messages[ESTIMATE.name]["valid"]
        self._judged = noticed or t - self._since > NOTICED_S
        self.unnoticed += self._judged and not noticed
