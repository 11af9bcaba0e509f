"""Selects the plant that emulates a body on palms, by the law of friction that the palms' vibration requires.

resolved    vibrating palms, resolved in time, with dry friction (`rig.vibrating_plant`)
sign_pairs  the same averaged over the signs of slip (`rig.sign_pairs`): for bodies with flat sides
coulomb     palms that do not vibrate (`rig.dry_plant`), flat ones only
averaged    the old law, which averages the friction alone (`rig.plant`)
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Unpack

import numpy as np

from palmd.rig.curved_plant import CurvedPlant
from palmd.rig.dry_plant import DryPlant
from palmd.rig.plant import AS_ASSUMED, FrictionLaw, FrictionSurface, Hinge, PadPair, Plant, PlantSettings
from palmd.rig.shaker import Shaking, drawn_shaking
from palmd.rig.shapes import Body, Support
from palmd.rig.sign_pairs import CurvedSignPairsPlant, SignPairsPlant
from palmd.rig.vibrating_plant import VibratingPlant
from palmd.system.arcs import FLAT
from palmd.system.vibration import Vibration

_SEED_STREAM = 0x76696272  # the vibration's own random stream, so that object and motion of a seed do not depend on it


def law_of(vibration: Vibration) -> FrictionLaw:
    """The law of friction for palms with this vibration."""
    if vibration.law == "averaged":
        return "averaged"
    return "resolved" if vibration.vibrates else "coulomb"


def shaken(
    vibration: Vibration, surface: FrictionSurface, mass: float, *seed: int
) -> tuple[Shaking | None, FrictionSurface]:
    """Draw both palms' vibration by the seed as `vibration` describes it; also the surface, with dither speed πV/2.

    If the speed V is not described it follows from the surface's own dither speed. mass: of the body (kg).
    """
    if law_of(vibration) != "resolved":
        return None, surface
    shaking = drawn_shaking(
        vibration, np.random.default_rng([*seed, _SEED_STREAM]), speed=2.0 / math.pi * surface.dither, body_mass=mass
    )
    return shaking, replace(surface, dither=0.5 * math.pi * shaking.palms[0].speed)


def plant_on(
    body: Body,
    hinge: Hinge,
    surface: FrictionSurface,
    curvatures: PadPair = FLAT,
    *,
    shaking: Shaking | None = None,
    **others: Unpack[PlantSettings],
) -> Plant:
    """The plant for the law that the options state, or else for palms that vibrate by `shaking`, or for the old law.

    others: see `Plant`. Raises ValueError for palms too concave for the body, and for dry friction on arcs.
    """
    curved, options = any(curvatures), others.get("options", AS_ASSUMED)
    if options.physics == "mujoco":
        if curved:
            raise ValueError("MuJoCo emulates flat palms only")
        from palmd.rig.mujoco_plant import MujocoPlant  # an optional package

        return MujocoPlant(body, hinge, surface, shaking, **others)
    law = options.friction_law or ("averaged" if shaking is None else "resolved")
    if law == "coulomb" and curved and surface.mu:
        raise ValueError("friction without vibration is emulated on flat palms only")
    if law in ("resolved", "sign_pairs") and shaking is None:
        raise ValueError(f"the law of friction {law!r} needs palms that vibrate")
    if law == "coulomb" and not curved:
        return DryPlant(body, hinge, surface, **others)
    if shaking is None or law in ("averaged", "coulomb") or not surface.mu:
        if curved:
            return CurvedPlant(body, hinge, surface, curvatures, **others)
        return Plant(body, hinge, surface, **others)
    if law == "resolved" and isinstance(body.support, Support):
        return VibratingPlant(body, hinge, surface, shaking, curvatures, **others)
    if curved:
        return CurvedSignPairsPlant(body, hinge, surface, shaking, curvatures=curvatures, **others)
    return SignPairsPlant(body, hinge, surface, shaking, **others)
