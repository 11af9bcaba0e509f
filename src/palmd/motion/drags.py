"""How a gripper explores a body that turns freely in it: which drag comes next, by what is measured. Pure.

The body is set down tilted, towards the nearer end of the pad, so that there is room to drag it inwards. Lowered by
dz < 0 it turns by dz/e and slips by u = Ẋ + z ω0; friction trails (u e < 0), and cannot hold it, while the arm drags
against e by more than z |ż/e|. So each drag goes down while it drags inwards, by steps that are small against e, which
the pad tells. Raised, friction trails anyway while the arm goes back by less than z ż/|e|. It turns back before the
dead centre (e small), before the end of the pad, and where the force comes near its limit or to nothing. A side is done
when it was followed down and up; then the body is lifted off for somebody to tilt it to the other side: in one go, and
as fast as the arm may, for whatever stands short of the dead centre presses by 1/e, and what gravity cannot turn as
fast as the pivot rises presses no more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from palmd.config.plans import ExploreGoal
from palmd.motion.pivot import PivotLimits
from palmd.motion.segments import PEAK_ACCELERATION, PEAK_RATE, Angles, Move
from palmd.system.pivot import Touching

Phase = Literal["lift", "turn", "seek", "settle", "down", "up", "roll"]

APPROACH_M_S = 0.015  # in the air
BEGIN_SHARE = 0.25  # of the pad, from its end to where the gripper comes down; a body reaches ahead of its pivot
STROKE_M, STROKE_RATIO = 0.012, 10.0  # towards the pad: dragged inwards, and lowered by so much less
LIFTED_M, AWAY_M_S = 0.016, 0.02  # while it touches: so far that it is fast soon, and leaves the pad; and then
RAISED_M = 2e-4  # on the way back to the next stroke: more than a tilted or bowed pad rises over one
NEAR_M = 9e-3  # above the highest place that the body touched at, from where on strokes seek it: its other side differs
CLEAR_M = 6e-3  # by which a body is lifted off for somebody to turn it
TURN_S = 2.0  # which they have
TRAIL = 1.35  # times the drag at which the body just rolls
BACK = 0.6  # share of that which the arm goes back while the body is raised
STEP_M, STEP_SHARE = 8e-4, 0.09  # of height at a time, and as a share of e
DOWN_M_S = 0.004
# Of e, that the body must be set down with; and as a share of the pivot's height, outside the friction cone of μ = 0.2.
TILTED_M, TILTED_SHARE = 2.5e-3, 0.2
LEAST_LEVER_M, LEVER_SHARE = 2e-3, 0.4  # of e, where it turns back: that, or a share of the largest on this side
TAMED_SHARE, LEAST_FORCE_N = 0.55, 0.09  # of the limit (lifted off, it rises), and the force, where it turns back
# Of the limit, what the force may be foreseen to come to; it is seen late, and lowering goes on as long.
FORESEEN_SHARE, SEEN_LATE_S, FADING = 0.75, 0.08, 0.9
RAISED_SHARE = 0.5  # the same where a lift begins, which needs a run-up: beyond, the lever may shorten to nothing
PAD_END_M = 5e-3
RETREAT_M = 8e-4
FARTHEST_M = 0.012  # of the pivot from the body's middle
LEAST_STEP_M = 1e-4
SETTLED_S = 0.1  # at rest, after which what is felt is of where it stands
SILENT_S = 0.4  # of the pad, after which the body is taken to have left it
ROUNDS = 3  # of both sides, before it is given up that anything more is told
_LEAST_S = 0.12


@dataclass(frozen=True, slots=True)
class DragStep:
    """What to do now: move on, stand still at once, wait, or end; `reason` is for people, empty for nothing new."""

    kind: Literal["move", "halt", "wait", "done"]
    move: Move | None = None
    reason: str = ""


WAIT = DragStep("wait")


class Drags:
    """See the module. Asked at every tick; safe in the loop. `ends` counts the ends of branches that were reached."""

    def __init__(self, limits: PivotLimits, goal: ExploreGoal) -> None:
        self._limits, self._goal = limits, goal
        self.phase: Phase = "seek"
        self.turned_back: dict[str, int] = {}  # how often, by why
        self.lifted = 0  # times that the body left the pad by itself
        self._side = 0.0  # of the dead centre that is touched
        self._ends: set[tuple[float, str]] = set()
        self._wanted = 1.0  # side that comes next
        self._z_touch = -math.inf  # the highest that the body has touched at
        self._t_turned = -math.inf
        self._t_silent = math.inf  # since when the pad says nothing
        self._rounds = 0
        self._before: tuple[float, float] | None = None  # z and e² at the last step
        self._slope = 0.0  # of e² over z, which is even where e itself ends like a root
        self._followed = False  # from where it was set down, so that the slope is known
        self._torque = 0.0  # about the pivot, that the pad gave at the last steps (N m)
        self._least_torque, self._torque_lost = math.inf, 0.0  # since the last step, and how much less that is by step
        self._weak = 0.0  # the least of the last step
        self._mu = 0.0  # lower bound of the friction coefficient, from measured forces
        self._z_felt = -math.inf  # where the body was felt last
        self._z_begun = -math.inf  # where it was set down: up to there a way up is known
        self._most = 0.0  # largest |e| of this touch
        self._retreat = False
        self._t_rest = math.inf  # since when the arm stands

    @property
    def coverage(self) -> float:
        """Share of the four ends of both branches that were reached."""
        return min(len(self._ends) / 4.0, 1.0)

    def look(self, felt: Touching, here: Angles, resting: bool) -> DragStep:
        """The next step: what is felt, where the last move ends (m), and whether it has ended."""
        if self.phase == "seek" and felt.touching:
            self.phase = "settle"
            self._z_touch = max(self._z_touch, felt.z)  # the other side, and another tilt, touch elsewhere
            self._before, self._slope, self._followed, self._most = None, 0.0, False, 0.0
            self._torque, self._least_torque, self._weak, self._torque_lost = 0.0, math.inf, 0.0, 0.0
            self._z_felt = self._z_begun = felt.z
            return DragStep("halt", reason="the body touches")
        if self.phase in ("down", "up", "settle", "roll") and not felt.touching:
            return self._silence(felt.t, resting)
        self._t_silent = math.inf
        if felt.touching:
            self._z_felt = felt.z
            torque = felt.force * abs(felt.e)
            self._torque, self._least_torque = max(self._torque, torque), min(self._least_torque, torque)
        if self.phase == "down" and not resting and (why := self._warning(felt)):
            self._note(why)
            self._retreat = True
            self.phase = "up"
            self._ends.add((self._side, "low"))
            return DragStep("halt", reason=f"turns back: {why}")
        self._t_rest = min(self._t_rest, felt.t) if resting else math.inf
        if not resting:
            lifted = self.phase == "lift" and not felt.touching and felt.z > self._clear
            return DragStep("halt") if lifted else WAIT
        return self._next(felt, here)

    def _silence(self, t: float, resting: bool) -> DragStep:
        """Stand still while the pad says nothing; for longer, the body has left it."""
        if math.isinf(self._t_silent):
            self._t_silent = t
            return DragStep("halt", reason="the pad says nothing: is the body still on it?")
        if not resting or t < self._t_silent + SILENT_S:
            return WAIT
        self._t_silent = math.inf
        if self.phase == "up" and self._z_felt > self._z_begun:  # it presses less and less, until nothing is felt
            self._ends.add((self._side, "high"))
            self._wanted = -self._side
            return self._go("lift", "this side is done: the body was raised off the pad")
        self.lifted += 1
        return self._go("lift", "the body left the pad: lifted off to be tilted anew")

    def _next(self, felt: Touching, here: Angles) -> DragStep:
        match self.phase:
            case "lift":
                return self._lift(felt, here)
            case "turn":
                return self._turn(felt, here)
            case "seek":
                return self._seek(here)
            case "settle":
                return self._settle(felt, here)
            case "down":
                return self._down(felt, here)
            case "up":
                return self._up(felt, here)
            case "roll":
                return self._roll(felt, here)

    # ---- off the pad -------------------------------------------------------------------------------------

    def _lift(self, felt: Touching, here: Angles) -> DragStep:
        _, (_, top) = self._limits.angles
        if felt.touching:
            if here[1] >= top:
                return DragStep("done", reason="there is no room to lift the body off: raise limits.z_mm")
            return self._moved(here, (here[0], here[1] + LIFTED_M), self._limits.rate)
        self.phase, self._t_turned = "turn", felt.t + TURN_S
        return self._moved(here, (here[0], max(here[1], self._clear)), AWAY_M_S)

    @property
    def _clear(self) -> float:
        """The height (m) at which a hand may turn the body: tilted anew, it may reach as far down as it ever did."""
        return max(self._z_felt + CLEAR_M, self._z_touch + NEAR_M)

    def _turn(self, felt: Touching, here: Angles) -> DragStep:
        start = self._start_of(self._wanted)
        if here[0] != start:
            return self._moved(here, (start, here[1]), self._limits.rate, self._request())
        if felt.t < self._t_turned:
            return WAIT
        self.phase = "seek"
        return WAIT

    def _request(self) -> str:
        where = "far end" if self._wanted > 0 else "beginning"
        return f"lifted off: tilt the body towards the pad's {where}"

    def _seek(self, here: Angles) -> DragStep:
        (_, _), (bottom, _) = self._limits.angles
        start = self._start_of(self._wanted)
        if here[0] != start:  # dragged outwards: friction would press a body down that touched now
            raised = RAISED_M if here[1] > bottom else 0.0
            return self._moved(here, (start, here[1] + raised), self._limits.rate)
        near = self._z_touch + NEAR_M
        if math.isfinite(near) and here[1] > near:
            return self._moved(here, (start, near), APPROACH_M_S)
        if here[1] <= bottom:
            return DragStep("done", reason="nothing touches the pad, though the gripper is as low as it may be")
        return self._moved(here, (start - self._wanted * STROKE_M, here[1] - STROKE_M / STROKE_RATIO), APPROACH_M_S)

    def _start_of(self, side: float) -> float:
        (low, high), _ = self._limits.angles
        end = BEGIN_SHARE * self._limits.pad_length
        return min(max(self._limits.pad_length - end if side > 0 else end, low), high)

    # ---- on the pad --------------------------------------------------------------------------------------

    def _settle(self, felt: Touching, here: Angles) -> DragStep:
        del here
        if not (math.isfinite(felt.e) and math.isfinite(felt.force)):
            return WAIT
        if abs(felt.e) < max(TILTED_M, TILTED_SHARE * felt.z):
            return self._go("lift", "it touches too near under the pivot: lifted off, tilt it farther")
        self._side = math.copysign(1.0, felt.e)
        self.phase = "down"
        return WAIT

    def _down(self, felt: Touching, here: Angles) -> DragStep:
        if why := self._warning(felt):
            self._note(why)
            self._ends.add((self._side, "low"))
            self.phase, self._retreat = "up", True
            return DragStep("wait", reason=f"turns back: {why}")
        self._learn(felt)
        lower = self._stride(felt, -1.0)
        hard = self._foreseen(felt, -lower) > FORESEEN_SHARE * self._limits.force
        if hard or self._left(felt, -lower) < LEAST_FORCE_N:
            why = _HARD if hard else _LIGHT
            self._note(why)
            self._ends.add((self._side, "low"))
            self.phase, self._retreat = "up", True
            return DragStep("wait", reason=f"turns back: {why}")
        end = (here[0] - self._side * TRAIL * felt.z * lower / abs(felt.e), here[1] - lower)
        if why := self._off(end, felt.e):
            self._note(why)
            self._ends.add((self._side, "low"))
            self.phase = "up"
            return DragStep("wait", reason=f"turns back: {why}")
        return self._moved(here, end, DOWN_M_S)

    def _up(self, felt: Touching, here: Angles) -> DragStep:
        known = self._z_begun - felt.z  # it was followed down from there
        if not math.isfinite(felt.e) or (known <= 0.0 and felt.t < self._t_rest + SETTLED_S):
            return WAIT
        self._learn(felt)
        left = max(self._height_left(felt), known)
        higher = min(RETREAT_M if self._retreat else self._stride(felt, 1.0), left)
        back = 0.0 if self._retreat else BACK * felt.z * higher / abs(felt.e)
        end = (here[0] + self._side * back, here[1] + higher)
        warned = "" if self._retreat else self._warning(felt)
        # the higher, the shorter the lever: it leans on the top
        hard = warned == _HARD or self._foreseen(felt, higher) > RAISED_SHARE * self._limits.force
        presses = hard and (self._slope < 0.0 or not self._followed)
        falling = presses or left < LEAST_STEP_M or (known <= 0.0 and warned in (_LEVER, _LIGHT))
        self._retreat = False
        if self._off(end, felt.e) and not falling:
            end = (here[0], end[1])
        if falling or end[1] > self._limits.angles[1][1]:
            self._ends.add((self._side, "high"))
            return self._over(felt) or self._go("lift", "this side is done: lifted off")
        return self._moved(here, end, DOWN_M_S)

    def _over(self, felt: Touching) -> DragStep | None:
        """Ends it where all has been seen; else the other side is next."""
        self._wanted = -self._side
        self._rounds += self.coverage >= 1.0
        if self._known(felt):
            return DragStep(
                "done", reason="both sides were followed from one end to the other, and the outline is known"
            )
        if self._rounds > ROUNDS:
            return DragStep("done", reason="both sides were followed again and again, and the outline is not told")
        return None

    def _known(self, felt: Touching) -> bool:
        """Whether all has been seen, and the outline's band is as wanted."""
        wanted = math.inf if self._goal.band_mm is None else self._goal.band_mm * 1e-3
        return self.coverage >= self._goal.coverage and math.isfinite(felt.band) and felt.band <= wanted

    def _roll(self, felt: Touching, here: Angles) -> DragStep:  # noqa: ARG002
        """Under a rigid gripper nothing rolls."""
        return WAIT

    def _stride(self, felt: Touching, sense: float) -> float:
        """Of height: small against e, and against how fast e² falls."""
        falling = -self._slope * sense  # of e² per height
        stride = min(STEP_M, STEP_SHARE * abs(felt.e))
        room = felt.e**2 - self._least**2
        return min(stride, max(0.5 * room / falling, LEAST_STEP_M)) if falling > 0.0 else stride

    def _height_left(self, felt: Touching) -> float:
        """Of height, however the body is made: e² falls by no more than twice the pivot's distance from its middle."""
        return max(felt.e**2 - self._least**2, 0.0) / (2.0 * FARTHEST_M)

    @property
    def _least(self) -> float:
        """|e| (m) where it turns back; raised, e² falls by no more than is known, and the force alone is in the way."""
        return LEAST_LEVER_M if self.phase == "up" else max(LEAST_LEVER_M, LEVER_SHARE * self._most)

    def _learn(self, felt: Touching) -> None:
        square = felt.e**2
        self._most = max(self._most, abs(felt.e))
        if self._before is not None and abs(felt.z - self._before[0]) > 1e-4:
            slope = (square - self._before[1]) / (felt.z - self._before[0])
            self._slope += (0.6 if self._followed else 1.0) * (slope - self._slope)
            self._followed = True
        self._before = felt.z, square
        self._mu = max(self._mu, self._least_friction(felt))
        self._torque = max(FADING * self._torque, felt.force * abs(felt.e))  # as before where no force is told
        self._torque_lost = max(self._weak - self._least_torque, 0.0)
        self._weak, self._least_torque = self._least_torque, math.inf

    def _least_friction(self, felt: Touching) -> float:
        """A lower bound of μ by how much the force has risen as the arm came to rest; 0 where it has not.

        Trailing, friction helps: the pad presses by τ/(|e| + μz), at rest by τ|e|/(e² − μ²z²) as in `_foreseen`.
        """
        torque = felt.force * abs(felt.e)
        if not (0.0 < self._least_torque < torque and felt.z > 0.0):
            return 0.0
        return abs(felt.e) / felt.z * (1.0 - self._least_torque / torque)

    def _foreseen(self, felt: Touching, dz: float) -> float:
        """The force (N) that the body will press with when it stands, raised by dz (m); infinite where it jams.

        About the pivot the pad gives a torque τ that hardly changes. On a pad that vibrates under a body at rest
        friction acts either way as often, so the mean force is τ|e|/(e² − μ²z²) (docs/theory/vibration.md,
        one contact). What is felt on the way is less: so the largest of the last steps counts.
        """
        e = self._lever(felt, dz)
        here, there = self._jam_margin(abs(felt.e), felt.z), self._jam_margin(e, felt.z + dz)
        return max(self._torque, felt.force * abs(felt.e)) / e * here / there if min(here, there) > 0.0 else math.inf

    def _jam_margin(self, e: float, z: float) -> float:
        """1 − (μz/e)² of a lever e (m) and a height z (m): where it comes to 0, friction holds the body."""
        return 1.0 - (self._mu * z / e) ** 2

    def _left(self, felt: Touching, dz: float) -> float:
        """The force (N) that is left on the way, raised by dz (m).

        The torque falls evenly as the centre of mass comes to hang below the pivot, where the body swings off the pad.
        """
        return (self._weak - self._torque_lost) / self._lever(felt, dz)

    def _lever(self, felt: Touching, dz: float) -> float:
        """|e| (m), raised by dz (m)."""
        return math.sqrt(max(felt.e**2 + self._slope * dz, (0.5 * LEAST_LEVER_M) ** 2))

    def _warning(self, felt: Touching) -> str:
        """Why the body must not be lowered farther; empty when it may."""
        if not math.isfinite(felt.e):
            return ""
        if not math.isfinite(felt.force):  # beyond the pad's scale
            return _HARD
        if felt.e * self._side < self._least:
            return _LEVER
        late = self._foreseen(felt, -SEEN_LATE_S * DOWN_M_S)
        if felt.force > TAMED_SHARE * self._limits.force or late > FORESEEN_SHARE * self._limits.force:
            return _HARD
        if felt.force < LEAST_FORCE_N:
            return _LIGHT
        return ""

    def _off(self, end: Angles, e: float) -> str:
        """Why a step may not lead there; empty when it may."""
        (x0, x1), (z0, _) = self._limits.angles
        if end[1] < z0:
            return "the gripper is as low as it may be"
        inside = PAD_END_M < end[0] + e < self._limits.pad_length - PAD_END_M
        return "" if x0 <= end[0] <= x1 and inside else "the pad ends here"

    def _note(self, why: str) -> None:
        self.turned_back[why] = self.turned_back.get(why, 0) + 1

    def _go(self, phase: Phase, reason: str) -> DragStep:
        self.phase = phase
        return DragStep("halt", reason=reason)

    def _moved(self, here: Angles, end: Angles, speed: float, reason: str = "") -> DragStep:
        (x0, x1), (z0, z1) = self._limits.angles
        end = (min(max(end[0], x0), x1), min(max(end[1], z0), z1))
        dx, dz = abs(end[0] - here[0]), abs(end[1] - here[1])
        most = 0.9 * self._limits.rate
        lasts = max(
            _LEAST_S,
            PEAK_RATE * max(dz / min(speed, most), dx / most),
            math.sqrt(PEAK_ACCELERATION * max(dx, dz) / (0.5 * self._limits.acceleration)),
        )
        return DragStep("move", Move(here, end, lasts), reason)


_LEVER, _LIGHT = "the pivot comes near over the contact", "the body hardly presses any more"
_HARD = "the force comes near its limit"
