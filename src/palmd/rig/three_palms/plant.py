"""A free rigid body on three palms by constraint forces, with all six degrees of freedom, in C (`plant.c`).

State: position, velocity, rotation, spin. The gaps gᵢ = nᵢ·p − h(−Rᵀnᵢ) are kept at zero by normal forces that make
g̈ᵢ = −2κġᵢ − κ²gᵢ, so that integration errors decay. Friction is dry. The palms vibrate, each along its pad's axis a and
independently of the others: at every instant friction is Coulomb's along the slip of that instant, and the contacts are
rigid. The body is moved by the mean over `PHASES`, instants that are evenly spread over all combinations of the three
palms' phases and shifted at each step; or the vibrations are resolved in time, as on a real rig.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import load
from palmd.rig.three_palms.bodies import Bodies
from palmd.system.three_palms import PalmPlanes

INSTANTS = 64
PHASES: FloatArray = 2.0 * math.pi * (np.outer(np.arange(INSTANTS), (1, 19, 27)) / INSTANTS % 1.0)
"""(INSTANTS, 3 palms), rad: a lattice in which each palm's phases, and all pairs of two palms, are evenly spread."""
PHASE_SHIFT: FloatArray = 2.0 * math.pi * np.array([0.8191725134, 0.6710436067, 0.5497004779])
"""Shift of the lattice per step (rad): powers of 1/1.2207…, of which no integer combination is an integer."""
STEPS_PER_PERIOD = 40
"""Of the fastest vibration, where vibrations are resolved."""
FORCE_LAG_S = 8e-3
"""Time constant of force sensors where vibrations are resolved; they read the mean over a vibration."""
JointMotion = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
"""Angles (rad), rates and accelerations of the three joints."""


@dataclass(frozen=True, slots=True)
class FrictionParameters:
    """Friction coefficient mu, dither (m/s), drag of spin (m²/s, per unit mass); (B,) each.

    dither: πV/2, V the amplitude of the palms' vibration speed.
    """

    mu: FloatArray
    dither: FloatArray
    drag: FloatArray


def palm_rows(palms: PalmPlanes) -> FloatArray:
    """(T, 36) numbers of the palms at T instants, as the plant takes them."""
    kinds = (palms.normal, palms.normal_rate, palms.normal_acceleration, palms.spin)
    return np.concatenate([kind.reshape(-1, 9) for kind in kinds], axis=1)


class TurningPalms:
    """The palms at the beginning of a step of the plant, midway, and at its end, which is the present.

    rows: (3, 36), as returned by `palm_rows`; axes: (3 palms, 2, 3) present axes a and b of the pads.
    """

    def __init__(self, joints: JointMotion) -> None:
        """As if the palms had been at rest at these joints."""
        self.rows: FloatArray = np.zeros((3, 36))
        self.axes: FloatArray = np.zeros((3, 2, 3))
        self._joints: FloatArray = np.zeros((3, 3))
        self._at = tuple(each.ctypes.data for each in (self.rows, self.axes, self._joints))
        for _ in self.rows:
            self.turn(joints)

    def turn(self, joints: JointMotion) -> None:
        """Advance by half a step, to the present joints."""
        self._joints[:] = joints
        _library().three_palms_turn(*self._at)

    def readings(self, points: FloatArray) -> FloatArray:
        """(3 palms, 2) present pad readings for contacts (3 palms, 3) (m, world)."""
        read: FloatArray = np.matmul(self.axes, points[..., None])[..., 0]
        return read


class BodyOnPalms:
    """One of `bodies` on the palms; `state` is position, velocity, rotation by rows, spin (18,).

    point (3 palms, 3) and force (3,) per unit mass belong to that state, after a step.
    """

    def __init__(
        self, body: Bodies, friction: FrictionParameters, gravity: float, *, frequencies: Sequence[float] | None = None
    ) -> None:
        """frequencies: of each palm's vibration (Hz), which is then resolved; None: averaged, in the fast limit."""
        self.body, self.friction = body, friction
        self._phase: FloatArray = np.zeros(3)
        self._phase_rate: FloatArray = 2.0 * math.pi * np.array(frequencies or (0.0,) * 3)
        self._per_s = STEPS_PER_PERIOD * max(frequencies or (0.0,))
        constants = (*(getattr(body, name) for name in body.__dataclass_fields__), friction.mu, friction.dither)
        parameters = [np.ravel(each) for each in (*constants, friction.drag)]
        self._scene: FloatArray = np.concatenate([*parameters, [gravity]])
        self._palms: FloatArray = np.zeros((3, 36))
        self.state: FloatArray = np.zeros(18)
        self._touch: FloatArray = np.zeros(12)
        arrays = self._scene, self._palms, self.state, self._touch, self._phase, self._phase_rate, PHASES
        (self._scene_at, self._palms_at, self._state_at, self._touch_at,
         self._phase_at, self._phase_rate_at, self._phases_at) = (each.ctypes.data for each in arrays)  # fmt: skip

    @property
    def point(self) -> FloatArray:
        """(3 palms, 3) contacts (m, world)."""
        return self._touch[:9].reshape(3, 3)

    @property
    def force(self) -> FloatArray:
        """(3,) normal forces per unit mass (m/s²)."""
        return self._touch[9:]

    def begin(self, p: FloatArray, v: FloatArray, rotation: FloatArray, omega: FloatArray) -> None:
        """Set position and velocity (m, m/s), rotation to the world, and spin (rad/s)."""
        self.state[:] = np.concatenate([np.ravel(each) for each in (p, v, rotation, omega)])

    def advance(self, palms: FloatArray, dt: float) -> None:
        """One step; palms (3, 36) at its beginning, midway and at its end, as returned by `palm_rows`."""
        self._palms[:] = palms
        state = self._state_at, self._touch_at
        if self._per_s and dt > 0.0:
            phase = self._phase_at, self._phase_rate_at
            count = math.ceil(self._per_s * dt)
            _library().three_palms_vibrate(self._scene_at, self._palms_at, *phase, FORCE_LAG_S, count, dt, *state)
            return
        _library().three_palms_step(self._scene_at, self._palms_at, self._phases_at, self._phase_at, dt, *state)
        self._phase[:] = np.fmod(self._phase + PHASE_SHIFT, 2.0 * math.pi)


@cache
def _library() -> ctypes.CDLL:
    library = load("three_palms_plant", list, written=[str(Path(__file__).with_suffix(".c"))]).opened()
    pointer, double = ctypes.c_void_p, ctypes.c_double
    library.three_palms_step.argtypes = (*(pointer,) * 4, double, *(pointer,) * 2)
    library.three_palms_vibrate.argtypes = (*(pointer,) * 4, double, ctypes.c_long, double, *(pointer,) * 2)
    library.three_palms_turn.argtypes = (pointer,) * 3
    for function in (library.three_palms_step, library.three_palms_vibrate, library.three_palms_turn):
        function.restype = None
    return library
