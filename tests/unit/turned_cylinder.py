"""What a daemon hears while the emulated plant's palms turn a cylinder by a plan: without wires, faster than time."""

import math

import numpy as np

from palmd.config import LimitsConfig, PadConfig, PlanSpec
from palmd.devices.versapad import PadCalibration, PadReceiver
from palmd.events import PalmSample
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import compile_plan
from palmd.rig.pads import GOOD_PADS, PadEmulator, Press
from palmd.rig.plant import AS_ASSUMED, Hinge, Plant, random_surface
from palmd.rig.shapes import cylinder

LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
CONFIGURED = tuple(PadConfig(port=f"pad{number}") for number in (1, 2))
TRUE = (
    CONFIGURED[0].model_copy(update={"zero_mm": 26.5, "counts_per_mm": 8.11, "newtons_per_count": 0.024}),
    CONFIGURED[1].model_copy(update={"zero_mm": 29.2, "counts_per_mm": 7.65, "newtons_per_count": 0.017, "sign": -1}),
)
"""Errors of 1.5 mm, 3 % and 20 %, and one pad mirrored."""

ARM_S = 0.016
ANGLE_NOISE_RAD = 1.5e-4


def turned(
    plan, radius_m, mass_kg, seed,
    *, true=TRUE, configured=CONFIGURED, options=AS_ASSUMED, pad_options=GOOD_PADS, surface=None,
    limits=LIMITS, step_s=1e-3, late_s=0.0, yaw=0.0,
):  # fmt: skip
    """The events in order; the pads' times are `late_s` too late, and the arm reports phi2 too large by `yaw`."""
    rng = np.random.default_rng(seed)
    trajectory = compile_plan(PlanSpec.model_validate(plan), limits)
    surface = surface or random_surface("rig", rng)
    plant = Plant(cylinder(radius_m, mass_kg), Hinge(), surface, options=options)
    plant.place(trajectory.at(0.0), 0.0)
    pads = [PadEmulator(each, pad_options, lambda s, n=n: options.pad_error_m(n, s), rng, 0.0)
            for n, each in enumerate(true, 1)]  # fmt: skip
    receivers = [receiver(number, config) for number, config in enumerate(configured, 1)]
    events, t_arm = [], 0.0
    for k in range(int(trajectory.duration / step_s)):
        t = (k + 1) * step_s
        palms = trajectory.at(t)
        plant.advance(trajectory.at(t - 0.5 * step_s), palms, step_s)
        assert not plant.fallen
        if t >= t_arm:
            t_arm += ARM_S
            phi1, phi2 = np.array((palms.phi1, palms.phi2)) + rng.normal(0.0, ANGLE_NOISE_RAD, 2)
            events.append(PalmSample(t, phi1, phi2 + yaw, palms.omega1, palms.omega2, palms.alpha1, palms.alpha2))
        for pad, host, contact in zip(pads, receivers, plant.contacts(), strict=True):
            if t >= pad.due:
                presses = [Press(contact.s, contact.force)] if contact.touching else []
                events += host.feed(pad.report(t, presses), t + late_s)
    return events


def receiver(number, config):
    """The daemon's end of a pad."""
    calibration = PadCalibration(
        number, config.zero_mm, config.counts_per_mm, config.newtons_per_count, sign=config.sign,
        length_mm=config.length_mm,
    )  # fmt: skip
    return PadReceiver(calibration, config.baud)


def errors(found, true=TRUE):
    """Of a pair of PadScale: zero (mm) and counts_per_mm (relative), pad after pad."""
    return [
        (each.zero_mm - pad.zero_mm, each.counts_per_mm / pad.counts_per_mm - 1.0)
        for each, pad in zip(found, true, strict=True)
    ]


def gain_errors(found, true=TRUE):
    """Of both pads' newtons_per_count, relative."""
    pads = zip((found.pad1, found.pad2), true, strict=True)
    return [each.newtons_per_count / pad.newtons_per_count - 1.0 for each, pad in pads]


def share(phi1_deg, phi2_deg):
    """N1 and N2 for a weight of 1, from balancing moments about the other contact's line of action."""
    phi1, phi12 = math.radians(phi1_deg), math.radians(phi1_deg + phi2_deg)
    normals = np.array([[-math.sin(phi1), math.sin(phi12)], [math.cos(phi1), -math.cos(phi12)]])
    return np.linalg.solve(normals, [0.0, 1.0])
