"""The whole emulated rig in one pure object: body, palms, arm, controller, pads, lines and mischief.

`advance(t)` gives the bytes that have come out of each port by t, `receive` takes the host's. Nothing here
reads a clock or opens a port, so the same world runs behind pseudo-terminals in real time and, faster, in one
process with the daemon's pure step. The same seed and the same bytes in give the same bytes out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection
from typing import Any

import numpy as np

from palmd.config import AdeptConfig, Config, Drawn, PadsConfig, RigConfig, VersaPadConfig
from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armlink import CONTROLLER_NEWLINE
from palmd.events import Joints, PalmMotion
from palmd.rig.arm import Linkage, Servo, turn
from palmd.rig.controller import BREAK_RECEIVED, CYCLE_S, ArmLimits, Controller
from palmd.rig.fault_injection import PADS, PORTS, FaultOrder, PortName, Switchboard
from palmd.rig.hand import Hand
from palmd.rig.imperfections import configured, perfect
from palmd.rig.line import Wire
from palmd.rig.marble import Marble
from palmd.rig.pads import GOOD_PADS, PadEmulator, PadOptions, Press, versapads
from palmd.rig.plant import AS_ASSUMED, Hinge, Plant, PlantOptions, random_surface, stable_poses
from palmd.rig.roller import Roller, RollerKind
from palmd.rig.setpoint_checker import SetPointChecker
from palmd.rig.shapes import Body, Kind, random_body
from palmd.rig.tally import HostLines, Said
from palmd.system.mechanism import JOINT_RATES, JOINTS, PALMS

STEP_S = 5e-4
_STEPS_PER_CYCLE = round(CYCLE_S / STEP_S)
_HOME_DEG = (45.0, 90.0)
_ENCODER_NOISE_M = 1.5e-5
_WORKSPACE_MARGIN_M = 5e-3
_ROOM = 1.2  # what the controller allows beyond what the palms' limits need
_MOST_PHI12_DEG = 172.0
_AWAY_S = 1.0  # how long a hand takes to put another object on the palms
_PAD_END_M = 3e-3
_FINGER_M = 0.045
_JOG_DEG = 4.0
_IDENTITY = b"VPEMU1\r"
_IDENTITY_S = 0.5


def default_config(imperfections: Drawn = "none") -> Config:
    """The defaults, for a rig without a configuration: exactly as described, or as calibration leaves one."""
    pads = PadsConfig(**{f"palm{palm}": VersaPadConfig(port=pad) for palm, pad in zip(PALMS, PADS, strict=True)})
    config = Config(rig=RigConfig(imperfections=imperfections), pads=pads, arm=AdeptConfig(port="arm"))
    return perfect(config) if imperfections == "none" else config


class World:
    """See the module. Times are seconds on one clock of the caller's choice, never running backwards."""

    def __init__(
        self,
        config: Config,
        seed: int,
        *,
        kind: Kind = "rig",
        options: PlantOptions = AS_ASSUMED,
        pad_options: PadOptions = GOOD_PADS,
        marbles: Collection[PortName] = (),
        body: Body | None = None,
        roller: RollerKind | None = None,
        by_hand: bool = False,
        t: float = 0.0,
    ) -> None:
        """At rest at t (s), a random body of the kind, or `body`, in a stable pose.

        The configuration's `rig.imperfections` say how far the rig is off from the rest of it. With `marbles` there is
        no body on the palms: a marble rolls over each of these pads instead. With `roller` it is one that rolls down a
        gently sloping palm; with `by_hand` the arm is in manual mode and a hand swings the empty palms.
        """
        self.config, self.seed, self.kind = config, seed, kind
        self.mischief = Switchboard()
        self.contact_losses = self.falls = self.objects = self.jams = 0
        self._options, self._body = options, body
        self.imperfections = configured(config, seed)
        self._rng = np.random.default_rng(seed)
        self._t_start, self._steps = t, 0
        self._linkage = Linkage.from_config(config)
        self._home = _home(config)
        home = self._linkage.pose(*self._home)
        self._judge = SetPointChecker(self._linkage, config.limits)
        self._controller = Controller(arm_limits(config), home, config.arm.baud, self._hear_setpoint)
        lag = 0.016 + options.lag_s
        self._servos = [Servo(r, lag) for r in (home.x_m, home.y_m, home.t_rad)]
        self._next_cycle = int(self._rng.integers(_STEPS_PER_CYCLE))
        self._palms = self._palms_at(t)
        self._pad_configs: dict[PortName, VersaPadConfig] = dict(zip(PADS, versapads(config), strict=True))
        self._pads: dict[PortName, PadEmulator] = {
            name: PadEmulator(pad, pad_options, off.reading_error_m, self._rng, t)
            for (name, pad), off in zip(self._pad_configs.items(), self.imperfections.pads, strict=True)
        }
        self._marbles = {
            name: Marble(pad.length_mm * 1e-3, np.random.default_rng((seed, number)))
            for number, (name, pad) in enumerate(self._pad_configs.items(), 1)
            if name in marbles
        }
        self._roller = roller and Roller(roller, config.rig.gravity_m_s2, self._reach(), np.random.default_rng(seed))
        self._hand = Hand(config.limits, self._home) if by_hand else None
        self.bauds: dict[PortName, int] = {name: pad.baud for name, pad in self._pad_configs.items()}
        self.bauds["arm"] = config.arm.baud
        self._out: dict[PortName, Wire] = {port: Wire(self.bauds[port]) for port in PORTS}
        self._in = Wire(config.arm.baud)
        self._said: dict[PortName, Said] = {port: Said() for port in PORTS}
        self._host_lines = HostLines(config.arm.baud)
        self._next_delivery: dict[PortName, float] = dict.fromkeys(PORTS, -math.inf)
        self._t_place: float | None = None
        self._touching = (False, False)
        self._draw_body()
        self._put_on_palms()

    # -- the outside --------------------------------------------------------------------------------------

    @property
    def t(self) -> float:
        """The time the world stands at (s)."""
        return self._t_start + self._steps * STEP_S

    def advance(self, t: float) -> dict[PortName, bytes]:
        """Lives on to t (s) and returns what has come out of each port on the way."""
        for _ in range(int((t - self.t) / STEP_S + 1e-6)):
            self._step()
        return {port: self._delivered(port, t) for port in PORTS}

    def receive(self, port: PortName, data: bytes) -> None:
        """Takes what the host has just written to a port; a pad listens to nothing."""
        if port == "arm":
            spoilt = self.mischief.spoil("arm", data, self._rng)
            self._host_lines.take(data, spoilt, self.t)
            self._in.send(spoilt, self.t)

    def opened(self, port: PortName) -> None:
        """The host has opened a port. For a pad that starts with a handshake this stands for its breaks.

        A pseudo-terminal cannot carry a break, so the identity is sent as long after the opening as it would
        be after the break, once for each.
        """
        if port in self._pad_configs:
            breaks = {"none": 0, "break": 1, "break_twice": 2}[self._pad_configs[port].handshake]
            for number in range(breaks):
                self._said[port].take(_IDENTITY, _IDENTITY, messages=0)
                self._out[port].send(_IDENTITY, self.t + (number + 1) * _IDENTITY_S)

    def unplugged(self, port: PortName) -> bool:
        """Whether mischief has pulled the plug of the port."""
        return self.mischief.strength("unplug", port) > 0.0

    def new_object(self) -> None:
        """A hand takes the object away and, a second later, puts another one on the palms."""
        self.plant.take_away()
        self._draw_body()
        self._t_place = self.t + _AWAY_S

    def truth(self) -> dict[str, Any]:
        """What is really there at `t`, as `rig/truth` tells it."""
        q, palms = self.plant.state, self._true_palms
        contacts = tuple(zip(PALMS, self.plant.contacts(), strict=True))
        return {
            "psi_rad": q.psi,
            "omega0_rad_s": q.omega0,
            **{f"r{palm}_m": r for palm, r in zip(PALMS, self.plant.radii(), strict=True)},
            **{f"s{palm}_m": contact.s for palm, contact in contacts},
            **{f"{joint}_rad": angle for joint, angle in zip(JOINTS, palms.angles, strict=True)},
            **{f"{joint}_rad_s": rate for joint, rate in zip(JOINT_RATES, palms.rates, strict=True)},
            "com_x_m": q.x,
            "com_y_m": q.y,
            **{f"f{palm}_n": contact.force for palm, contact in contacts},
            **{f"contact{palm}": contact.touching for palm, contact in contacts},
            "object": self.objects,
            "arm_state": str(self._controller.state),
        }

    def object_truth(self) -> dict[str, Any]:
        """The body itself, as `rig/object` tells it; h on the normals of a frame that turns by psi_rad."""
        body, surface = self.plant.body, self.plant.surface
        theta = np.arange(360, dtype=np.float64) * (math.tau / 360)
        return {
            "object": self.objects,
            "kind": self.kind,
            "shape": body.shape,
            "theta_rad": theta.tolist(),
            "h_m": body.support.sample(theta).tolist(),
            "rho_m": body.rho,
            "mass_kg": body.mass,
            "mu": surface.mu,
            "dither_m_s": surface.dither,
            "damping_m2_s": surface.damping,
        }

    def status(self) -> dict[str, Any]:
        """Counts for end-to-end checks."""
        return {
            "t_s": self.t - self._t_start,
            "clock_s": self.t,
            "seed": self.seed,
            "kind": self.kind,
            "arm_state": str(self._controller.state),
            "object": self.objects,
            "on_palms": not self.plant.fallen,
            "contact_losses": self.contact_losses,
            "falls": self.falls,
            "jams": self.jams,
            "mischief": self.mischief.names(),
            **{f"{name}_packets": pad.packets for name, pad in self._pads.items()},
            "crc_errors": self._controller.reader.counters.crc_errors,
            **{f"{port}_{what}": n for port, said in self._said.items() for what, n in said.as_dict().items()},
            **{f"{port}_bytes_waiting": wire.waiting for port, wire in self._out.items()},
            **{f"host_{what}": n for what, n in self._host_lines.as_dict().items()},
            **self._controller.counters.as_dict(),
            **self._judge.as_dict(),
        }

    # -- one step -----------------------------------------------------------------------------------------

    def _step(self) -> None:
        """Half a millisecond of everything."""
        t = self.t
        middle, end = self._palms_at(t + 0.5 * STEP_S), self._palms_at(t + STEP_S)
        was_on = not self.plant.fallen
        true_palms = self.imperfections.true_palms
        self.plant.advance(true_palms(middle), true_palms(end), STEP_S)
        self._palms = end
        self._steps += 1
        t = self.t
        self._note_contacts(was_on)
        for begun in self.mischief.update(t):
            self._play(*begun)
        if self._t_place is not None and t >= self._t_place:
            self._put_on_palms()
        if self._roller:
            self._roller.advance(t, self._true_palms)
        arrived = self._in.take(t)
        if arrived:
            self._say("arm", self._controller.feed(arrived, t, self._actual_pose(t)), t)
        if self._steps >= self._next_cycle:
            self._arm_cycle(t)
        for name, pad in self._pads.items():
            if t >= pad.due:
                late = max(self.imperfections.pads[PADS.index(name)].lag, 0.0)
                self._say(name, pad.report(t, self._presses(name)), t + late)

    def _arm_cycle(self, t: float) -> None:
        """The controller's cycle; the servos then follow the path it lays for the next 16 ms."""
        self._next_cycle += _STEPS_PER_CYCLE
        if self._hand:
            self._controller.lead(self._linkage.pose(*self._hand.at(t - self._t_start)))
        self._say("arm", self._controller.cycle(t, self._actual_pose(t)), t)
        path = self._controller.path
        along_x, along_y, tool = self._servos
        along_x.follow(t, (path.x_m - along_x.goal(t)) / CYCLE_S)
        along_y.follow(t, (path.y_m - along_y.goal(t)) / CYCLE_S)
        tool.follow(t, turn(path.t_rad - tool.goal(t)) / CYCLE_S)

    def _say(self, port: PortName, data: bytes, t: float) -> None:
        """Sends what was measured at t (s); the first byte, which only says what follows, arrives then."""
        if data:
            wire = self._out[port]
            late = self.mischief.strength("late", port) - wire.byte_s
            spoilt = self.mischief.spoil(port, data, self._rng)
            self._said[port].take(data, spoilt, data.count(CONTROLLER_NEWLINE) if port == "arm" else 1)
            wire.send(spoilt, t + late)

    def _delivered(self, port: PortName, t: float) -> bytes:
        burst = self.mischief.strength("burst", port)
        if burst > 0.0:
            if t < self._next_delivery[port]:
                return b""
            self._next_delivery[port] = t + burst
        return self._out[port].take(t)

    def _actual_pose(self, t: float) -> Pose:
        """The arm's pose as its encoders tell it."""
        x, y, angle = (servo.at(t)[0] for servo in self._servos)
        noise = self._rng.normal(0.0, _ENCODER_NOISE_M, 2)
        return Pose(x + float(noise[0]), y + float(noise[1]), turn(angle))

    def _hear_setpoint(self, pose: Pose, t: float) -> None:
        x, y, angle = (servo.at(t)[0] for servo in self._servos)
        holds = self._controller.state is ArmState.HOLD
        self._judge.hear(pose, t, Pose(x, y, turn(angle)) if holds else None)

    @property
    def _true_palms(self) -> PalmMotion:
        return self.imperfections.true_palms(self._palms)

    def _palms_at(self, t: float) -> PalmMotion:
        """As the arm's pose tells them."""
        x, y = self._servos[0].at(t), self._servos[1].at(t)
        palms = self._linkage.motion(x, y)
        if palms is None:  # the linkage is at its stop: the palms stay where they were
            self.jams += 1
            return PalmMotion.at_rest(self._palms.angles)
        return palms

    # -- the body and the hands that move it --------------------------------------------------------------

    def _draw_body(self) -> None:
        rig = self.config.rig
        base = (rig.base_mm[0] * 1e-3, rig.base_mm[1] * 1e-3)
        self.plant = Plant(
            self._body or random_body(self.kind, self._rng),
            Hinge("arc", rig.palm1_length_mm * 1e-3, base),
            random_surface(self.kind, self._rng),
            options=self._options,
            imperfections=self.imperfections,
            gravity=rig.gravity_m_s2,
            reach=self._reach(),
        )
        self.objects += 1

    def _reach(self) -> tuple[float, ...]:
        return tuple(pad.length_mm * 1e-3 for pad in self.config.pads.each())

    def _put_on_palms(self) -> None:
        """Puts the body in one of its stable poses on the pads; where there is none, tries again later."""
        if self._marbles or self._roller or self._hand:
            self._t_place = None
            return
        poses = stable_poses(self.plant.body, self._true_palms)
        for i in self._rng.permutation(len(poses)):
            self.plant.place(self._true_palms, poses[i])
            contacts = self.plant.contacts()
            if all(
                contact.touching and _PAD_END_M < contact.s < reach - _PAD_END_M
                for contact, reach in zip(contacts, self._reach(), strict=True)
            ):
                self._t_place = None
                self._touching = (True, True)
                return
        self.plant.take_away()
        self._t_place = self.t + _AWAY_S

    def _note_contacts(self, was_on: bool) -> None:
        touching = self.plant.touching
        self.contact_losses += sum(was and not now for was, now in zip(self._touching, touching, strict=True))
        self._touching = touching
        self.falls += was_on and self.plant.fallen

    def _presses(self, name: PortName) -> list[Press]:
        if name in self._marbles:
            presses = self._marbles[name].presses(self.t - self._t_start)
        elif self._roller:
            presses = self._roller.presses(PADS.index(name))
        else:
            i = PADS.index(name)
            contact, early = self.plant.contacts()[i], max(-self.imperfections.pads[i].lag, 0.0)
            s = contact.s + early * self.plant.contact_rates()[i] if early else contact.s
            presses = [Press(s, contact.force)] if contact.touching else []
        finger = self.mischief.strength("touch", name)
        return [*presses, Press(_FINGER_M, finger)] if finger > 0.0 else presses

    def _play(self, order: FaultOrder, begins: bool) -> None:
        """Mischief that is an act rather than a state of the lines."""
        controller = self._controller
        match order.name, begins:
            case "estop", True:
                controller.press_emergency_stop()
            case "power_off", True:
                controller.switch_power_off()
            case "manual", True:
                controller.switch_to_manual(self._linkage.pose(*_jogged(self._palms.angles, self._home)))
            case (("estop" | "power_off" | "manual"), False):
                controller.make_ready()
            case "break", True:
                controller.line_fault(BREAK_RECEIVED)
            case "lift", True:
                self.plant.take_away()
                self._t_place = None
            case "lift", False:
                self._put_on_palms()
            case "swap", True:
                self.new_object()


def arm_limits(config: Config) -> ArmLimits:
    """What the controller allows: a box round every pose the palms' limits allow, and room above their rates.

    E's speed is at most L1·ω1 + L2·(ω1 + ω2), its acceleration L1·(α + ω²) + L2·(2α + 4ω²).
    """
    linkage, limits = Linkage.from_config(config), config.limits
    poses = [
        linkage.pose(*map(math.radians, angles))
        for angles in itertools.product(*(np.linspace(low, high, 40).tolist() for low, high in limits.angles_deg))
        if sum(angles) < _MOST_PHI12_DEG
    ]
    xs, ys = [p.x_m for p in poses], [p.y_m for p in poses]
    omega, alpha = math.radians(limits.rate_deg_s), math.radians(limits.acceleration_deg_s2)
    l1, l2, margin = linkage.palm1_length, linkage.palm2_length, _WORKSPACE_MARGIN_M
    return ArmLimits(
        min(xs) - margin,
        max(xs) + margin,
        min(ys) - margin,
        max(ys) + margin,
        v_max=_ROOM * (l1 + 2.0 * l2) * omega,
        a_max=_ROOM * (l1 * (alpha + omega**2) + l2 * (2.0 * alpha + 4.0 * omega**2)),
    )


def _jogged(angles: Joints, home: Joints) -> Joints:
    """Where an operator jogs the palms to (rad): a little nearer to home, or off it; so never out of the limits."""
    way = [goal - angle for goal, angle in zip(home, angles, strict=True)]
    far, step = max(map(abs, way)), math.radians(_JOG_DEG)
    if far < step:
        return (angles[0] + step, *angles[1:])
    return tuple(angle + step / far * each for angle, each in zip(angles, way, strict=True))


def _home(config: Config) -> Joints:
    """Where the arm stands before anybody has commanded it (rad): as near to 45°, 90° as the limits allow."""
    each = zip(_HOME_DEG, config.limits.angles_deg, strict=True)
    return tuple(math.radians(min(max(home, low), high)) for home, (low, high) in each)
