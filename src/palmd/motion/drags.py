"""Exploration policy of a rigid gripper for a body that pivots freely in it: the next drag from measurements. Pure.

The body is set down tilted towards the nearer end of the pad, so that there is room to drag it inwards. Lowered by
dz < 0 it turns by dz/e and slips by u = Ẋ + z ω0. While the arm drags against e by more than z |ż/e|, friction trails
(u e < 0) and cannot jam the body. So each drag goes down and inwards at once, in steps that are small against the lever
e, which the pad measures. When the pivot is raised, friction trails as long as the arm goes back by less than z ż/|e|.
The policy turns back before the dead centre (small e), before the end of the pad, and where the force comes near its
limit or vanishes. A side is done once it was followed down and up. Then the body is lifted off in one go, as fast as
the arm may, and the operator tilts it to the other side: a body that stands before the dead centre presses
proportionally to 1/e, and stops pressing if the pivot rises faster than gravity turns the body.
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

APPROACH_M_S = 0.015  # speed in the air
BEGIN_SHARE = (
    0.25  # of the pad's length: where the gripper comes down, from the pad's end; a body extends past its pivot
)
STROKE_M, STROKE_RATIO = 0.012, 10.0  # stroke towards the pad: inward drag, and its ratio to the lowering
LIFTED_M, AWAY_M_S = 0.016, 0.02  # lift while it touches, long enough to get fast and leave the pad; speed after that
RAISED_M = 2e-4  # raised on the way back to the next stroke: more than a tilted or bowed pad rises over one stroke
NEAR_M = 9e-3  # strokes begin at this height above the highest contact so far; the body's other side differs
CLEAR_M = 6e-3  # clearance at which the operator turns the body
TURN_S = 2.0  # time that the operator has for that
TRAIL = 1.35  # drag, relative to the drag at which the body just rolls
BACK = 0.6  # the same for the way back, while the body is raised
STEP_M, STEP_SHARE = 8e-4, 0.09  # largest step of height, and as a share of e
DOWN_M_S = 0.004
# Smallest e for setting down; and as a share of the pivot's height, outside the friction cone of μ = 0.2.
TILTED_M, TILTED_SHARE = 2.5e-3, 0.2
# e at which it turns back: the larger of this and a share of this side's largest
LEAST_LEVER_M, LEVER_SHARE = 2e-3, 0.4
FORCE_SHARE, LEAST_FORCE_N = 0.55, 0.09  # it turns back at this share of the limit (lifting off adds force); below this
# Largest predicted force as a share of the limit; delay of the measured force, during which lowering continues.
PREDICTED_SHARE, FORCE_DELAY_S, FADING = 0.75, 0.08, 0.9
RAISED_SHARE = 0.5  # the same at the start of a lift, which needs a run-up during which the lever may vanish
PAD_END_M = 5e-3  # margin of the contact from the pad's ends
RETREAT_M = 8e-4
FARTHEST_M = 0.012  # largest distance of the pivot from the body's middle
LEAST_STEP_M = 1e-4
SETTLED_S = 0.1  # at rest, after which readings belong to the resting pose
SILENT_S = 0.4  # without contact, after which the body has left the pad
ROUNDS = 3  # over both sides, after which the exploration gives up
_LEAST_S = 0.12


@dataclass(frozen=True, slots=True)
class DragStep:
    """Next action: move, halt at once, wait, or end. `reason`: text for the operator, empty if unchanged."""

    kind: Literal["move", "halt", "wait", "done"]
    move: Move | None = None
    reason: str = ""


WAIT = DragStep("wait")


class Drags:
    """The policy (see the module): call `look` at every tick. Safe in the loop."""

    def __init__(self, limits: PivotLimits, goal: ExploreGoal) -> None:
        self._limits, self._goal = limits, goal
        self.phase: Phase = "seek"
        self.turned_back: dict[str, int] = {}  # reason → how often it turned back
        self.lifted = 0  # times that the body left the pad without a lift
        self._side = 0.0  # sign of e: the side of the dead centre in contact
        self._ends: set[tuple[float, str]] = set()  # ends of branches that were reached
        self._next_side = 1.0
        self._z_touch = -math.inf  # highest first contact
        self._t_turned = -math.inf
        self._t_silent = math.inf  # since when the pad reports no contact
        self._rounds = 0
        self._last_step: tuple[float, float] | None = None  # z and e² at the last step
        self._slope = 0.0  # d(e²)/dz, which varies little even where e ends like a square root
        self._followed = False  # True once the slope of this contact is known
        self._torque = 0.0  # largest torque of the pad about the pivot at the last steps, fading (N m)
        self._least_torque, self._torque_lost = math.inf, 0.0  # smallest since the last step; its decrease per step
        self._last_least_torque = 0.0  # smallest torque of the last step
        self._mu = 0.0  # lower bound of the friction coefficient, from measured forces
        self._z_contact = -math.inf  # height of the last contact
        self._z_first_contact = -math.inf  # height at which it was set down; the way up to there is known
        self._largest_lever = 0.0  # largest |e| since it was set down
        self._retreat = False
        self._t_rest = math.inf  # since when the arm is at rest

    @property
    def coverage(self) -> float:
        """Share of the four ends of both branches that were reached."""
        return min(len(self._ends) / 4.0, 1.0)

    def look(self, sensed: Touching, here: Angles, resting: bool) -> DragStep:
        """Return the next step. `sensed`: measurements. `here`: end of the last move (m). `resting`: it has ended."""
        if self.phase == "seek" and sensed.touching:
            self.phase = "settle"
            self._z_touch = max(self._z_touch, sensed.z)  # the other side, and another tilt, touch elsewhere
            self._last_step, self._slope, self._followed, self._largest_lever = None, 0.0, False, 0.0
            self._torque, self._least_torque, self._last_least_torque, self._torque_lost = 0.0, math.inf, 0.0, 0.0
            self._z_contact = self._z_first_contact = sensed.z
            return DragStep("halt", reason="the body touches")
        if self.phase in ("down", "up", "settle", "roll") and not sensed.touching:
            return self._silence(sensed.t, resting)
        self._t_silent = math.inf
        if sensed.touching:
            self._z_contact = sensed.z
            torque = sensed.force * abs(sensed.e)
            self._torque, self._least_torque = max(self._torque, torque), min(self._least_torque, torque)
        if self.phase == "down" and not resting and (why := self._warning(sensed)):
            self._count_turn_back(why)
            self._retreat = True
            self.phase = "up"
            self._ends.add((self._side, "low"))
            return DragStep("halt", reason=f"turns back: {why}")
        self._t_rest = min(self._t_rest, sensed.t) if resting else math.inf
        if not resting:
            lifted = self.phase == "lift" and not sensed.touching and sensed.z > self._clear
            return DragStep("halt") if lifted else WAIT
        return self._next(sensed, here)

    def _silence(self, t: float, resting: bool) -> DragStep:
        """Halt while the pad reports no contact; after `SILENT_S` the body has left it."""
        if math.isinf(self._t_silent):
            self._t_silent = t
            return DragStep("halt", reason="the pad reports no contact: is the body still on it?")
        if not resting or t < self._t_silent + SILENT_S:
            return WAIT
        self._t_silent = math.inf
        if self.phase == "up" and self._z_contact > self._z_first_contact:  # the force fell until contact was lost
            self._ends.add((self._side, "high"))
            self._next_side = -self._side
            return self._enter("lift", "this side is done: the body was raised off the pad")
        self.lifted += 1
        return self._enter("lift", "the body left the pad: lifted off to be tilted again")

    def _next(self, sensed: Touching, here: Angles) -> DragStep:
        match self.phase:
            case "lift":
                return self._lift(sensed, here)
            case "turn":
                return self._turn(sensed, here)
            case "seek":
                return self._seek(here)
            case "settle":
                return self._settle(sensed, here)
            case "down":
                return self._down(sensed, here)
            case "up":
                return self._up(sensed, here)
            case "roll":
                return self._roll(sensed, here)

    # ---- off the pad -------------------------------------------------------------------------------------

    def _lift(self, sensed: Touching, here: Angles) -> DragStep:
        _, (_, top) = self._limits.angles
        if sensed.touching:
            if here[1] >= top:
                return DragStep("done", reason="no room to lift the body off the pad: raise limits.z_mm")
            return self._move_to(here, (here[0], here[1] + LIFTED_M), self._limits.rate)
        self.phase, self._t_turned = "turn", sensed.t + TURN_S
        return self._move_to(here, (here[0], max(here[1], self._clear)), AWAY_M_S)

    @property
    def _clear(self) -> float:
        """Height (m) at which the operator can turn the body; tilted again, it may reach as low as it ever did."""
        return max(self._z_contact + CLEAR_M, self._z_touch + NEAR_M)

    def _turn(self, sensed: Touching, here: Angles) -> DragStep:
        start = self._start_of(self._next_side)
        if here[0] != start:
            return self._move_to(here, (start, here[1]), self._limits.rate, self._request())
        if sensed.t < self._t_turned:
            return WAIT
        self.phase = "seek"
        return WAIT

    def _request(self) -> str:
        where = "far end" if self._next_side > 0 else "beginning"
        return f"lifted off: tilt the body towards the pad's {where}"

    def _seek(self, here: Angles) -> DragStep:
        (_, _), (bottom, _) = self._limits.angles
        start = self._start_of(self._next_side)
        if here[0] != start:  # dragged outwards, hence raised: friction would pull a touching body down
            raised = RAISED_M if here[1] > bottom else 0.0
            return self._move_to(here, (start, here[1] + raised), self._limits.rate)
        near = self._z_touch + NEAR_M
        if math.isfinite(near) and here[1] > near:
            return self._move_to(here, (start, near), APPROACH_M_S)
        if here[1] <= bottom:
            return DragStep("done", reason="nothing touches the pad at the gripper's lowest height: lower limits.z_mm")
        return self._move_to(
            here, (start - self._next_side * STROKE_M, here[1] - STROKE_M / STROKE_RATIO), APPROACH_M_S
        )

    def _start_of(self, side: float) -> float:
        (low, high), _ = self._limits.angles
        end = BEGIN_SHARE * self._limits.pad_length
        return min(max(self._limits.pad_length - end if side > 0 else end, low), high)

    # ---- on the pad --------------------------------------------------------------------------------------

    def _settle(self, sensed: Touching, here: Angles) -> DragStep:
        del here
        if not (math.isfinite(sensed.e) and math.isfinite(sensed.force)):
            return WAIT
        if abs(sensed.e) < max(TILTED_M, TILTED_SHARE * sensed.z):
            return self._enter("lift", "the contact is too close below the pivot: lifted off, tilt the body farther")
        self._side = math.copysign(1.0, sensed.e)
        self.phase = "down"
        return WAIT

    def _down(self, sensed: Touching, here: Angles) -> DragStep:
        if why := self._warning(sensed):
            self._count_turn_back(why)
            self._ends.add((self._side, "low"))
            self.phase, self._retreat = "up", True
            return DragStep("wait", reason=f"turns back: {why}")
        self._learn(sensed)
        lower = self._stride(sensed, -1.0)
        hard = self._predicted_force(sensed, -lower) > PREDICTED_SHARE * self._limits.force
        if hard or self._remaining_force(sensed, -lower) < LEAST_FORCE_N:
            why = _HARD if hard else _LIGHT
            self._count_turn_back(why)
            self._ends.add((self._side, "low"))
            self.phase, self._retreat = "up", True
            return DragStep("wait", reason=f"turns back: {why}")
        end = (here[0] - self._side * TRAIL * sensed.z * lower / abs(sensed.e), here[1] - lower)
        if why := self._blocked(end, sensed.e):
            self._count_turn_back(why)
            self._ends.add((self._side, "low"))
            self.phase = "up"
            return DragStep("wait", reason=f"turns back: {why}")
        return self._move_to(here, end, DOWN_M_S)

    def _up(self, sensed: Touching, here: Angles) -> DragStep:
        known = self._z_first_contact - sensed.z  # height up to which the way was followed down
        if not math.isfinite(sensed.e) or (known <= 0.0 and sensed.t < self._t_rest + SETTLED_S):
            return WAIT
        self._learn(sensed)
        left = max(self._height_left(sensed), known)
        higher = min(RETREAT_M if self._retreat else self._stride(sensed, 1.0), left)
        back = 0.0 if self._retreat else BACK * sensed.z * higher / abs(sensed.e)
        end = (here[0] + self._side * back, here[1] + higher)
        warned = "" if self._retreat else self._warning(sensed)
        # if the lever shortens upwards, the body leans on the top
        hard = warned == _HARD or self._predicted_force(sensed, higher) > RAISED_SHARE * self._limits.force
        presses = hard and (self._slope < 0.0 or not self._followed)
        falling = presses or left < LEAST_STEP_M or (known <= 0.0 and warned in (_LEVER, _LIGHT))
        self._retreat = False
        if self._blocked(end, sensed.e) and not falling:
            end = (here[0], end[1])
        if falling or end[1] > self._limits.angles[1][1]:
            self._ends.add((self._side, "high"))
            return self._finish_side(sensed) or self._enter("lift", "this side is done: lifted off")
        return self._move_to(here, end, DOWN_M_S)

    def _finish_side(self, sensed: Touching) -> DragStep | None:
        """Return "done" if the exploration is complete or given up; otherwise the other side is next."""
        self._next_side = -self._side
        self._rounds += self.coverage >= 1.0
        if self._known(sensed):
            return DragStep("done", reason="both sides were followed from end to end, and the outline is known")
        if self._rounds > ROUNDS:
            return DragStep("done", reason="both sides were followed repeatedly, but the outline is not determined")
        return None

    def _known(self, sensed: Touching) -> bool:
        """True if coverage and the outline's band meet the goal."""
        most = math.inf if self._goal.band_mm is None else self._goal.band_mm * 1e-3
        return self.coverage >= self._goal.coverage and math.isfinite(sensed.band) and sensed.band <= most

    def _roll(self, sensed: Touching, here: Angles) -> DragStep:  # noqa: ARG002
        """Unused with a rigid gripper."""
        return WAIT

    def _stride(self, sensed: Touching, sense: float) -> float:
        """Step of height (m) in direction `sense`: small against e and against the rate at which e² falls."""
        falling = -self._slope * sense  # of e² per height
        stride = min(STEP_M, STEP_SHARE * abs(sensed.e))
        room = sensed.e**2 - self._least_lever**2
        return min(stride, max(0.5 * room / falling, LEAST_STEP_M)) if falling > 0.0 else stride

    def _height_left(self, sensed: Touching) -> float:
        """Height (m) available for any body: d(e²)/dz is at most twice the pivot's distance from the body's middle."""
        return max(sensed.e**2 - self._least_lever**2, 0.0) / (2.0 * FARTHEST_M)

    @property
    def _least_lever(self) -> float:
        """|e| (m) where it turns back; upwards the slope of e² is bounded and only the force limits."""
        return LEAST_LEVER_M if self.phase == "up" else max(LEAST_LEVER_M, LEVER_SHARE * self._largest_lever)

    def _learn(self, sensed: Touching) -> None:
        square = sensed.e**2
        self._largest_lever = max(self._largest_lever, abs(sensed.e))
        if self._last_step is not None and abs(sensed.z - self._last_step[0]) > 1e-4:
            slope = (square - self._last_step[1]) / (sensed.z - self._last_step[0])
            self._slope += (0.6 if self._followed else 1.0) * (slope - self._slope)
            self._followed = True
        self._last_step = sensed.z, square
        self._mu = max(self._mu, self._least_friction(sensed))
        self._torque = max(FADING * self._torque, sensed.force * abs(sensed.e))  # a NaN force keeps the fading value
        self._torque_lost = max(self._last_least_torque - self._least_torque, 0.0)
        self._last_least_torque, self._least_torque = self._least_torque, math.inf

    def _least_friction(self, sensed: Touching) -> float:
        """Return a lower bound of μ from the rise of the force as the arm came to rest; 0 if it did not rise.

        Trailing friction helps: the force is τ/(|e| + μz) in motion and τ|e|/(e² − μ²z²) at rest (`_predicted_force`).
        """
        torque = sensed.force * abs(sensed.e)
        if not (0.0 < self._least_torque < torque and sensed.z > 0.0):
            return 0.0
        return abs(sensed.e) / sensed.z * (1.0 - self._least_torque / torque)

    def _predicted_force(self, sensed: Touching, dz: float) -> float:
        """Predict the force (N) at rest, raised by dz (m); infinite where the body jams.

        The pad's torque τ about the pivot hardly changes. On a pad that vibrates under a body at rest friction acts in
        both directions equally often, so the mean force is τ|e|/(e² − μ²z²) (docs/theory/vibration.md, one contact).
        Torques measured in motion are smaller, so the largest of the last steps is used.
        """
        e = self._lever(sensed, dz)
        before, after = self._jam_margin(abs(sensed.e), sensed.z), self._jam_margin(e, sensed.z + dz)
        return (
            max(self._torque, sensed.force * abs(sensed.e)) / e * before / after
            if min(before, after) > 0.0
            else math.inf
        )

    def _jam_margin(self, e: float, z: float) -> float:
        """1 − (μz/e)² for a lever e (m) and a height z (m); friction jams the body where it reaches 0."""
        return 1.0 - (self._mu * z / e) ** 2

    def _remaining_force(self, sensed: Touching, dz: float) -> float:
        """Predict the smallest force (N) in motion, raised by dz (m).

        The torque falls linearly as the centre of mass approaches the vertical below the pivot, where the body swings
        off the pad.
        """
        return (self._last_least_torque - self._torque_lost) / self._lever(sensed, dz)

    def _lever(self, sensed: Touching, dz: float) -> float:
        """Predict |e| (m), raised by dz (m)."""
        return math.sqrt(max(sensed.e**2 + self._slope * dz, (0.5 * LEAST_LEVER_M) ** 2))

    def _warning(self, sensed: Touching) -> str:
        """Return why the body must not be lowered farther; empty if it may."""
        if not math.isfinite(sensed.e):
            return ""
        if not math.isfinite(sensed.force):  # the pad is saturated
            return _HARD
        if sensed.e * self._side < self._least_lever:
            return _LEVER
        late = self._predicted_force(sensed, -FORCE_DELAY_S * DOWN_M_S)
        if sensed.force > FORCE_SHARE * self._limits.force or late > PREDICTED_SHARE * self._limits.force:
            return _HARD
        if sensed.force < LEAST_FORCE_N:
            return _LIGHT
        return ""

    def _blocked(self, end: Angles, e: float) -> str:
        """Return why a step must not end there; empty if it may."""
        (x0, x1), (z0, _) = self._limits.angles
        if end[1] < z0:
            return "the gripper is at its lowest height"
        inside = PAD_END_M < end[0] + e < self._limits.pad_length - PAD_END_M
        return "" if x0 <= end[0] <= x1 and inside else "the pad ends here"

    def _count_turn_back(self, why: str) -> None:
        self.turned_back[why] = self.turned_back.get(why, 0) + 1

    def _enter(self, phase: Phase, reason: str) -> DragStep:
        self.phase = phase
        return DragStep("halt", reason=reason)

    def _move_to(self, here: Angles, end: Angles, speed: float, reason: str = "") -> DragStep:
        (x0, x1), (z0, z1) = self._limits.angles
        end = (min(max(end[0], x0), x1), min(max(end[1], z0), z1))
        dx, dz = abs(end[0] - here[0]), abs(end[1] - here[1])
        most = 0.9 * self._limits.rate
        duration = max(
            _LEAST_S,
            PEAK_RATE * max(dz / min(speed, most), dx / most),
            math.sqrt(PEAK_ACCELERATION * max(dx, dz) / (0.5 * self._limits.acceleration)),
        )
        return DragStep("move", Move(here, end, duration), reason)


_LEVER, _LIGHT = "the pivot is nearly above the contact", "the body hardly presses any more"
_HARD = "the force comes near its limit"
