"""Event logs of curved palms with their truth, without wires, in the form of `rig.simulate`:

    cradle     both palms concave, R = 60–90 mm, no friction, released away from rest
    dome       both convex, R = 60–150 mm, as cradle
    cfriction  concave, friction with dither, started at rest, irregular samples

The palms' angles are chosen by the tangents at the contacts, which open as flat palms do: 100° on average. A cradle
turns the contacts' normals more at the same motion, so that it moves by 0.7 of what flat palms do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal, get_args

import numpy as np

from palmd.events import FloatArray, PalmMotion
from palmd.rig.curved_plant import CurvedPlant, widest
from palmd.rig.imperfections import Imperfections, drawn
from palmd.rig.plant import AS_ASSUMED, FrictionSurface, Hinge, PadPair, PlantOptions, random_surface
from palmd.rig.shapes import Body, Kind, random_body
from palmd.rig.simulate import PERFECTLY_KNOWN, Line, Rocking, SimulatedRun, Span, log_lines, rock, run_of, truth_of
from palmd.system.description import RigDescription

CurvedKind = Literal["cradle", "dome", "cfriction"]
CURVED_KINDS: tuple[CurvedKind, ...] = get_args(CurvedKind)

MOST_LYING = 0.8  # κv up to which scenes are made
AMPLITUDE = 0.7  # of what flat palms move by
_RADII_M: Mapping[CurvedKind, Span] = {"cradle": (0.06, 0.09), "dome": (-0.15, -0.06), "cfriction": (0.06, 0.09)}
_STREAM = 0x63757276  # of seeds, so that no draw is shared with `rig.simulate`
_ORIENTATIONS = 180


def simulate_curved_log(
    kind: CurvedKind,
    seed: int,
    duration_s: float = 10.0,
    curvatures: PadPair | None = None,
    amplitude: float = AMPLITUDE,
    *,
    options: PlantOptions = AS_ASSUMED,
    body: Body | None = None,
    calibration_sd: Mapping[str, float] = PERFECTLY_KNOWN,
) -> tuple[list[Line], Line]:
    """A run as event-log lines (header first), and its truth; the same seed, the same run.

    `curvatures` of the palms (1/m) are drawn by default, and so is the `body`. Scenes in which a contact would be lost,
    or come near a pad's end, are drawn again, and so are palms that are too concave for the body.
    """
    rng = np.random.default_rng([_STREAM, CURVED_KINDS.index(kind), seed])
    off = drawn(RigDescription().known_to(calibration_sd), _STREAM, seed)
    while True:
        scene = draw(kind, rng, curvatures, amplitude, off, body)
        history = None if scene is None else run_of(scene, duration_s, options, ())
        if scene is not None and history is not None:
            return list(log_lines(scene, history, calibration_sd, rng)), truth_of(scene, history)


def draw(
    kind: CurvedKind,
    rng: np.random.Generator,
    curvatures: PadPair | None,
    amplitude: float,
    imperfections: Imperfections,
    body: Body | None = None,
) -> SimulatedRun | None:
    """A scene, its body turned so that ψ starts at 0; None if the palms are too concave for the body."""
    flat_kind: Kind = "friction" if kind == "cfriction" else "nominal"
    body = body or random_body(flat_kind, rng)
    kappa = curvatures or (1.0 / float(rng.uniform(*_RADII_M[kind])), 1.0 / float(rng.uniform(*_RADII_M[kind])))
    beta1, opening = float(rng.uniform(0.68, 0.82)), float(rng.uniform(1.50, 1.82))
    amplitudes = [(amplitude * low, amplitude * high) for low, high in ((0.35, 0.70), (0.10, 0.28))]
    surface = random_surface(flat_kind, rng)
    release = float(rng.choice((-1.0, 1.0)) * rng.uniform(0.12, 0.5)) if flat_kind == "nominal" else 0.0
    if max(kappa) * widest(body) > MOST_LYING:
        return None
    phi1, phi2 = hinge_angles(body.support.at(0.0)[0], beta1, opening, kappa)
    rocking = Rocking(
        rock(rng, (phi1, phi1), amplitudes[0], (0.16, 0.38), ()),
        rock(rng, (phi2, phi2), amplitudes[1], (0.17, 0.42), ()),
    )
    scene = SimulatedRun(flat_kind, body, Hinge("fixed", base=(0.0, 0.0)), surface, rocking, imperfections, kappa)
    poses = stable_on_arcs(body, scene.palms_at(0.0), kappa)
    if not poses:
        return None
    psi = poses[int(rng.integers(len(poses)))] + release
    return SimulatedRun(flat_kind, body.turned(psi), scene.hinge, surface, rocking, imperfections, kappa)


def hinge_angles(radius: float, beta1: float, opening: float, curvatures: PadPair) -> tuple[float, float]:
    """φ1, φ2 at which a circle of that radius (m) has the tangents β1 and β2 = β1 + opening (rad) at its contacts.

    Its contacts' arc lengths by fixed-point iteration on (3.13), (3.14) with each tangent's height over the hinge.
    """
    s = np.zeros(2)
    kappa = np.array(curvatures)
    for _ in range(60):
        above = radius - kappa / 2 * (s * np.sinc(kappa * s / math.tau)) ** 2
        s = (above * math.cos(opening) + above[::-1]) / math.sin(opening) / np.sinc(kappa * s / math.pi)
    phi1 = beta1 - float(kappa[0] * s[0])
    return phi1, beta1 + opening + float(kappa[1] * s[1]) - phi1


def stable_on_arcs(body: Body, palms: PalmMotion, curvatures: PadPair) -> list[float]:
    """The angles ψ in [0, 2π) at which the COM is lowest among its neighbours (rad), lowest of all first."""
    plant = CurvedPlant(body, Hinge("fixed", base=(0.0, 0.0)), FrictionSurface(), curvatures)

    def height(psi: float) -> float:
        plant.place(palms, psi)
        return plant.state.y

    psi: FloatArray = np.linspace(0.0, math.tau, _ORIENTATIONS, endpoint=False)
    heights = np.array([height(float(each)) for each in psi])
    lowest = np.flatnonzero((heights < np.roll(heights, 1)) & (heights <= np.roll(heights, -1)))
    step = math.tau / _ORIENTATIONS
    return [_lowest(height, float(psi[i]) - step, float(psi[i]) + step) for i in lowest[np.argsort(heights[lowest])]]


def _lowest(height: Callable[[float], float], low: float, high: float) -> float:
    """By golden section to 1e-5 rad."""
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    while high - low > 1e-5:
        a, b = high - golden * (high - low), low + golden * (high - low)
        low, high = (low, b) if height(a) < height(b) else (a, high)
    return (0.5 * (low + high)) % math.tau
