"""A cylinder that the emulated palms turn by a plan, without wires, without a daemon, in virtual time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import PlanSpec
from palmd.devices.pad import make_pad
from palmd.events import Event, PalmSample
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import compile_plan
from palmd.rig.imperfections import PERFECT, Imperfections, PadImperfection
from palmd.rig.padkinds.versapad import VersaPadEmulator
from palmd.rig.pads import GOOD_PADS, PadOptions, Press
from palmd.rig.plant import PAD_LENGTH, Hinge, Plant, random_surface
from palmd.rig.shapes import cylinder

STEP_S = 2e-3  # the cylinder moves slowly
ARM_S = 0.016
ANGLE_NOISE_RAD = 1.5e-4
PADS = (1, 2)


def turned(
    plan: Mapping[str, Any],
    limits: MotionLimits,
    real: tuple[VersaPadConfig, VersaPadConfig],
    configured: tuple[VersaPadConfig, VersaPadConfig],
    radius_m: float,
    mass_kg: float,
    seed: int,
    *,
    bend_m: tuple[float, float] = (0.0, 0.0),
    pad_options: PadOptions = GOOD_PADS,
    late_s: float = 0.0,
    phi2_error_rad: float = 0.0,
    imperfections: Imperfections = PERFECT,
) -> list[Event]:
    """Events for the observer of a daemon whose pads are described by `configured`; cached by arguments.

    Each pad reads `bend_m` more in its middle than at its ends, and the rig has these `imperfections`. The pads' times
    are `late_s` late, and the arm's phi2 is `phi2_error_rad` too large. Raises PlanError for a plan that exceeds the
    limits.
    """
    rng = np.random.default_rng(seed)
    trajectory = compile_plan(PlanSpec.model_validate(plan), limits)
    plant = Plant(cylinder(radius_m, mass_kg), Hinge(), random_surface("rig", rng), imperfections=imperfections)
    plant.place(imperfections.true_palms(trajectory.at(0.0)), 0.0)
    pads = [
        VersaPadEmulator(config, pad_options, partial(_bent, bend, off), rng, 0.0)
        for bend, off, config in zip(bend_m, imperfections.pads, real, strict=True)
    ]
    hosts = [make_pad(number, config) for number, config in zip(PADS, configured, strict=True)]
    events: list[Event] = []
    t_arm = 0.0
    for k in range(1, int(trajectory.duration / STEP_S)):
        t = k * STEP_S
        palms = trajectory.at(t)
        plant.advance(
            imperfections.true_palms(trajectory.at(t - 0.5 * STEP_S)), imperfections.true_palms(palms), STEP_S
        )
        if t >= t_arm:
            t_arm += ARM_S
            noise1, noise2 = rng.normal(0.0, ANGLE_NOISE_RAD, 2).tolist()
            phi1, phi2 = palms.angles
            events.append(
                PalmSample(t, (phi1 + noise1, phi2 + phi2_error_rad + noise2), palms.rates, palms.accelerations)
            )
        if not any(t >= pad.due for pad in pads):
            continue
        for pad, host, contact in zip(pads, hosts, plant.contacts(), strict=True):
            if t >= pad.due:
                presses = [Press(contact.s, contact.force)] if contact.touching else []
                events += host.feed(pad.report(t, presses), t + late_s)
    return events


def _bent(bend: float, off: PadImperfection, s: float, force: float) -> float:
    return bend * math.sin(math.pi * s / PAD_LENGTH) + off.reading_error_m(s, force)
