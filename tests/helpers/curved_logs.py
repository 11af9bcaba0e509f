"""Simulated event logs of curved palms with their truth, in the form of `rig.simulate`:

    cradle     both palms concave, R = 60–90 mm, no friction, released away from rest
    dome       both convex, R = 60–150 mm, as cradle
    cfriction  concave, friction with dither, started at rest, irregular samples

The palms' angles are chosen so that the tangents at the contacts open as flat palms do: 100° on average. In a cradle
the same motion turns the contacts' normals more, so that it moves by 0.7 of the amplitude of flat palms.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np

from palmd.rig.curved_plant import MAX_CURVATURE_RATIO, max_curvature_radius, stable_on_arcs
from palmd.rig.imperfections import Imperfections, drawn
from palmd.rig.plant import AS_ASSUMED, Hinge, PadPair, PlantOptions, random_surface
from palmd.rig.shapes import Body, Kind, random_body
from palmd.rig.simulate import (
    PERFECTLY_KNOWN,
    Line,
    Rocking,
    SimulatedRun,
    Span,
    draw_rock,
    log_lines,
    simulate_run,
    truth_of,
    with_vibration,
)
from palmd.system.arcs import joints_of
from palmd.system.description import RigDescription
from palmd.system.vibration import INDEPENDENT, Vibration

CurvedKind = Literal["cradle", "dome", "cfriction"]
CURVED_KINDS: tuple[CurvedKind, ...] = get_args(CurvedKind)

AMPLITUDE = 0.7  # relative to flat palms
_RADII_M: Mapping[CurvedKind, Span] = {"cradle": (0.06, 0.09), "dome": (-0.15, -0.06), "cfriction": (0.06, 0.09)}
_STREAM = 0x63757276  # random stream, distinct from that of `rig.simulate`


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
    vibration: Vibration = INDEPENDENT,
) -> tuple[list[Line], Line]:
    """A run as event-log lines (header first), and its truth; the same seed gives the same run.

    `curvatures` of the palms (1/m) and `body` are drawn by default. Scenes in which a contact is lost or comes near a
    pad's end, or with palms that are too concave for the body, are drawn again. `vibration`: as in `simulate_log`.
    """
    rng = np.random.default_rng([_STREAM, CURVED_KINDS.index(kind), seed])
    imperfections = drawn(RigDescription().known_to(calibration_sd), _STREAM, seed)
    while True:
        scene = draw(kind, rng, curvatures, amplitude, imperfections, body)
        if scene is None:
            continue
        scene = with_vibration(scene, vibration, _STREAM, seed)
        history = simulate_run(scene, duration_s, options, ())
        if history is not None:
            return list(log_lines(scene, history, calibration_sd, rng)), truth_of(scene, history)


def draw(
    kind: CurvedKind,
    rng: np.random.Generator,
    curvatures: PadPair | None,
    amplitude: float,
    imperfections: Imperfections,
    body: Body | None = None,
) -> SimulatedRun | None:
    """Draw a scene with the body turned so that ψ starts at 0; None if the palms are too concave for the body."""
    flat_kind: Kind = "friction" if kind == "cfriction" else "nominal"
    body = body or random_body(flat_kind, rng)
    kappa = curvatures or (1.0 / float(rng.uniform(*_RADII_M[kind])), 1.0 / float(rng.uniform(*_RADII_M[kind])))
    beta1, opening = float(rng.uniform(0.68, 0.82)), float(rng.uniform(1.50, 1.82))
    amplitudes = [(amplitude * low, amplitude * high) for low, high in ((0.35, 0.70), (0.10, 0.28))]
    surface = random_surface(flat_kind, rng)
    release = float(rng.choice((-1.0, 1.0)) * rng.uniform(0.12, 0.5)) if flat_kind == "nominal" else 0.0
    if max(kappa) * max_curvature_radius(body) > MAX_CURVATURE_RATIO:
        return None
    joints = joints_of(body.support.at(0.0)[0], (beta1, opening), kappa)
    rocking = Rocking(
        *(
            draw_rock(rng, (angle, angle), span, frequencies, ())
            for angle, span, frequencies in zip(joints, amplitudes, ((0.16, 0.38), (0.17, 0.42)), strict=True)
        )
    )
    scene = SimulatedRun(flat_kind, body, Hinge("fixed", base=(0.0, 0.0)), surface, rocking, imperfections, kappa)
    poses = stable_on_arcs(body, scene.palms_at(0.0), kappa)
    if not poses:
        return None
    psi = poses[int(rng.integers(len(poses)))] + release
    return SimulatedRun(flat_kind, body.turned(psi), scene.hinge, surface, rocking, imperfections, kappa)
