"""Which plant emulates a body on palms: by the law of friction that the palms' vibration asks for.

resolved    palms that vibrate, in time, with dry friction (`rig.vibrating_plant`)
sign_pairs  the same averaged over the signs of slip (`rig.sign_pairs`): for bodies with flat sides, and without a
            C compiler
coulomb     palms that do not vibrate (`rig.dry_plant`), flat ones only
averaged    the old law, which averages the friction alone (`rig.plant`)
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from palmd.rig.curved_plant import CurvedPlant
from palmd.rig.dry_plant import DryPlant
from palmd.rig.imperfections import PERFECT, Imperfections
from palmd.rig.plant import AS_ASSUMED, PAD_LENGTH, FrictionLaw, FrictionSurface, Hinge, PadPair, Plant, PlantOptions
from palmd.rig.shaker import Shaking, drawn_shaking
from palmd.rig.shapes import Body
from palmd.rig.sign_pairs import CurvedSignPairsPlant, SignPairsPlant
from palmd.rig.vibrating_plant import VibratingPlant, resolves
from palmd.system.arcs import FLAT
from palmd.system.vibration import Vibration

_STREAM = 0x76696272  # of seeds: the same seed has the same object and motion, whatever vibrates


def law_of(vibration: Vibration) -> FrictionLaw:
    """What palms that vibrate so are emulated by."""
    if vibration.law == "averaged":
        return "averaged"
    return "resolved" if vibration.vibrates else "coulomb"


def shaken(
    vibration: Vibration, surface: FrictionSurface, mass: float, *seed: int
) -> tuple[Shaking | None, FrictionSurface]:
    """Both palms' vibration, drawn by the seed as `vibration` describes it, and the surface with its dither speed πV/2.

    Where the speed V is not described it is that of the surface's own dither speed. mass: of the body (kg).
    """
    if law_of(vibration) != "resolved":
        return None, surface
    shaking = drawn_shaking(
        vibration, np.random.default_rng([*seed, _STREAM]), speed=2.0 / math.pi * surface.dither, body_mass=mass
    )
    return shaking, replace(surface, dither=0.5 * math.pi * shaking.palms[0].speed)


def plant_on(
    body: Body,
    hinge: Hinge,
    surface: FrictionSurface,
    curvatures: PadPair = FLAT,
    *,
    options: PlantOptions = AS_ASSUMED,
    shaking: Shaking | None = None,
    imperfections: Imperfections = PERFECT,
    gravity: float = 9.81,
    reach: PadPair = (PAD_LENGTH, PAD_LENGTH),
) -> Plant:
    """The plant of the law that the options ask for, or else of palms that vibrate by `shaking`, or by the old law.

    Raises ValueError for palms too concave for the body, and for dry friction on arcs.
    """
    curved = any(curvatures)
    if options.physics == "mujoco":
        if curved:
            raise ValueError("MuJoCo emulates flat palms only")
        from palmd.rig.mujoco_plant import MujocoPlant  # an optional package

        return MujocoPlant(
            body, hinge, surface, shaking, options=options, imperfections=imperfections, gravity=gravity, reach=reach
        )
    law = options.friction_law or ("averaged" if shaking is None else "resolved")
    if law == "coulomb" and curved and surface.mu:
        raise ValueError("friction without vibration is emulated on flat palms only")
    if law in ("resolved", "sign_pairs") and shaking is None:
        raise ValueError(f"the law of friction {law!r} needs palms that vibrate")
    if law == "coulomb" and not curved:
        return DryPlant(
            body, hinge, surface, options=options, imperfections=imperfections, gravity=gravity, reach=reach
        )
    if shaking is None or law in ("averaged", "coulomb") or not surface.mu:
        if curved:
            return CurvedPlant(
                body, hinge, surface, curvatures,
                options=options, imperfections=imperfections, gravity=gravity, reach=reach,
            )  # fmt: skip
        return Plant(body, hinge, surface, options=options, imperfections=imperfections, gravity=gravity, reach=reach)
    if law == "resolved" and resolves(body):
        return VibratingPlant(
            body, hinge, surface, shaking, curvatures,
            options=options, imperfections=imperfections, gravity=gravity, reach=reach,
        )  # fmt: skip
    if curved:
        return CurvedSignPairsPlant(
            body, hinge, surface, curvatures, shaking,
            options=options, imperfections=imperfections, gravity=gravity, reach=reach,
        )  # fmt: skip
    return SignPairsPlant(
        body, hinge, surface, shaking, options=options, imperfections=imperfections, gravity=gravity, reach=reach
    )
