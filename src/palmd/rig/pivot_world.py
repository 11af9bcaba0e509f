"""The emulated rig of a pivoting grasp in one pure object, as `rig.world.World` is that of two palms.

A rigid gripper: while the body touches the pad, the pivot's height says how it stands, and constraint forces what the
pad feels (`rig.pivot.Grasp`). It leaves the pad where the force would have to pull; beyond the lowest height, or where
friction holds it, it is jammed. What has left the pad is in a hand: it waits until the gripper has come up, tilts the
body towards the nearer end of the pad and lets go when it touches again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armlink import CONTROLLER_NEWLINE, LineReader
from palmd.pivot_config import PivotConfig
from palmd.quantities import PIVOT_BODY, PIVOT_TRUTH
from palmd.rig.actuators import Utterance
from palmd.rig.arm import Servo
from palmd.rig.controller import BREAK_RECEIVED, CYCLE_S, ArmLimits, Controller
from palmd.rig.fault_injection import FaultOrder, PortName, Switchboard
from palmd.rig.line import Wire
from palmd.rig.pads import GOOD_PADS, PadEmulator, PadOptions, Press
from palmd.rig.pivot import Axis, Grasp
from palmd.rig.shapes import Kind, random_body
from palmd.rig.tally import Decoder, DeviceTally, HostLines
from palmd.rig.world import EMULATORS, STEP_S

PAD, ARM = "pad1", "arm"
PORTS: tuple[PortName, ...] = (PAD, ARM)
FARTHEST_M, NEAREST_M = 9e-3, 5e-3  # of the pivot from the centre of mass
MASS_KG = (0.04, 0.12)
JAMMED_N = 20.0  # what the arm presses with at most, and takes for a jam
LEVER_M = 3e-4  # below which the body is jammed
TURNED_S, CLEAR_M = 1.0, 2e-3  # what a hand takes to tilt it, and how high it must have been lifted
TILTED = 0.75  # share of the largest lever on a side that the hand tilts it to, or more
_ENCODER_NOISE_M = 1.5e-5
_MARGIN_M, _ROOM = 5e-3, 2.0
_BELOW_M = 1e-3  # its highest place, where the arm stands before anybody has commanded it
_FINGER_M = 0.045
_STEPS_A_TURN = 1440


class PivotWorld:
    """See the module. Times are seconds on one clock of the caller's choice, never running backwards."""

    ports = PORTS
    topics = (PIVOT_TRUTH, PIVOT_BODY)

    def __init__(
        self, config: PivotConfig, seed: int, *, kind: Kind = "rig", pad_options: PadOptions = GOOD_PADS, t: float = 0.0
    ) -> None:
        """The gripper at rest in the middle over the pad, as high as it may be; a random body hangs from it."""
        self.config, self.seed, self.kind = config, seed, kind
        self.mischief = Switchboard()
        self.objects = self.contact_losses = self.jams = 0
        self.most_force = 0.0
        self._rng = np.random.default_rng(seed)
        self._t_start, self._steps = t, 0
        self._arm = PivotArm(config, self._rng)
        pad = config.pads.palm1
        self._pad: PadEmulator = EMULATORS[type(pad)](pad, pad_options, _exact, self._rng, t)
        self.bauds: dict[PortName, int | None] = {PAD: self._pad.baud, ARM: self._arm.baud}
        self._out = {port: Wire(baud or 10_000_000) for port, baud in self.bauds.items()}
        self._said = {port: DeviceTally() for port in PORTS}
        self._pad_length = pad.length_mm * 1e-3
        self._side, self._left_at = 1.0, -math.inf
        self._psi = self._force = 0.0
        self._tilt: float | None = None  # where the hand holds the body; None before it does
        self._t_tilted = t
        self._draw_body()

    # -- the outside --------------------------------------------------------------------------------------

    @property
    def t(self) -> float:
        """The time the world stands at (s)."""
        return self._t_start + self._steps * STEP_S

    def advance(self, t: float) -> dict[PortName, bytes]:
        """Lives on to t (s) and returns what has come out of each port on the way."""
        for _ in range(int((t - self.t) / STEP_S + 1e-6)):
            self._step()
        return {port: self._out[port].take(t, self.mischief.strength("burst", port)) for port in PORTS}

    def receive(self, port: PortName, data: bytes, late_s: float = 0.0) -> None:  # noqa: ARG002
        """Takes what the host has just written to a port; a pad listens to nothing."""
        if port == ARM:
            self._arm.receive(data, self.mischief.spoil(ARM, data, self._rng), self.t)

    def opened(self, port: PortName) -> None:
        """The host has opened a port; a pad with a handshake tells its identity, as `World.opened`."""
        if port == PAD:
            for identity, after_s in self._pad.greeting():
                self._said[port].take(identity, identity, messages=0)
                self._out[port].send(identity, self.t + after_s)

    def listener(self, port: PortName) -> Decoder:
        """A new decoder of what comes out of a port."""
        return self._arm.listener() if port == ARM else self._pad.listener()

    def unplugged(self, port: PortName) -> bool:
        """Whether mischief has pulled the plug of the port."""
        return self.mischief.strength("unplug", port) > 0.0

    def new_object(self) -> None:
        """A hand exchanges the body."""
        self._draw_body()

    def truth(self) -> dict[str, Any]:
        """What is really there at `t`, as `rig/pivot` tells it."""
        x, z = self._arm.place(self.t)
        e = self.grasp.offset(self._psi) if self._touching else math.nan
        return {
            "x_m": x[0],
            "z_m": z[0],
            "s1_m": x[0] + e,
            "e_m": e,
            "psi_rad": self._psi,
            "omega0_rad_s": -z[1] / e if self._touching else 0.0,
            "f1_n": self._force if self._touching else 0.0,
            "touch1": self._touching,
            "object": self.objects,
            "arm_state": str(self._arm.state),
        }

    def object_truth(self) -> dict[str, Any]:
        """The body itself, as `rig/pivot_object` tells it."""
        grasp, theta = self.grasp, np.arange(360, dtype=np.float64) * (math.tau / 360)
        px, py = grasp.pivot
        h = grasp.body.support.sample(theta) - px * np.cos(theta) - py * np.sin(theta)
        return {
            "object": self.objects,
            "shape": grasp.body.shape,
            "theta_rad": theta.tolist(),
            "hP_m": h.tolist(),
            "com_m": [-px, -py],
            "mass_kg": grasp.body.mass,
            "mu": grasp.mu,
        }

    def status(self) -> dict[str, Any]:
        """Counts for end-to-end checks."""
        return {
            "t_s": self.t - self._t_start,
            "clock_s": self.t,
            "seed": self.seed,
            "kind": self.kind,
            "arm_state": str(self._arm.state),
            "object": self.objects,
            "touching": self._touching,
            "contact_losses": self.contact_losses,
            "jams": self.jams,
            "most_force_n": self.most_force,
            "mischief": self.mischief.names(),
            f"{PAD}_packets": self._pad.packets,
            **{f"{port}_{what}": n for port, said in self._said.items() for what, n in said.as_dict().items()},
            **{f"{port}_bytes_waiting": wire.waiting for port, wire in self._out.items()},
            **self._arm.status(),
        }

    # -- one step -----------------------------------------------------------------------------------------

    def _step(self) -> None:
        """Half a millisecond of everything."""
        self._steps += 1
        t = self.t
        x, z = self._arm.place(t)
        if self._touching:
            self._go_on(x, z)
        else:
            self._wait(t, x, z)
        for begun in self.mischief.update(t):
            self._play(*begun)
        for said in self._arm.step(t):
            self._say(ARM, said.data, said.t, said.messages)
        if t >= self._pad.due:
            self._say(PAD, self._pad.report(t, self._presses(x)), t)

    def _go_on(self, x: Axis, z: Axis) -> None:
        """The body follows the pivot's height along its side of the dead centre, and its force follows from that."""
        grasp, psi = self.grasp, self._psi
        for _ in range(20):
            e, off = grasp.offset(psi), z[0] - grasp.height(psi)
            if e * self._side < LEVER_M or abs(off) < 1e-12:
                break
            psi -= min(max(off / e, -0.05), 0.05)  # dz/dψ = −e
        e = grasp.offset(psi)
        if e * self._side < LEVER_M:
            if z[0] > grasp.height(psi):
                self._leave()  # higher than it is
            else:
                self._jam()
            return
        omega = -z[1] / e
        h2 = grasp.body.support.at(-0.5 * math.pi - psi)[2] - grasp.arm(psi)[1]
        alpha = (h2 * omega * omega - z[2]) / e
        force = grasp.torque_left(psi, omega, alpha, x, z)[1]
        lever = (e - grasp.friction(x[1] + omega * z[0]) * z[0]) * self._side
        self._psi = psi
        if lever < LEVER_M:
            self._jam()
        elif not force > 0.0:
            self._leave()
        else:
            self._jammed = False
            self._press(force)
        if self._touching and not 0.0 < x[0] + e < self._pad_length:
            self._leave()

    def _press(self, force: float) -> None:
        self._force = min(force, JAMMED_N)
        self.most_force = max(self.most_force, self._force)

    def _jam(self) -> None:
        """It cannot turn: the arm presses as hard as it can."""
        self.jams += not self._jammed
        self._jammed = True
        self._press(JAMMED_N)

    def _leave(self) -> None:
        self.contact_losses += 1
        self._touching, self._force, self._tilt = False, 0.0, None
        self._left_at = self._arm.place(self.t)[1][0]

    def _wait(self, t: float, x: Axis, z: Axis) -> None:
        """The hand tilts the body once the gripper is high enough, and lets go when it touches."""
        side = 1.0 if x[0] > 0.5 * self._pad_length else -1.0
        if self._tilt is None or side != self._side:
            if z[0] > self._left_at + CLEAR_M:
                self._side, self._tilt, self._t_tilted = side, self._tilted(side), t + TURNED_S
        elif t >= self._t_tilted and z[0] <= self.grasp.height(self._tilt):
            self._touching, self._psi = True, self._tilt

    def _tilted(self, side: float) -> float:
        """An orientation on this side of the dead centre, well away from it."""
        angles = np.linspace(-math.pi, math.pi, _STEPS_A_TURN, endpoint=False)
        levers = np.array([self.grasp.offset(a) for a in angles]) * side
        heights = np.array([self.grasp.height(a) for a in angles])
        there = np.flatnonzero((levers > TILTED * levers.max()) & (heights >= heights[levers.argmax()]))
        tilt = float(angles[there[int(self._rng.integers(len(there)))]])
        nearest: float = tilt + math.tau * round((self._psi - tilt) / math.tau)
        return nearest

    def _presses(self, x: Axis) -> list[Press]:
        presses = [Press(x[0] + self.grasp.offset(self._psi), self._force)] if self._touching else []
        finger = self.mischief.strength("touch", PAD)
        return [*presses, Press(_FINGER_M, finger)] if finger > 0.0 else presses

    def _say(self, port: PortName, data: bytes, t: float, messages: int = 1) -> None:
        if data:
            wire = self._out[port]
            late = self.mischief.strength("late", port) - wire.byte_s
            spoilt = self.mischief.spoil(port, data, self._rng)
            self._said[port].take(data, spoilt, messages)
            wire.send(spoilt, t + late)

    def _draw_body(self) -> None:
        rng = self._rng
        body = replace(random_body(self.kind, rng), mass=float(rng.uniform(*MASS_KG)))
        far, angle = float(rng.uniform(NEAREST_M, FARTHEST_M)), float(rng.uniform(0.0, math.tau))
        self.grasp = Grasp(
            body,
            (far * math.cos(angle), far * math.sin(angle)),
            mu=float(rng.uniform(0.05, 0.2)),
            dither=float(rng.uniform(8e-3, 20e-3)),
            damping=float(rng.uniform(1e-5, 4e-5)),
        )
        self.objects += 1
        self._touching = self._jammed = False
        self._psi = self._force = 0.0
        self._side, self._left_at = 1.0, -math.inf
        self._tilt, self._t_tilted = None, self.t

    def _play(self, order: FaultOrder, begins: bool) -> None:
        self._arm.play(order, begins)
        if order.name == "swap" and begins:
            self.new_object()
        elif order.name == "lift" and begins and self._touching:
            self._leave()


class PivotArm:
    """The Adept arm and its controller's program, its tool the pivot. Pure."""

    def __init__(self, config: PivotConfig, rng: np.random.Generator) -> None:
        self.baud = config.arm.baud
        self._rng, arm = rng, config.arm
        self._base = (arm.base_x_mm * 1e-3, arm.base_y_mm * 1e-3)
        self._turn = complex(math.cos(math.radians(arm.base_yaw_deg)), math.sin(math.radians(arm.base_yaw_deg)))
        (x0, x1), (z0, z1) = ((low * 1e-3, high * 1e-3) for low, high in config.limits.ranges_mm)
        start = self._pose(0.5 * (x0 + x1), z1 - _BELOW_M)
        corners = [self._pose(x, z) for x in (x0, x1) for z in (z0, z1)]
        xs, ys = [each.x_m for each in corners], [each.y_m for each in corners]
        limits = ArmLimits(
            min(xs) - _MARGIN_M,
            max(xs) + _MARGIN_M,
            min(ys) - _MARGIN_M,
            max(ys) + _MARGIN_M,
            v_max=_ROOM * config.limits.speed_mm_s * 1e-3,
            a_max=2.0 * _ROOM * max(config.limits.acceleration_mm_s2, 1000.0) * 1e-3,
        )
        self._controller = Controller(limits, start, self.baud, _nobody)
        self._servos = [Servo(r, 0.016) for r in (start.x_m, start.y_m, start.t_rad)]
        self._steps_per_cycle = round(CYCLE_S / STEP_S)
        self._steps, self._next_cycle = 0, int(rng.integers(self._steps_per_cycle))
        self._in, self._host_lines = Wire(self.baud), HostLines(self.baud)

    @property
    def state(self) -> ArmState:
        """The controller's."""
        return self._controller.state

    def place(self, t: float) -> tuple[Axis, Axis]:
        """Position, velocity, acceleration of the pivot along x and z."""
        along_x, along_y = (servo.at(t) for servo in self._servos[:2])
        x, vx, ax = (complex(a, b) * self._turn for a, b in zip(along_x, along_y, strict=True))
        bx, by = self._base
        return (bx + x.real, vx.real, ax.real), (by + x.imag, vx.imag, ax.imag)

    def _pose(self, x: float, z: float) -> Pose:
        """Where the tool is, in arm coordinates, when the pivot is at x along and z over the pad (m)."""
        there = complex(x - self._base[0], z - self._base[1]) / self._turn
        return Pose(there.real, there.imag, 0.0)

    def receive(self, heard: bytes, spoilt: bytes, t: float) -> None:
        """What the host has written, as the line leaves it."""
        self._host_lines.take(heard, spoilt, t)
        self._in.send(spoilt, t)

    def step(self, t: float) -> Sequence[Utterance]:
        """The controller hears what has arrived and runs its cycles; the servos follow the path of each for 16 ms."""
        self._steps += 1
        said = []
        if arrived := self._in.take(t):
            said.append(_said(self._controller.feed(arrived, t, self._actual_pose(t)), t))
        if self._steps >= self._next_cycle:
            self._next_cycle += self._steps_per_cycle
            said.append(_said(self._controller.cycle(t, self._actual_pose(t)), t))
            path = self._controller.path
            for servo, goal in zip(self._servos, (path.x_m, path.y_m, path.t_rad), strict=True):
                servo.follow(t, (goal - servo.goal(t)) / CYCLE_S)
        return said

    def play(self, order: FaultOrder, begins: bool) -> None:
        """What is done to the controller."""
        controller = self._controller
        match order.name, begins:
            case "estop", True:
                controller.press_emergency_stop()
            case "power_off", True:
                controller.switch_power_off()
            case "manual", True:
                controller.switch_to_manual(controller.path)
            case (("estop" | "power_off" | "manual"), False):
                controller.make_ready()
            case "break", True:
                controller.line_fault(BREAK_RECEIVED)

    def status(self) -> dict[str, Any]:
        """The controller's counts and those of what it heard."""
        return {
            "crc_errors": self._controller.reader.counters.crc_errors,
            **{f"host_{what}": n for what, n in self._host_lines.as_dict().items()},
            **self._controller.counters.as_dict(),
        }

    def listener(self) -> LineReader:
        """Of its lines."""
        return LineReader(self.baud)

    def _actual_pose(self, t: float) -> Pose:
        x, y, angle = (servo.at(t)[0] for servo in self._servos)
        noise = self._rng.normal(0.0, _ENCODER_NOISE_M, 2)
        return Pose(x + float(noise[0]), y + float(noise[1]), angle)


def _said(data: bytes, t: float) -> Utterance:
    return Utterance(data, t, data.count(CONTROLLER_NEWLINE))


def _nobody(pose: Pose, t: float) -> None:
    del pose, t


def _exact(s: float, force: float) -> float:
    del s, force
    return 0.0
