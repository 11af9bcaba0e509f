"""The complete emulated rig in one pure object: body, palms, arm, controller, pads, lines and fault injection.

`advance(t)` returns the bytes that have left each port by t, `receive` takes the host's. Nothing reads a clock or opens
a port, so the same world runs behind pseudo-terminals in real time and, faster, in one process with the daemon's pure
step. The same seed and the same input bytes give the same output bytes.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from palmd.config.arms import AdeptConfig
from palmd.config.pads import PadConfig, VersaPadConfig
from palmd.config.two_palms import Config, DrawnImperfections, PadsConfig, RigConfig
from palmd.config.vibration import vibration_of
from palmd.events import Joints, PalmMotion
from palmd.quantities import BODY, TRUTH
from palmd.rig.actuators import EmulatedActuator
from palmd.rig.adept_arm import AdeptArm
from palmd.rig.curved_plant import MAX_CURVATURE_RATIO, max_curvature_radius, stable_on_arcs
from palmd.rig.emulated import STEP_S, EmulatedRig
from palmd.rig.fault_injection import PADS, FaultOrder, PortName
from palmd.rig.friction import law_of, plant_on, shaken
from palmd.rig.hand import Hand
from palmd.rig.imperfections import configured, perfect
from palmd.rig.marble import Marble
from palmd.rig.pads import GOOD_PADS, PadOptions, Press, make_emulator
from palmd.rig.plant import AS_ASSUMED, FrictionSurface, PlantOptions, random_surface, stable_poses
from palmd.rig.roller import Roller, RollerKind
from palmd.rig.servos import make_servo_arm
from palmd.rig.shapes import Body, Kind, random_body
from palmd.system.arcs import joints_of
from palmd.system.mechanism import JOINT_RATES, JOINTS, PALMS

_HOME_DEG = (45.0, 90.0)  # of flat palms, and of the tangents where a body of the radius touches curved ones
_HOME_RADIUS_M = 0.02
AWAY_S = 1.0  # how long a hand takes to put another object on the palms
_PAD_END_M = 3e-3


def default_config(imperfections: DrawnImperfections = "none") -> Config:
    """The default configuration: of a rig exactly as described, or with the errors that calibration leaves."""
    pads = PadsConfig(**{f"palm{palm}": VersaPadConfig(port=pad) for palm, pad in zip(PALMS, PADS, strict=True)})
    config = Config(rig=RigConfig(imperfections=imperfections), pads=pads, arm=AdeptConfig(port="arm"))
    return perfect(config) if imperfections == "none" else config


class World(EmulatedRig[EmulatedActuator]):
    """See the module."""

    topics = (TRUTH, BODY)
    extra_arguments = frozenset({"marbles", "bodies", "roller", "by_hand", "options"})

    def __init__(
        self,
        config: Config,
        seed: int,
        *,
        kind: Kind = "rig",
        options: PlantOptions = AS_ASSUMED,
        pad_options: PadOptions = GOOD_PADS,
        marbles: Collection[PortName] = (),
        bodies: Sequence[Body] = (),
        surface: FrictionSurface | None = None,
        roller: RollerKind | None = None,
        by_hand: bool = False,
        t: float = 0.0,
    ) -> None:
        """At rest at t (s), with a random body of the kind, or the first of `bodies`, in a stable pose.

        An exchange takes another random body, or the next of `bodies`, cyclically. All of them rub against `surface`,
        by default a random one of the kind.

        The configuration's `rig.imperfections` states the rig's true errors. With `marbles` there is no body on the
        palms: a marble rolls over each of these pads. With `roller` a roller rolls down a gently sloping palm; with
        `by_hand` the arm is in manual mode and a hand swings the empty palms.
        """
        self.config, self.seed, self.kind = config, seed, kind
        self.contact_losses = self.falls = 0
        law = options.friction_law or law_of(vibration_of(config.rig.vibration))
        self._options, self._bodies, self._surface = replace(options, friction_law=law), bodies, surface
        self.imperfections = configured(config, seed)
        rng = np.random.default_rng(seed)
        self._home = _home(config)
        arm: EmulatedActuator = (
            AdeptArm(config, config.arm, self._home, rng, step_s=STEP_S, lag_s=options.lag_s)
            if isinstance(config.arm, AdeptConfig)
            else make_servo_arm(config, config.arm, self._home, rng, t)
        )
        self._palms = arm.palms_at(t)
        self._pad_configs: dict[PortName, PadConfig] = dict(zip(PADS, config.pads.each(), strict=True))
        pads = {
            name: make_emulator(pad, pad_options, imperfection.reading_error_m, rng, t)
            for (name, pad), imperfection in zip(self._pad_configs.items(), self.imperfections.pads, strict=True)
        }
        super().__init__(pads, arm, rng, t)
        self._marbles = {
            name: Marble(pad.length_mm * 1e-3, np.random.default_rng((seed, number)))
            for number, (name, pad) in enumerate(self._pad_configs.items(), 1)
            if name in marbles
        }
        self._roller = roller and Roller(roller, config.rig.gravity_m_s2, self._reach(), np.random.default_rng(seed))
        self._hand = Hand(config.limits, self._home) if by_hand else None
        self._t_place: float | None = None
        self._touching = (False, False)
        self._draw_body()
        self._put_on_palms()

    # -- the outside --------------------------------------------------------------------------------------

    def new_object(self) -> None:
        """Take the object away and, one second later, put another one on the palms."""
        self.plant.take_away()
        self._draw_body()
        self._t_place = self.t + AWAY_S

    def truth(self) -> dict[str, Any]:
        """The true state at `t`, as published on `rig/truth`."""
        q, palms = self.plant.state, self._true_palms
        contacts = tuple(zip(PALMS, self.plant.contacts(), strict=True))
        return {
            "psi_rad": q.psi,
            "omega0_rad_s": self.plant.mean_omega0,
            **{f"r{palm}_m": r for palm, r in zip(PALMS, self.plant.radii(), strict=True)},
            **{f"s{palm}_m": contact.s for palm, contact in contacts},
            **{f"{joint}_rad": angle for joint, angle in zip(JOINTS, palms.angles, strict=True)},
            **{f"{joint}_rad_s": rate for joint, rate in zip(JOINT_RATES, palms.rates, strict=True)},
            "com_x_m": q.x,
            "com_y_m": q.y,
            **{f"f{palm}_n": contact.force for palm, contact in contacts},
            **{f"contact{palm}": contact.touching for palm, contact in contacts},
            "object": self.objects,
            "arm_state": str(self._arm.state),
        }

    def object_truth(self) -> dict[str, Any]:
        """The body, as published on `rig/object`; h by outward normals in a frame that turns by psi_rad."""
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

    def _counts(self) -> dict[str, Any]:
        return {
            "on_palms": not self.plant.fallen,
            **self.plant.status(),
            "contact_losses": self.contact_losses,
            "falls": self.falls,
            "jams": self._arm.jams,
        }

    # -- one step -----------------------------------------------------------------------------------------

    def _step(self) -> None:
        """Advance everything by half a millisecond."""
        t = self.t
        middle, end = self._arm.palms_at(t + 0.5 * STEP_S), self._arm.palms_at(t + STEP_S)
        was_on_palms = not self.plant.fallen
        true_palms = self.imperfections.true_palms
        self.plant.advance(true_palms(middle), true_palms(end), STEP_S)
        self._palms = end
        self._steps += 1
        t = self.t
        self._count_contact_losses(was_on_palms)
        self._inject_due_faults(t)
        if self._t_place is not None and t >= self._t_place:
            self._put_on_palms()
        if self._roller:
            self._roller.advance(t, self._true_palms)
        self._arm.apply_contacts(end, self.plant.contacts, t)
        if self._hand:
            self._arm.move_by_hand(self._hand.at(t - self._t_start))
        self._transmit_due(t)

    @property
    def _true_palms(self) -> PalmMotion:
        return self.imperfections.true_palms(self._palms)

    # -- the body and the hands that move it --------------------------------------------------------------

    def _draw_body(self) -> None:
        rig = self.config.rig
        curvatures = rig.curvatures_per_m
        bodies = self._bodies
        body = bodies[self.objects % len(bodies)] if bodies else random_body(self.kind, self._rng)
        while not bodies and any(curvatures) and max(curvatures) * max_curvature_radius(body) > MAX_CURVATURE_RATIO:
            body = random_body(self.kind, self._rng)  # nobody puts what would lie in a palm on the palms
        surface = self._surface or random_surface(self.kind, self._rng)
        shaking, surface = shaken(vibration_of(rig.vibration), surface, body.mass, self.seed)
        self.plant = plant_on(
            body,
            self._arm.hinge,
            surface,
            curvatures,
            options=self._options,
            shaking=shaking,
            imperfections=self.imperfections,
            gravity=rig.gravity_m_s2,
            reach=self._reach(),
        )
        self.objects += 1

    def _reach(self) -> tuple[float, ...]:
        return tuple(pad.length_mm * 1e-3 for pad in self.config.pads.each())

    def _put_on_palms(self) -> None:
        """Place the body in one of its stable poses on the pads; if there is none, try again later."""
        if self._marbles or self._roller or self._hand:
            self._t_place = None
            return
        body, palms, curvatures = self.plant.body, self._true_palms, self.config.rig.curvatures_per_m
        poses = stable_on_arcs(body, palms, curvatures) if any(curvatures) else stable_poses(body, palms)
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
        self._t_place = self.t + AWAY_S

    def _count_contact_losses(self, was_on_palms: bool) -> None:
        touching = self.plant.touching
        if touching != self._touching:
            self.contact_losses += sum(was and not now for was, now in zip(self._touching, touching, strict=True))
            self._touching = touching
        self.falls += was_on_palms and self.plant.fallen

    def _reporting_delay(self, pad: PortName) -> float:
        return max(self.imperfections.pads[PADS.index(pad)].lag, 0.0)

    def _object_presses(self, pad: PortName) -> list[Press]:
        i = PADS.index(pad)
        if pad in self._marbles:
            return self._marbles[pad].presses(self.t - self._t_start)
        if self._roller:
            return self._roller.presses(i)
        contact, early = self.plant.contacts()[i], max(-self.imperfections.pads[i].lag, 0.0)
        s = contact.s + early * self.plant.contact_rates()[i] if early else contact.s
        return [Press(s, contact.force)] if contact.touching else []

    def _inject_fault(self, order: FaultOrder, begins: bool) -> None:
        self._arm.inject_fault(order, begins, self._palms.angles)
        match order.name, begins:
            case "lift", True:
                self.plant.take_away()
                self._t_place = None
            case "lift", False:
                self._put_on_palms()
            case "swap", True:
                self.new_object()
            case "overflow", True:
                assert order.port is not None, "overflow is injected at pads"
                self._transmit(order.port, self._pads[order.port].overflow(self.t), self.t)


def _home(config: Config) -> Joints:
    """The palms' initial angles (rad): as near to 45°, 90° as the limits allow."""
    preferred: Joints = tuple(map(math.radians, _HOME_DEG))
    if any(config.rig.curvatures_per_m):
        preferred = joints_of(_HOME_RADIUS_M, preferred, config.rig.curvatures_per_m)
    pairs = zip(preferred, config.limits.angles_deg, strict=True)
    return tuple(min(max(home, math.radians(low)), math.radians(high)) for home, (low, high) in pairs)
