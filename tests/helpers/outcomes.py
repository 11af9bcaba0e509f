"""What came of a run without wires: the estimates against the truth, and what reached the arm. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.harness.scorer import COMPARED, Scorer
from palmd.quantities import ESTIMATE, SHAPE
from palmd.rig.world import World
from tools.closed_loop import Instant, TwoPalmsLoop


@dataclass(frozen=True, slots=True)
class Outcome:
    """A run in numbers, SI; NaN for what there is not.

    t_settled: from the plan's start to the first valid tick (s). valid: share of the ticks since then.
    wrong: share of the valid ticks with r1 or r2 off by more than `score.WRONG_M`. r_rms, omega0_rms: over the valid
    ticks of the run's last `score.LAST_S`. e_h, touched: the last valid outline's score. rho_error, mass_error:
    relative, mu_error absolute, of the last valid tick. objects: how often the observer began anew. outside_limits,
    largest_rate (rad/s): of the set-points as heard at the far end.
    """

    seed: int
    kind: str
    t_settled: float
    valid: float
    wrong: float
    r_rms: float
    omega0_rms: float
    e_h: float
    touched: float
    rho_error: float
    mu_error: float
    mass_error: float
    objects: int
    contact_losses: int
    falls: int
    outside_limits: int
    largest_rate: float

    @property
    def settled(self) -> bool:
        """Whether any tick was called valid."""
        return not math.isnan(self.t_settled)


def conclude(wireless: TwoPalmsLoop, duration_s: float) -> Outcome:
    """Start the plan, let it run for so many seconds, stop; raises ClosedLoopError when that cannot be done."""
    wireless.start()
    scorer = Scorer(wireless.t)
    for instant in wireless.run(duration_s):
        take(scorer, instant)
    wireless.stop()
    return outcome(scorer, wireless.world)


def take(scorer: Scorer, instant: Instant) -> None:
    """One tick of a run."""
    estimate = instant.messages[ESTIMATE.name]
    if scorer.take(instant.t, estimate):
        scorer.compare(instant.t, [estimate[name] for name in COMPARED], [instant.truth[name] for name in COMPARED])
    if SHAPE.name in instant.messages:
        scorer.take_shape(instant.messages[SHAPE.name])


def outcome(scorer: Scorer, world: World) -> Outcome:
    """What came of it; the object on the palms must be the one they were asked about."""
    status, body = world.status(), world.object_truth()
    score = scorer.outline(body["h_m"])
    r_rms, omega0_rms = scorer.rms()
    rho_error, mu_error, mass_error = scorer.constants(body)
    return Outcome(
        seed=world.seed,
        kind=world.kind,
        t_settled=scorer.settling_s,
        valid=scorer.valid_share,
        wrong=scorer.wrong_share,
        r_rms=r_rms,
        omega0_rms=omega0_rms,
        e_h=math.nan if score is None else score.e_h,
        touched=math.nan if score is None else score.touched,
        rho_error=rho_error,
        mu_error=mu_error,
        mass_error=mass_error,
        objects=scorer.estimate.get("object", 0),
        contact_losses=status["contact_losses"],
        falls=status["falls"],
        outside_limits=status["setpoints_outside_limits"],
        largest_rate=math.radians(status["largest_rate_deg_s"]),
    )
