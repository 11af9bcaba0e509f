"""Plans of the exploration study: an exploration, or random moves. Pure."""

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

Strategy = Literal["explore", "random"]
STRATEGIES: tuple[Strategy, ...] = get_args(Strategy)

OPEN_LOOP = LimitsConfig(phi1_deg=(10.0, 100.0), phi2_deg=(65.0, 125.0))
"""Limits within which objects of 24 mm mean radius keep both contacts on the pads, without feedback."""

_STREAM = 11  # random stream of the moves, distinct from the rig's


def plan(strategy: Strategy, config: Config, goal: ExploreGoal, seed: int) -> PlanSpec:
    """The strategy's plan, which lasts `goal.time_limit_s` at least; `seed`: for the random moves."""
    moves = (
        [{"explore": goal.model_dump()}] if strategy == "explore" else _random_moves(config, goal.time_limit_s, seed)
    )
    return PlanSpec.model_validate({"name": strategy, "segments": moves})


def _random_moves(config: Config, seconds: float, seed: int) -> list[dict[str, object]]:
    """A sequence of random moves from the set that the explorer chooses from."""
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
    """`OPEN_LOOP`; for curved palms the explorer's limits without a known object, with the configuration's rates."""
    curvatures = config.rig.curvatures_per_m
    if not any(curvatures):
        return OPEN_LOOP
    phi1, phi2 = (tuple(np.degrees(each).tolist()) for each in careful_angles(curvatures))
    return config.limits.model_copy(update={"phi1_deg": phi1, "phi2_deg": phi2})


def _pose(phi1_deg: float, phi2_deg: float) -> dict[str, float]:
    return {"phi1_deg": phi1_deg, "phi2_deg": phi2_deg}
