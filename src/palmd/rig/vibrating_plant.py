"""The emulated object on palms that vibrate along themselves, with dry Coulomb friction, resolved in time.

Friction alternates with the vibration, and so do the normal forces: a contact slips forwards, backwards, or sticks.
Slip reversals are located to 1e-10 s within Runge–Kutta steps of at most an eightieth of a period; a contact at zero
slip takes the first mode that Coulomb's law allows: slip that friction opposes, or stick with friction of at most μN.
A palm's mount may be compliant across the palm: its mass, stiffness and damping determine how far normal forces follow
the alternation of friction (λ of docs/theory/vibration.md). The geometry is that of `rig.curved_plant`, with curvature
0 for flat palms.

Forces are those that a pad of about 60 Hz bandwidth reads, not instantaneous ones.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import astuple
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from palmd.events import FloatArray, PalmMotion
from palmd.model.compiled import load
from palmd.rig.curved_plant import CurvedPlant
from palmd.rig.mean_turning import MeanTurning
from palmd.rig.plant import (
    _DRIFT_RATE,
    _FALLEN_DISTANCE,
    _SEPARATION_SPEED,
    _SOFT_IMPACT,
    _TABLE_HZ,
    FrictionSurface,
    Hinge,
    PadPair,
    PlantContact,
    PlantSettings,
    palm_frame,
)
from palmd.rig.shaker import SLIP_SIGNS, Shaking
from palmd.rig.shapes import Body, Support
from palmd.system.arcs import FLAT

STEPS_PER_PERIOD = 80
FORCE_LAG_S = 2.5e-3
"""Time constant of each of two low-pass stages that average the pads' forces over the vibration."""
_CONTACTS = 2
_STEPS_PER_RESONANCE = 12.0  # of a mount
_ROW = 11  # numbers in `Row` of `vibrating_plant.c`


class Drive(NamedTuple):
    """Motion of both palms, the error of each joint angle (rad) with respect to it, and its delay (s).

    rocks: of each palm the fields of `simulate.Rock`, its rests as (from, to) in s.
    """

    rocks: Sequence[tuple[Any, ...]]
    angle_errors: Sequence[float]
    lag: float


class ContactBounds(NamedTuple):
    """Bounds of both contacts: the body's mass (kg), the smallest force (N), and the range of positions (m)."""

    mass: float
    least: float
    low: float
    high: float


def _doubles(*names: str) -> list[tuple[str, type]]:
    return [(name, ctypes.c_double) for name in names]


def _pairs(*names: str) -> list[tuple[str, type]]:
    return [(name, ctypes.c_double * _CONTACTS) for name in names]


class _Palm(ctypes.Structure):
    _fields_ = _doubles(
        "curvature", "slope", "standoff", "reach", "mu",
        "frequency", "speed", "phase", "second", "third", "inwards", "yielding", "stiffness", "damping",
    )  # fmt: skip


class _VibratingScene(ctypes.Structure):
    _fields_ = (
        ("table", ctypes.c_void_p),
        *_doubles("rho2", "damping", "gravity", "shake"),
        ("shaking_hz", ctypes.c_double * len(_TABLE_HZ)),
        *_doubles("travel"),
        *_pairs("base"),
        *_doubles("drift_rate", "soft_blow", "parting", "lost_distance", "longest_step", "force_lag"),
        ("palms", _Palm * _CONTACTS),
        ("arc", ctypes.c_long),
    )


class _Body(ctypes.Structure):
    _fields_ = (
        *_doubles("x", "y", "psi", "vx", "vy", "w"),
        *_pairs("give", "giving"),
        *_doubles("ax", "ay", "al"),
        *_pairs("f", "given", "ratio"),
        *_doubles("t", "fallen"),
        *_pairs("on", "mode", "theta", "preload", "s", "r", "force", "least", "reversals", "stuck_s"),
        *_pairs("first_stage", "second_stage"),
    )


class _PalmMotions(ctypes.Structure):
    _fields_ = tuple(_pairs("angles", "rates", "accelerations"))


class _Rock(ctypes.Structure):
    _fields_ = (
        *_doubles("mean", "amplitude", "frequency", "phase"),
        ("rests", ctypes.c_void_p),
        ("resting", ctypes.c_long),
    )


class _Rocking(ctypes.Structure):
    _fields_ = (("rocks", _Rock * _CONTACTS), *_pairs("off"), *_doubles("lag"))


class _ContactBounds(ctypes.Structure):
    _fields_ = tuple(_doubles(*ContactBounds._fields))


class VibratingPlant(CurvedPlant):
    """As `CurvedPlant`, flat palms included, on palms that vibrate as `shaking` describes, for smooth bodies, in C."""

    def __init__(
        self,
        body: Body,
        hinge: Hinge,
        surface: FrictionSurface,
        shaking: Shaking,
        curvatures: PadPair = FLAT,
        **others: Unpack[PlantSettings],
    ) -> None:
        """As `CurvedPlant`; raises ValueError for a body that is not smooth."""
        if not isinstance(body.support, Support):
            raise ValueError("a vibration can be resolved only for a smooth body")
        self.shaking = shaking
        self._turning = MeanTurning(shaking.period_s)
        self._t_touched = [-math.inf] * _CONTACTS
        super().__init__(body, hinge, surface, curvatures, **others)
        self._memory, self._table = _Body(), np.array(body.support.table)
        self._scene = self._compiled_scene()

    # -- placement and state ------------------------------------------------------------------------------

    def place(self, palms: PalmMotion, psi: float, omega0: float = 0.0) -> None:
        super().place(palms, psi, omega0)
        q = self.state
        self._memory = _Body(x=q.x, y=q.y, psi=q.psi, vx=q.vx, vy=q.vy, w=q.omega0, t=self._t, theta=tuple(self._theta))
        self._t_touched = [self._t] * _CONTACTS
        self._turning.reset(self._t, q.psi, q.omega0)
        _library().vibrating_plant_place(*self._addresses(), _packed_palms(palms))
        self._copy_state()

    def contacts(self) -> tuple[PlantContact, PlantContact]:
        """Both present contacts; forces as a pad reads them, averaged over the vibration."""
        m, mass = self._memory, self.body.mass
        one, two = (
            PlantContact(on, m.s[i], mass * m.second_stage[i] if on else 0.0) for i, on in enumerate(self.touching)
        )
        return one, two

    @property
    def least_forces(self) -> tuple[float, float]:
        return self.body.mass * self._memory.least[0], self.body.mass * self._memory.least[1]

    def radii(self) -> tuple[float, float]:
        return self._memory.r[0], self._memory.r[1]

    @property
    def touching(self) -> tuple[bool, bool]:
        """Palms that the body touches or has touched within a period: normal forces alternate, and it may bounce."""
        one, two = (
            not self.fallen and self._t - t <= 1.0 / palm.frequency
            for t, palm in zip(self._t_touched, self.shaking.palms, strict=True)
        )
        return one, two

    @property
    def mean_omega0(self) -> float:
        return self._turning.rate

    @property
    def reversals(self) -> tuple[float, float]:
        """Number of changes of each contact's mode since the body was placed."""
        return self._memory.reversals[0], self._memory.reversals[1]

    @property
    def stuck_s(self) -> tuple[float, float]:
        """Total time (s) for which each contact has stuck."""
        return self._memory.stuck_s[0], self._memory.stuck_s[1]

    # -- time steps ---------------------------------------------------------------------------------------

    def advance(self, middle: PalmMotion, end: PalmMotion, dt: float) -> None:
        self._t += dt
        self._frame = palm_frame(self.hinge, end)
        if self.fallen:
            return
        _library().vibrating_plant_advance(*self._addresses(), _packed_palms(middle), _packed_palms(end), dt)
        self._turning.take(self._t, self._memory.psi)
        for i in range(_CONTACTS):
            if self._memory.on[i] or self._memory.force[i] > 0.0:
                self._t_touched[i] = self._t
        self._copy_state()

    def simulate_rocking(self, drive: Drive, bounds: ContactBounds, dt: float, count: int) -> FloatArray:
        """Rows as `Row` in `vibrating_plant.c`, one before each of `count` steps of `dt` (s), of a body just placed.

        They end where a contact violates its bounds.
        """
        rows, rests = np.empty((count, _ROW)), [np.array(rock[4], np.float64).reshape(-1, 2) for rock in drive.rocks]
        rocks = [_Rock(*rock[:4], own.ctypes.data, len(own)) for rock, own in zip(drive.rocks, rests, strict=True)]
        rocking = ctypes.byref(_Rocking(tuple(rocks), tuple(drive.angle_errors), drive.lag))
        within = ctypes.byref(_ContactBounds(*bounds))
        row_count = _library().vibrating_plant_rock(*self._addresses(), rocking, within, dt, rows.ctypes.data, count)
        return rows[:row_count]

    def _addresses(self) -> tuple[ctypes._CArgObject, ctypes._CArgObject]:
        """Of the constant parameters and of the state."""
        return ctypes.byref(self._scene), ctypes.byref(self._memory)

    def _copy_state(self) -> None:
        """Copy the compiled plant's state into the attributes that this class inherits."""
        m, q = self._memory, self.state
        q.x, q.y, q.psi, q.vx, q.vy, q.omega0 = m.x, m.y, m.psi, m.vx, m.vy, m.w
        self._rates = m.ax, m.ay, m.al, m.f[0], m.f[1]
        self._theta = list(m.theta)
        self.fallen = m.fallen != 0.0

    def take_away(self) -> None:
        super().take_away()
        self._memory = _Body(fallen=1.0)

    def _compiled_scene(self) -> _VibratingScene:
        """The constant parameters in the form of `vibrating_plant.c`."""
        shakers, (mode, travel, base) = self.shaking.palms, astuple(self.hinge)
        palms = [self._palm(i) for i in range(_CONTACTS)]
        steps = [1.0 / (STEPS_PER_PERIOD * each.frequency) for each in shakers]
        steps += [math.tau / math.sqrt(palm.stiffness) / _STEPS_PER_RESONANCE for palm in palms if palm.yielding]
        return _VibratingScene(
            table=self._table.ctypes.data, rho2=self.body.rho**2, damping=self.surface.damping, gravity=self.gravity,
            shake=self._table_amplitude, shaking_hz=_TABLE_HZ, travel=travel, base=base, drift_rate=_DRIFT_RATE,
            soft_blow=_SOFT_IMPACT, parting=_SEPARATION_SPEED, lost_distance=_FALLEN_DISTANCE, longest_step=min(steps),
            force_lag=FORCE_LAG_S, palms=tuple(palms), arc=mode == "arc",
        )  # fmt: skip

    def _palm(self, i: int) -> _Palm:
        shaker = self.shaking.palms[i]
        mount, mass = shaker.mount, shaker.mount.mass
        return _Palm(
            curvature=self._kappa[i], slope=self._slopes[i], standoff=self._standoffs[i], reach=self.reach[i],
            mu=self.surface.mu * self._frictions[i], frequency=shaker.frequency, speed=shaker.speed, phase=shaker.phase,
            second=shaker.second, third=shaker.third, inwards=SLIP_SIGNS[i], yielding=self.body.mass / mass,
            stiffness=0.0 if math.isinf(mass) else mount.stiffness / mass, damping=mount.damping / mass,
        )  # fmt: skip

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_scene"}  # it points to this one's table

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._scene = self._compiled_scene()


def _packed_palms(motion: PalmMotion) -> ctypes._CArgObject:
    return ctypes.byref(_PalmMotions(motion.angles, motion.rates, motion.accelerations))


def backend() -> str:
    """How the plant is stepped: "c"; raises NotCompiledError if it cannot be compiled."""
    _library()
    return "c"


@cache
def _library() -> ctypes.CDLL:
    library = load("vibrating_plant", list, written=[str(Path(__file__).with_suffix(".c"))]).opened()
    pointer, double = ctypes.c_void_p, ctypes.c_double
    library.vibrating_plant_place.argtypes = (pointer,) * 3
    library.vibrating_plant_advance.argtypes = (*[pointer] * 4, double)
    library.vibrating_plant_place.restype = library.vibrating_plant_advance.restype = None
    library.vibrating_plant_rock.argtypes = (*[pointer] * 4, double, pointer, ctypes.c_long)
    library.vibrating_plant_rock.restype = ctypes.c_long
    return library
