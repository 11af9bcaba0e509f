"""Event logs with ground truth from the emulated plant, without wires: `simulate_log` and a small command.

The logs have the format, noise and sampling of the project's event logs. Each palm rocks on one sine, faded in over the
first second. There are four kinds of run:

    nominal   no friction, light damping, released away from rest, samples every 10 ms
    friction  friction with dither, started at rest, irregular samples in three bands
    rig       as friction, and the hinge travels on an arc
    odd       ellipses, strongly curved bodies, bodies with an off-centre mass

Optionally the palms rest in between, and the object is removed and put back, turned.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from palmd.config.two_palms import DrawnImperfections
from palmd.events import FloatArray, PalmMotion
from palmd.rig.friction import law_of, plant_on, shaken
from palmd.rig.imperfections import Imperfections, PadImperfection, drawn
from palmd.rig.plant import (
    AS_ASSUMED,
    PAD_LENGTH,
    FrictionSurface,
    Hinge,
    PadPair,
    Plant,
    PlantOptions,
    random_surface,
    stable_poses,
)
from palmd.rig.shaker import Shaking
from palmd.rig.shapes import KINDS, Body, Kind, random_body
from palmd.rig.vibrating_plant import ContactBounds, Drive, VibratingPlant
from palmd.system.arcs import FLAT
from palmd.system.description import AS_CALIBRATED, CALIBRATION_KEYS, RigDescription
from palmd.system.mechanism import JOINTS, PALMS
from palmd.system.vibration import AVERAGED, INDEPENDENT, Relation, Vibration, vibration_line

Line = dict[str, Any]

VIBRATIONS: Mapping[str, Vibration] = {relation: Vibration(relation) for relation in get_args(Relation)} | {
    "averaged": AVERAGED
}
"""Vibration of the palms by the names in commands: the relation between them, or the law of old logs."""

STEP_S = 5e-4
_STEPS_PER_TRUTH = 20  # truth each 10 ms
_ARM_PERIOD_S = 0.016
_PAD_PERIOD_S = 0.010
_PACKET_S = 0.00625  # one packet at 9600 baud: the three reporting bands are one, two and three of these
_BAND_WEIGHTS = (0.55, 0.30, 0.15)
_BAND_JITTER_S = 0.002
_PAD_NOISE_M, _PAD_RESOLUTION_M = 1e-4, 1.27e-4
_FORCE_SCALE_STD, _FORCE_RESOLUTION_N = 0.05, 0.02
_PALM_NOISE_RAD = 2e-4
_ANGLE_COLUMNS = tuple(f"{joint}_rad" for joint in JOINTS)
_COLUMNS = ("t", "psi_rad", "omega0_rad_s", "r1_m", "r2_m", "s1_m", "s2_m", *_ANGLE_COLUMNS, "f1_n", "f2_n")
_PAD_MARGIN_M = 3e-3
_MIN_TURN_RAD = 0.3
_MIN_FORCE = 0.1  # m/s²: below it the contact is as good as lost
_SMOOTHING_S = 0.02  # over which readings of force are means: five periods of 250 Hz


Span = tuple[float, float]

PERFECTLY_KNOWN: Mapping[str, float] = dict.fromkeys(AS_CALIBRATED, 0.0)
CALIBRATION: Mapping[DrawnImperfections, Mapping[str, float]] = {"none": PERFECTLY_KNOWN, "calibrated": AS_CALIBRATED}
"""Standard deviations from which the rig's imperfections are drawn, by the names in commands."""


@dataclass(frozen=True, slots=True)
class Rock:
    """One palm's angle: mean + w(t)·amplitude·sin(2πft + phase), where w fades in over the first second.

    In each of `rests` (from, to, in s) w fades out over the first second, stays 0, and fades in over the second after.
    """

    mean: float
    amplitude: float
    frequency: float
    phase: float
    rests: tuple[Span, ...] = ()

    def at(self, t: float) -> tuple[float, float, float]:
        """Angle, rate and acceleration (rad, rad/s, rad/s²) at t ≥ 0 (s); at rest before."""
        w, dw, ddw = smooth_step(t)
        for start, end in self.rests:
            if not start < t < end + 1.0:
                continue  # v = 1, and it does not change
            out, back = smooth_step(t - start), smooth_step(t - end)
            v, dv, ddv = (b - a for a, b in zip(out, back, strict=True))
            v += 1.0
            w, dw, ddw = w * v, dw * v + w * dv, ddw * v + 2.0 * dw * dv + w * ddv
        k = math.tau * self.frequency
        s, c = math.sin(k * t + self.phase), math.cos(k * t + self.phase)
        a = self.amplitude
        return (
            self.mean + a * w * s,
            a * (dw * s + w * k * c),
            a * (ddw * s + 2.0 * dw * k * c - w * k * k * s),
        )


def smooth_step(t: float) -> tuple[float, float, float]:
    """The smooth step from 0 at t = 0 to 1 at t = 1 s, its rate and its acceleration."""
    if t >= 1.0:
        return 1.0, 0.0, 0.0
    u = max(t, 0.0)
    left = 1.0 - u
    return (
        u * u * u * (10.0 - 15.0 * u + 6.0 * u * u),
        30.0 * u * u * (left * left),
        60.0 * u * left * (1.0 - 2.0 * u),
    )


@dataclass(frozen=True, slots=True)
class Rocking:
    """Both palms' motion."""

    palm1: Rock
    palm2: Rock

    def at(self, t: float) -> PalmMotion:
        """Angles, rates, accelerations of both palms at t (s)."""
        phi1, omega1, alpha1 = self.palm1.at(t)
        phi2, omega2, alpha2 = self.palm2.at(t)
        return PalmMotion((phi1, phi2), (omega1, omega2), (alpha1, alpha2))


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """All parameters of one run, drawn at random from a seed.

    vibration: as the log describes it; shaking: the actual one, if the plant resolves it.
    """

    kind: Kind
    body: Body
    hinge: Hinge
    surface: FrictionSurface
    rocking: Rocking
    imperfections: Imperfections
    curvatures: PadPair = FLAT
    vibration: Vibration = AVERAGED
    shaking: Shaking | None = None

    def plant(self, options: PlantOptions) -> Plant:
        """The emulated body on its palms, not placed yet; raises ValueError for palms too concave for it."""
        law = options.friction_law or law_of(self.vibration)
        return plant_on(
            self.body, self.hinge, self.surface, self.curvatures,
            options=replace(options, friction_law=law), shaking=self.shaking, imperfections=self.imperfections,
        )  # fmt: skip

    def palms_at(self, t: float) -> PalmMotion:
        """The palms' true motion at t (s), including the rig's imperfections."""
        return self.imperfections.true_palms(self.rocking.at(t))

    def drive(self, lag_s: float) -> Drive:
        """`palms_at(t - lag_s)` in the form that the compiled plant takes."""
        angle_errors = self.imperfections.true_palms(PalmMotion.at_rest((0.0,) * len(JOINTS))).angles
        return Drive([astuple(rock) for rock in (self.rocking.palm1, self.rocking.palm2)], angle_errors, lag_s)


def simulate_log(
    kind: Kind,
    seed: int,
    duration_s: float = 10.0,
    options: PlantOptions = AS_ASSUMED,
    body: Body | None = None,
    *,
    surface: FrictionSurface | None = None,
    rests: tuple[Span, ...] = (),
    absences: tuple[Span, ...] = (),
    imperfections: Imperfections | None = None,
    calibration_sd: Mapping[str, float] = PERFECTLY_KNOWN,
    vibration: Vibration = INDEPENDENT,
) -> tuple[list[Line], Line]:
    """A run of the kind as event-log lines (header first), and its truth; a function of the seed.

    The rig's errors are `imperfections`, or else drawn by the seed from the standard deviations `calibration_sd` (named
    as in `AS_CALIBRATED`), which the header states in either case; by default there are none. The palms vibrate as
    `vibration` describes and the header states, resolved in time; `AVERAGED` is the law of old logs.

    Scenes in which a contact would be lost, or come near a pad's end, are drawn again. `body` is the object, `surface`
    its friction, random ones of the kind by default. In each of `rests` the palms are at rest. In each of `absences`
    the object is removed, and is then put back in a stable pose, turned by at least `_MIN_TURN_RAD` if there is one.
    """
    rng = np.random.default_rng([KINDS.index(kind), seed])
    description = RigDescription().known_to(calibration_sd)
    errors = drawn(description, KINDS.index(kind), seed) if imperfections is None else imperfections
    while True:
        scene = with_vibration(_draw(kind, rng, body, surface, rests, errors), vibration, KINDS.index(kind), seed)
        history = simulate_run(scene, duration_s, options, absences)
        if history is not None:
            return list(log_lines(scene, history, calibration_sd, rng)), truth_of(scene, history)


def with_vibration(scene: SimulatedRun, vibration: Vibration, *seed: int) -> SimulatedRun:
    """The scene on palms that vibrate as described, which its log states."""
    if not vibration.vibrates:
        return replace(scene, vibration=vibration)
    shaking, surface = shaken(vibration, scene.surface, scene.body.mass, *seed)
    return replace(scene, vibration=vibration, shaking=shaking, surface=surface)


def _draw(
    kind: Kind,
    rng: np.random.Generator,
    body: Body | None,
    surface: FrictionSurface | None,
    rests: tuple[Span, ...],
    imperfections: Imperfections,
) -> SimulatedRun:
    """A scene of the kind, with its body turned so that ψ starts at 0."""
    if body is None:
        body = random_body(kind, rng)
    rocking = Rocking(
        draw_rock(rng, (0.68, 0.82), (0.35, 0.70), (0.16, 0.38), rests),
        draw_rock(rng, (1.50, 1.82), (0.10, 0.28), (0.17, 0.42), rests),
    )
    drawn_surface = random_surface(kind, rng)
    release = float(rng.choice((-1.0, 1.0)) * rng.uniform(0.12, 0.5)) if kind == "nominal" else 0.0
    hinge = Hinge("fixed", base=(0.0, 0.0))
    if kind == "rig":
        length = float(rng.uniform(0.09, 0.15))
        hinge = Hinge("arc", length, (length, 0.0))
    poses = stable_poses(body, imperfections.true_palms(rocking.at(0.0)))
    psi = poses[int(rng.integers(len(poses)))] + release
    return SimulatedRun(kind, body.turned(psi), hinge, surface or drawn_surface, rocking, imperfections)


def draw_rock(rng: np.random.Generator, mean: Span, amplitude: Span, frequency: Span, rests: tuple[Span, ...]) -> Rock:
    drawn = [float(rng.uniform(*each)) for each in (mean, amplitude, frequency, (-math.pi, math.pi))]
    return Rock(drawn[0], drawn[1], drawn[2], drawn[3], rests)


def simulate_run(
    scene: SimulatedRun, duration_s: float, options: PlantOptions, absences: tuple[Span, ...]
) -> FloatArray | None:
    """Rows of `_COLUMNS` every 0.5 ms, with NaN while the object is absent; None if contact was lost."""
    plant = scene.plant(options)
    lag = options.lag_s
    palms = scene.palms_at(-lag)
    plant.place(palms, psi=0.0)
    count = round(duration_s / STEP_S) + 1
    mass, low, high = scene.body.mass, _PAD_MARGIN_M, PAD_LENGTH - _PAD_MARGIN_M
    least = _MIN_FORCE * mass
    if isinstance(plant, VibratingPlant) and not absences:
        history = plant.simulate_rocking(scene.drive(lag), ContactBounds(mass, least, low, high), STEP_S, count)
        return smoothed(history) if len(history) == count else None
    rows = []
    is_absent = False
    for k in range(count):
        t = k * STEP_S
        if any(begin <= t < end for begin, end in absences):
            is_absent = True
            missing = [math.nan] * 5
            rows.append((t, plant.state.psi, *missing, *palms.angles, math.nan, math.nan))
            palms = scene.palms_at(t + STEP_S - lag)
            continue
        if is_absent:
            is_absent = False
            _place_again(plant, scene.body, palms)
        contact1, contact2 = plant.contacts()
        if min(contact1.force, contact2.force) < least:
            return None
        if not (low < contact1.s < high and low < contact2.s < high):
            return None
        r1, r2 = plant.radii()
        q = plant.state
        forces = (contact1.force, contact2.force)
        rows.append((t, q.psi, q.omega0, r1, r2, contact1.s, contact2.s, *palms.angles, *forces))
        middle = scene.palms_at(t + 0.5 * STEP_S - lag)
        palms = scene.palms_at(t + STEP_S - lag)
        plant.advance(middle, palms, STEP_S)
    run = np.array(rows)
    return smoothed(run) if isinstance(plant, VibratingPlant) else run  # only a resolved vibration has a ripple


def smoothed(history: FloatArray) -> FloatArray:
    """A run's rows with ω0 and both forces averaged over the vibration, with a Hann window about each row.

    This is what a slow force sensor reads, and the body's slow motion. Rows without a body (NaN) are unchanged.
    """
    half = round(0.5 * _SMOOTHING_S / STEP_S)
    weights = np.hanning(2 * half + 3)[1:-1]
    result = history.copy()
    for column in map(_COLUMNS.index, ("omega0_rad_s", "f1_n", "f2_n")):
        present = np.isfinite(history[:, column])
        share = np.convolve(present.astype(np.float64), weights, "same")
        mean = np.convolve(np.where(present, history[:, column], 0.0), weights, "same")
        result[present, column] = mean[present] / share[present]
    return result


def _place_again(plant: Plant, body: Body, palms: PalmMotion) -> None:
    """Place the body in the first stable pose, by increasing ψ, that is turned far enough from where it was removed."""
    turns = sorted((psi - plant.state.psi) % math.tau for psi in stable_poses(body, palms))
    turned_enough = [by for by in turns if _MIN_TURN_RAD < by < math.tau - _MIN_TURN_RAD]
    plant.place(palms, psi=plant.state.psi + (turned_enough or turns)[0])


def log_lines(
    scene: SimulatedRun, history: FloatArray, calibration_sd: Mapping[str, float], rng: np.random.Generator
) -> Iterator[Line]:
    """The header, then palms and pads in time order with noise and rounding."""
    hinge: Line = {"mode": scene.hinge.mode}
    if scene.hinge.mode == "arc":
        hinge["palm1_length_m"] = scene.hinge.palm1_length
    pad = {"length_m": PAD_LENGTH, "noise_m": _PAD_NOISE_M, "resolution_m": _PAD_RESOLUTION_M}
    rig = {"gravity_m_s2": 9.81, "hinge": hinge, "pad": pad, "force_scale_std": _FORCE_SCALE_STD}
    rig["calibration_sd"] = {key: calibration_sd.get(name, 0.0) for name, key in CALIBRATION_KEYS.items()}
    rig["vibration"] = vibration_line(scene.vibration)
    rig |= _curvature_keys(scene.curvatures)
    yield {"palmd_log": 1, "rig": rig}
    duration = float(history[-1, 0])
    events = list(_palm_lines(scene, history, rng))
    for number in PALMS:
        times = _sample_times(scene.kind, duration, rng)
        events += _pad_lines(number, times, history, scene.imperfections.pads[number - 1], rng)
    yield from sorted(events, key=lambda line: float(line["t"]))


def _palm_lines(scene: SimulatedRun, history: FloatArray, rng: np.random.Generator) -> Iterator[Line]:
    """The arm's reports: measured angles, planned rates and accelerations."""
    angle_errors = scene.imperfections.true_palms(PalmMotion.at_rest((0.0, 0.0))).angles
    times = np.arange(int(history[-1, 0] / _ARM_PERIOD_S)) * _ARM_PERIOD_S
    reported_angles = [np.interp(times, history[:, 0], history[:, 7 + i]) for i in range(len(JOINTS))]
    for t, *reported in zip(times.tolist(), *(each.tolist() for each in reported_angles), strict=True):
        plan = scene.rocking.at(t)
        angles = [angle - error for angle, error in zip(reported, angle_errors, strict=True)]
        noise = rng.normal(0.0, _PALM_NOISE_RAD, 2)
        palms = {
            **{
                name: round(phi + float(angle_errors), 7)
                for name, phi, angle_errors in zip(_ANGLE_COLUMNS, angles, noise, strict=True)
            },
            **{f"omega{palm}_rad_s": round(omega, 7) for palm, omega in zip(PALMS, plan.rates, strict=True)},
            **{f"alpha{palm}_rad_s2": round(alpha, 7) for palm, alpha in zip(PALMS, plan.accelerations, strict=True)},
        }
        yield {"t": round(t, 6), "palms": palms}


def _sample_times(kind: Kind, duration: float, rng: np.random.Generator) -> FloatArray:
    """Report times of one pad: every 10 ms, or in three bands with mean 10 ms and standard deviation 5 ms."""
    t = float(rng.uniform(0.0, _PAD_PERIOD_S))
    if kind in ("nominal", "odd"):
        return np.arange(t, duration - 0.03, _PAD_PERIOD_S)
    count = int(duration / 0.005)
    bands = rng.choice((1.0, 2.0, 3.0), count, p=_BAND_WEIGHTS) * _PACKET_S
    gaps = np.maximum(bands + rng.normal(0.0, _BAND_JITTER_S, count), 1e-4)
    times = t + np.cumsum(gaps) - gaps[0]
    return np.asarray(times[times < duration - 0.03])


def _pad_lines(
    pad: int, times: FloatArray, history: FloatArray, imperfection: PadImperfection, rng: np.random.Generator
) -> Iterator[Line]:
    """One pad's readings with its errors, noise and rounding."""
    s = np.interp(times - imperfection.lag, history[:, 0], history[:, 4 + pad])
    force = np.interp(times, history[:, 0], history[:, 8 + pad])
    present = np.isfinite(s)
    times, s, force = times[present], s[present], force[present]
    s += np.array([imperfection.reading_error_m(*true) for true in zip(s.tolist(), force.tolist(), strict=True)])
    s = s + rng.normal(0.0, _PAD_NOISE_M, len(s))
    force = force * (1.0 + rng.normal(0.0, _FORCE_SCALE_STD, len(s)))
    s = np.round(s / _PAD_RESOLUTION_M) * _PAD_RESOLUTION_M
    force = np.maximum(np.round(force / _FORCE_RESOLUTION_N) * _FORCE_RESOLUTION_N, 0.0)
    for t, s_m, force_n in zip(times.tolist(), s.tolist(), force.tolist(), strict=True):
        yield {"t": round(t, 6), "pad": pad, "s_m": round(s_m, 6), "force_n": round(force_n, 2)}


def truth_of(scene: SimulatedRun, history: FloatArray) -> Line:
    """The true state and parameters, in the fields of the reference truth files."""
    theta: FloatArray = np.arange(360, dtype=np.float64) * (math.tau / 360)
    columns = history[::_STEPS_PER_TRUTH].T.tolist()
    return {
        "kind": scene.kind,
        "shape": scene.body.shape,
        "rho_m": scene.body.rho,
        "mass_kg": scene.body.mass,
        "mu": scene.surface.mu,
        "dither_m_s": scene.surface.dither if scene.surface.mu else None,
        "damping_m2_s": scene.surface.damping,
        "theta_rad": theta.tolist(),
        "h_m": scene.body.support.sample(theta).tolist(),
        "rig": scene.imperfections.constants(),
        **vibration_truth(scene.shaking),
        **_curvature_keys(scene.curvatures),
    } | dict(zip(_COLUMNS, columns, strict=True))


def vibration_truth(shaking: Shaking | None) -> dict[str, Any]:
    """The palms' true vibration, if any."""
    if shaking is None:
        return {}
    return {
        "law": "vibrating" if shaking.relation == "independent" else shaking.relation,
        "vibration_m_s": shaking.palms[0].speed,
        "vibration_hz": [each.frequency for each in shaking.palms],
    }


def _curvature_keys(curvatures: PadPair) -> dict[str, float]:
    return {f"palm{palm}_curvature_per_m": kappa for palm, kappa in zip(PALMS, curvatures, strict=True) if kappa}


def main(arguments: list[str] | None = None) -> int:
    """Write one simulated log, and its truth beside it as `*.truth.json`."""
    parser = argparse.ArgumentParser(prog="python -m palmd.rig.simulate", description=main.__doc__)
    parser.add_argument("--kind", choices=KINDS, default="nominal")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument(
        "--imperfections", choices=CALIBRATION, default="none", help="of the rig, drawn (default: %(default)s)"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="the log, *.jsonl")
    parser.add_argument(
        "--vibration", choices=VIBRATIONS, default="independent", help="of the palms (default: %(default)s)"
    )
    options = parser.parse_args(arguments)
    calibration_sd = CALIBRATION[options.imperfections]
    lines, truth = simulate_log(
        options.kind,
        options.seed,
        options.seconds,
        calibration_sd=calibration_sd,
        vibration=VIBRATIONS[options.vibration],
    )
    options.output.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    options.output.with_suffix(".truth.json").write_text(json.dumps(truth), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
