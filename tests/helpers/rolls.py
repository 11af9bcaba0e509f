"""A ball or cylinder that rolls down a palm, integrated in small steps, as a pad reports it."""

import math

import numpy as np

from palmd.events import PadLift, PadSample, PalmSample

LENGTH_M, RADIUS_M, MASS_KG = 0.0555, 0.010, 0.033
COUNTS_PER_M, NOISE_M = 7874.0, 1e-4
READING_SD = math.hypot(NOISE_M, 1.0 / COUNTS_PER_M / math.sqrt(12.0))
STEP_S = 5e-4


def path(alpha, g, resistance, inertia, push, seconds):
    """Distance (m) down a slope alpha at each step: gravity, friction, and the torque of rolling resistance."""
    way, speed, out = 0.0, push, []
    for _ in range(int(seconds / STEP_S)):
        out.append(way)
        normal = MASS_KG * g * math.cos(alpha)
        torque = math.copysign(resistance, speed) * normal * RADIUS_M
        spin = inertia * MASS_KG * RADIUS_M**2
        # m·a = m·g·sin − F,  J·a/R = F·R − torque
        acceleration = (MASS_KG * g * math.sin(alpha) - torque / RADIUS_M) / (MASS_KG + spin / RADIUS_M**2)
        way += speed * STEP_S + 0.5 * acceleration * STEP_S**2
        speed += acceleration * STEP_S
    return np.array(out)


def rolled(rng, pad, phi1_deg, phi2_deg, g, yaw_error, t0=0.0, resistance=0.003, inertia=0.4):
    """One roll as a pad reports it, with the rest before and after on both palms; and its end time (s)."""
    phi = math.radians(phi1_deg) if pad == 1 else math.pi - math.radians(phi1_deg + phi2_deg)
    alpha = phi + yaw_error if pad == 1 else phi - yaw_error
    ways = path(alpha, g, resistance, inertia, rng.uniform(-0.02, 0.02), 0.6)
    held, start = rng.uniform(0.15, 0.35), LENGTH_M - 3e-3
    wedge = RADIUS_M / math.tan(math.radians(phi2_deg) / 2)
    events, t = [], t0
    while t < t0 + held + 0.6:
        t += max(0.00625, rng.choice((1, 2, 3), p=(0.64, 0.2, 0.16)) * 0.00625 + rng.normal(0.0, 0.002))
        since = t - t0 - held
        s = start if since <= 0.0 else start - np.interp(since, np.arange(len(ways)) * STEP_S, ways)
        if s > LENGTH_M:
            break
        seen = np.round((max(s, wedge) + rng.normal(0.0, NOISE_M)) * COUNTS_PER_M) / COUNTS_PER_M
        events.append(PadSample(t, pad, float(seen), 0.3))
        if s <= wedge:
            events.append(PadSample(t + 1e-3, 3 - pad, wedge, 0.1))
    return [*events, PadLift(t + 0.03, pad), PadLift(t + 0.03, 3 - pad)], t + 0.5


def standing(phi1_deg, phi2_deg):
    return PalmSample(0.0, (math.radians(phi1_deg), math.radians(phi2_deg)))
