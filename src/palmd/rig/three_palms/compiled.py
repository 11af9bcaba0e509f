"""One body on three palms, stepped by `plant.c`, or without a compiler by `rig.three_palms.plant`.

Also the motion of the palms; its Python equivalent is `system.three_palms.palms_at`.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import load_written
from palmd.rig.three_palms.bodies import Bodies
from palmd.rig.three_palms.plant import (
    PHASE_SHIFT,
    PHASES,
    BodyStates,
    FrictionParameters,
    PalmState,
    accelerations,
    step,
    vibrate,
)
from palmd.system.three_palms import PalmPlanes, palms_at

Stepper = Callable[[int, int, int, int, float, int, int], None]
Vibrator = Callable[[int, int, int, int, float, int, float, int, int], None]
Turner = Callable[[int, int, int], None]
STEPS_PER_PERIOD = 40
"""Of the fastest vibration, where vibrations are resolved."""
FORCE_LAG_S = 8e-3
"""Time constant of force sensors where vibrations are resolved; they read the mean over a vibration."""
JointMotion = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
"""Angles (rad), rates and accelerations of the three joints."""


def backend() -> str:
    """How the plant is stepped: "c" if compiled, else "python"."""
    return "python" if _library() is None else "c"


def palm_rows(palms: PalmPlanes) -> FloatArray:
    """(T, 36) numbers of the palms at T instants, as the plant takes them."""
    kinds = (palms.normal, palms.normal_rate, palms.normal_acceleration, palms.spin)
    return np.concatenate([kind.reshape(-1, 9) for kind in kinds], axis=1)


class TurningPalms:
    """The palms at the beginning of a step of the plant, midway, and at its end, which is the present.

    rows: (3, 36), as returned by `palm_rows`; axes: (3 palms, 2, 3) present axes a and b of the pads.
    """

    def __init__(self, joints: JointMotion, *, compiled: bool = True) -> None:
        """As if the palms had been at rest at these joints."""
        self.rows: FloatArray = np.zeros((3, 36))
        self.axes: FloatArray = np.zeros((3, 2, 3))
        self._joints: FloatArray = np.zeros((3, 3))
        self._at = tuple(each.ctypes.data for each in (self.rows, self.axes, self._joints))
        self._turn = _turn() if compiled else None
        for _ in self.rows:
            self.turn(joints)

    def turn(self, joints: JointMotion) -> None:
        """Advance by half a step, to the present joints."""
        self._joints[:] = joints
        if self._turn is not None:
            self._turn(*self._at)
            return
        planes = palms_at(*self._joints[:, None])
        self.rows[:2], self.rows[2] = self.rows[1:], palm_rows(planes)
        self.axes[:, 0], self.axes[:, 1] = planes.axis_a[0], planes.axis_b[0]

    def readings(self, points: FloatArray) -> FloatArray:
        """(3 palms, 2) present pad readings for contacts (3 palms, 3) (m, world)."""
        read: FloatArray = np.matmul(self.axes, points[..., None])[..., 0]
        return read


class BodyOnPalms:
    """One of `bodies` on the palms; `state` is position, velocity, rotation by rows, spin (18,).

    point (3 palms, 3) and force (3,) per unit mass belong to that state, after a step.
    """

    def __init__(
        self, body: Bodies, friction: FrictionParameters, gravity: float, *,
        frequencies: Sequence[float] | None = None, compiled: bool = True,
    ) -> None:  # fmt: skip
        """frequencies: of each palm's vibration (Hz), which is then resolved; None: averaged, in the fast limit."""
        self.body, self.friction, self._gravity = body, friction, gravity
        self._phase: FloatArray = np.zeros(3)
        self._phase_rate: FloatArray = 2.0 * math.pi * np.array(frequencies or (0.0,) * 3)
        self._per_s = STEPS_PER_PERIOD * max(frequencies or (0.0,))
        constants = (*(getattr(body, name) for name in body.__dataclass_fields__), friction.mu, friction.dither)
        parameters = [np.ravel(each) for each in (*constants, friction.drag)]
        self._scene: FloatArray = np.concatenate([*parameters, [gravity]])
        self._palms: FloatArray = np.zeros((3, 36))
        self.state: FloatArray = np.zeros(18)
        self._touch: FloatArray = np.zeros(12)
        self._step = _step() if compiled else None
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

    def begin(self, states: BodyStates) -> None:
        """Set the state to the first of these."""
        each = (states.p[0], states.v[0], states.R[0].ravel(), states.omega[0])
        self.state[:] = np.concatenate(each)

    def states(self) -> BodyStates:
        """The state as `BodyStates` of one body."""
        x = self.state.copy()
        return BodyStates(x[None, :3], x[None, 3:6], x[6:15].reshape(1, 3, 3), x[None, 15:])

    def advance(self, palms: FloatArray, dt: float) -> None:
        """One step; palms (3, 36) at its beginning, midway and at its end, as returned by `palm_rows`."""
        self._palms[:] = palms
        if self._per_s and dt > 0.0:
            self._vibrate(palms, dt)
            return
        if self._step is not None:
            at = self._phases_at, self._phase_at
            self._step(self._scene_at, self._palms_at, *at, dt, self._state_at, self._touch_at)
            self._phase[:] = np.fmod(self._phase + PHASE_SHIFT, 2.0 * math.pi)
            return
        phases = PHASES + self._phase
        each = [PalmState(*(kind.reshape(1, 3, 3) for kind in row.reshape(4, 9))) for row in palms]
        states = step(
            self.body,
            self.friction,
            lambda t: each[round(2 * t / dt) if dt else 0],
            self.states(),
            dt,
            self._gravity,
            phases,
        )
        self.begin(states)
        _, _, touched = accelerations(self.body, self.friction, each[2], states, self._gravity, phases)
        self._touch[:] = np.concatenate([touched.point[0].ravel(), touched.force[0]])
        self._phase[:] = np.fmod(self._phase + PHASE_SHIFT, 2.0 * math.pi)

    def _vibrate(self, palms: FloatArray, dt: float) -> None:
        count = math.ceil(self._per_s * dt)
        if self._step is not None:
            phase = self._phase_at, self._phase_rate_at
            _vibrate()(self._scene_at, self._palms_at, *phase, FORCE_LAG_S, count, dt, self._state_at, self._touch_at)
            return

        def between(t: float) -> PalmState:
            share = t / dt
            weights = (1 - share) * (1 - 2 * share), 4 * share * (1 - share), share * (2 * share - 1)
            return PalmState(*(kind.reshape(1, 3, 3) for kind in (np.array(weights) @ palms).reshape(4, 9)))

        states, self._phase[:], touches = vibrate(
            self.body, self.friction, between, self.states(), self._phase, self._phase_rate, count, dt, self._gravity
        )
        self.begin(states)
        decay = math.exp(-dt / count / FORCE_LAG_S)
        for touch in touches:
            force = touch.force[0]
            self._touch[9:] = np.where(self.force > 0.0, decay * self.force + (1.0 - decay) * force, force)
        self._touch[:9] = touches[-1].point[0].ravel()


@cache
def _library() -> ctypes.CDLL | None:
    return load_written("three_palms_plant", Path(__file__).with_name("plant.c"))


@cache
def _step() -> Stepper | None:
    library = _library()
    if library is None:
        return None
    pointer = ctypes.c_void_p
    function = library.three_palms_step
    function.argtypes, function.restype = (*(pointer,) * 4, ctypes.c_double, *(pointer,) * 2), None
    return function


@cache
def _vibrate() -> Vibrator:
    library, pointer = _library(), ctypes.c_void_p
    assert library is not None, "there is no compiled library"
    function = library.three_palms_vibrate
    numbers = ctypes.c_double, ctypes.c_long, ctypes.c_double
    function.argtypes, function.restype = (*(pointer,) * 4, *numbers, *(pointer,) * 2), None
    return function


@cache
def _turn() -> Turner | None:
    library = _library()
    if library is None:
        return None
    function = library.three_palms_turn
    function.argtypes, function.restype = (ctypes.c_void_p,) * 3, None
    return function
