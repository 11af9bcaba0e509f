"""What the study of exploring compares: explorations of what is unknown and of what is known, and two plans. Pure."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import Config, LimitsConfig, PlanSpec
from palmd.events import FloatArray
from palmd.motion.candidates import single_moves
from palmd.motion.check import motion_limits
from palmd.motion.explorer import MOVES, careful_angles
from palmd.motion.plan import HOME

Strategy = Literal["explore", "clairvoyant", "random", "systematic"]
STRATEGIES: tuple[Strategy, ...] = get_args(Strategy)
EXPLORES: tuple[Strategy, ...] = ("explore", "clairvoyant")
"""Those that an explorer decides: by what an observer finds, and by the truth."""

OPEN_LOOP = LimitsConfig(phi1_deg=(10.0, 100.0), phi2_deg=(65.0, 125.0))
"""Where objects of 24 mm mean radius have both contacts on the pads: nobody looks whether they have."""

_SWEEP_DEG = ((30.0, 75.0), (30.0, 105.0), (45.0, 90.0), (60.0, 75.0), (28.0, 114.0))
_SWEEP_S = 10.0
_STREAM = 11  # keeps the random moves apart from the rig's random numbers


def plan(strategy: Strategy, config: Config, goal: ExploreGoal, seed: int) -> PlanSpec:
    """The strategy's plan, which goes on for `goal.time_limit_s` at least; `seed` draws the random moves."""
    segments: list[dict[str, object]]
    match strategy:
        case "explore" | "clairvoyant":
            segments = [{"explore": goal.model_dump()}]
        case "random":
            segments = _random_moves(config, goal.time_limit_s, seed)
        case "systematic":
            segments = _sweep()
    repeat = "forever" if strategy == "systematic" else 1
    return PlanSpec.model_validate({"name": strategy, "repeat": repeat, "segments": segments})


def _random_moves(config: Config, seconds: float, seed: int) -> list[dict[str, object]]:
    """Moves like those that the explorer chooses from, one after the other as they are drawn."""
    random = np.random.default_rng([_STREAM, seed])
    limits = motion_limits(config.model_copy(update={"limits": _blind_limits(config)}))
    here: FloatArray = np.array(HOME)
    segments: list[dict[str, object]] = []
    while seconds > 0.0:
        moves = single_moves(random, here, 1, MOVES, limits)
        for end, duration in zip(np.degrees(moves.ends[0]), moves.durations[0], strict=True):
            segments.append({"move": _pose(*end.tolist()), "duration_s": float(duration)})
        here = moves.ends[0, -1]
        seconds -= float(moves.durations.sum())
    return segments


def _blind_limits(config: Config) -> LimitsConfig:
    """`OPEN_LOOP`; on arcs, where the explorer keeps to while it knows nothing, at the configuration's rates."""
    curvatures = config.rig.curvatures_per_m
    if not any(curvatures):
        return OPEN_LOOP
    phi1, phi2 = (tuple(np.degrees(each).tolist()) for each in careful_angles(curvatures))
    return config.limits.model_copy(update={"phi1_deg": phi1, "phi2_deg": phi2})


def _sweep() -> list[dict[str, object]]:
    """Rocks the object about one pose after the other."""
    segments: list[dict[str, object]] = []
    for middle in _SWEEP_DEG:
        segments.append({"move": _pose(*middle), "duration_s": 1.5})
        swing = {"sine": _pose(18.0, 8.0), "frequency_hz": [0.4, 0.31], "duration_s": _SWEEP_S}
        segments.append(swing)
    return segments


def _pose(phi1_deg: float, phi2_deg: float) -> dict[str, float]:
    return {"phi1_deg": phi1_deg, "phi2_deg": phi2_deg}
