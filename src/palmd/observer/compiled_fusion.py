"""Bindings to `model/fusion.c`, which fuses events into a bank of shape maps, with its memory; safe inside the loop."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from palmd.events import Event, FloatArray, PadLift, PadSample, PalmMotion, PalmSample
from palmd.model import shape_map
from palmd.model.compiled import EXPORTED, Library
from palmd.model.dynamics import VIBRATION_ERROR_INPUTS
from palmd.model.outputs import FRICTION_INPUT, NAMED, RIG_INPUTS
from palmd.model.smoothing import RIG_CONSTANTS, R
from palmd.observer.bank import Bank, Belief
from palmd.observer.filters.base import pad_update
from palmd.observer.history import EVENTS
from palmd.observer.palms import TrackedPalms, repetitions
from palmd.system.mechanism import JOINTS, PALMS

if TYPE_CHECKING:
    from palmd.observer.rig_error import RigError

MOST_STATES = 64
_JOINTS = len(JOINTS)
_TOO_LATE = -2
_MISSING = (math.nan,) * _JOINTS
_Joints, _Named = ctypes.c_double * _JOINTS, ctypes.c_double * len(NAMED)


def _doubles(*names: str) -> list[tuple[str, type]]:
    return [(name, ctypes.c_double) for name in names]


def _pointers(*names: str) -> list[tuple[str, type]]:
    return [(name, ctypes.c_void_p) for name in names]


class _Palms(ctypes.Structure):
    _fields_ = (
        ("state", ctypes.c_double * (3 * _JOINTS)), ("P", ctypes.c_double * 9), ("jerk", _Joints),
        *_doubles("t", "moved", "liveliest", "plan_t"), ("plan", _Joints), *_doubles("variance"),
    )  # fmt: skip


class _Report(ctypes.Structure):
    _fields_ = (*_doubles("t"), *((name, _Joints) for name in ("angles", "rates", "accelerations")))


class _RigError(ctypes.Structure):
    _fields_ = (*_pointers("values", "lengths", "curvatures", "s", "most"),)


class _FusedReading(ctypes.Structure):
    _fields_ = (*_doubles("t", "s", "force"), ("pad", ctypes.c_long))


class _Bank(ctypes.Structure):
    _fields_ = (
        *_pointers("predict", "update1", "update2", "values", "predict_one", "named"),
        *_pointers("x0", "x1", "P0", "P1", "score", "nis", "outcome", "y", "rig", "now"),
        *((name, ctypes.c_long) for name in ("n", "block")), *_doubles("memory_s"),
    )  # fmt: skip


class _Fused(ctypes.Structure):
    _fields_ = (("reading", _FusedReading), *_doubles("t_before"), *_pointers("faded", "x", "P", "score", "nis"))


class _Fusion(ctypes.Structure):
    _fields_ = (
        *_doubles("t", "t_start", "repeated"), ("variances", _Joints), ("shared", _Joints), *_pointers("faded"),
        *((name, ctypes.c_long) for name in ("early", "count", "waiting", "moved")),
        ("fused", _Fused * EVENTS), ("queue", _FusedReading * (EVENTS + 1)),
    )  # fmt: skip


class _Rows:
    """The address of a table that C reads, cached while the table is the same array."""

    def __init__(self) -> None:
        self._given: FloatArray | None = None

    def at(self, table: FloatArray) -> int:
        """Address of its first row, valid until the next call."""
        if table is not self._given:
            self._given, self._held = table, np.ascontiguousarray(table)
            self._address: int = self._held.ctypes.data
        return self._address


class Routines:
    """The functions of `model/fusion.c` in one compiled library of shape maps."""

    def __init__(self, library: Library):
        """Raises RuntimeError if the library's array sizes differ from the model's."""
        self.library = ctypes.CDLL(str(library.path))
        of_pads = (R.ZERO, R.SCALE, R.SAGITTA, R.LAG, R.STANDOFF)
        constants = (*of_pads, R.TILT, R.TURN, R.FRICTION, R.FORCE, R.KAPPA, RIG_CONSTANTS)
        inputs = (RIG_INPUTS, FRICTION_INPUT, VIBRATION_ERROR_INPUTS.start)
        sizes = (_JOINTS, *inputs, len(NAMED), MOST_STATES, EVENTS, shape_map.Z.SHAPE, *constants)
        if tuple((ctypes.c_long * len(sizes)).in_dll(self.library, "fusion_sizes")) != sizes:
            raise RuntimeError("the array sizes in model/fusion.c differ from the model's: rebuild the library")
        pointer, number, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_long
        of_bank = (pointer, pointer, pointer)
        self.palms_at = self._bound("palms_at", pointer, number, pointer)
        self.palms_variance = self._bound("palms_variance", pointer, number, pointer, pointer)
        self.palms_feed = self._bound("palms_feed", pointer, pointer)
        self.carry = self._bound("carry", *of_bank, number, number, number)
        self.read_pad = self._bound("read_pad", *of_bank, pointer, number, number)
        self.follow = self._bound("follow", *of_bank, pointer, integer, pointer, pointer, pointer, restype=integer)
        self.fade = self._bound("fade", pointer, integer, number, integer, integer, pointer, pointer)
        self.lift = self._bound("lift", pointer, integer, pointer, integer, restype=integer)
        self.falls_below = self._bound("falls_below", pointer, integer, pointer, integer, restype=integer)
        outputs = (pointer, pointer, pointer)
        self.named = self._bound("named", *of_bank, integer, number, number, pointer, integer, integer, *outputs)
        self.disagreement = self._bound("disagreement", *of_bank, number, number, integer, pointer, restype=integer)
        self.add = self._bound("add", pointer, *of_bank, pointer, restype=integer)
        self.fuse = self._bound("fuse", pointer, *of_bank, restype=integer)

    def address(self, kernel: str) -> int:
        """Address of a kernel."""
        return ctypes.cast(self.library[EXPORTED + kernel], ctypes.c_void_p).value or 0

    def _bound(self, name: str, *arguments: type, restype: type | None = None) -> Callable[..., int]:
        function = self.library[name]
        function.argtypes, function.restype = arguments, restype
        return function


class CompiledPalms:
    """`palms.PalmTracker` in C, a `TrackedPalms`."""

    def __init__(self, routines: Routines, angle_noise: float):
        """`angle_noise`: 1σ of a measured palm angle (rad)."""
        self._routines = routines
        self._now = _Palms(t=-math.inf, moved=0.0, plan_t=math.nan, variance=angle_noise**2)
        self.address = ctypes.addressof(self._now)
        self.jerk: FloatArray = np.ctypeslib.as_array(self._now.jerk)
        self._report = _Report()
        self._report_at = ctypes.addressof(self._report)
        self._motion = (ctypes.c_double * (3 * _JOINTS))()
        self._motion_at = ctypes.addressof(self._motion)

    @property
    def known(self) -> bool:
        return self.t > -math.inf

    @property
    def t(self) -> float:
        return float(self._now.t)

    @property
    def repeated(self) -> float:
        return float(repetitions(self._now.t - self._now.moved)) if self.known else 1.0

    def sd(self, t: float) -> tuple[FloatArray, FloatArray]:
        angles, rates = np.empty(_JOINTS), np.empty(_JOINTS)
        self._routines.palms_variance(self.address, t, angles.ctypes.data, rates.ctypes.data)
        return np.sqrt(angles), np.sqrt(rates)

    def feed(self, sample: PalmSample) -> None:
        report = self._report
        report.t = sample.t_sample
        # slices also accept lists, which samples from another process consist of
        report.angles[:], report.rates[:] = sample.angles, sample.rates or _MISSING
        report.accelerations[:] = sample.accelerations or _MISSING
        self._routines.palms_feed(self.address, self._report_at)

    def at(self, t: float) -> FloatArray:
        self._routines.palms_at(self.address, t, self._motion_at)
        return np.array(self._motion)

    def motion(self, t: float) -> PalmMotion:
        self._routines.palms_at(self.address, t, self._motion_at)
        values = tuple(self._motion)
        return PalmMotion(values[:_JOINTS], values[_JOINTS : 2 * _JOINTS], values[2 * _JOINTS :])


class CompiledRig:
    """A `RigError` in C's layout."""

    def __init__(self, error: RigError):
        self.pressing = error.pressing
        lengths, curvatures = np.array(error.pad_lengths), np.array(error.curvatures)
        self._held = error.values, lengths, curvatures, error.s, error.most
        self._now = _RigError(*(each.ctypes.data for each in self._held))
        self.address = ctypes.addressof(self._now)


class CompiledBank(Bank):
    """A bank of shape maps that fuses readings in C; arguments `rig` are `ShapeFilters.compiled_rig`."""

    def __init__(
        self, library: Library, size: int, n: int, updates: Mapping[str, int], inputs: tuple[int, int, int],
        memory_s: float, rig_inputs: FloatArray, added_variances: Sequence[FloatArray],
    ):  # fmt: skip
        """`rig_inputs` as from `model.outputs.rig_inputs`; C writes the friction asymmetry there.

        `added_variances` are two sets of variances that are added to those of `NAMED`: before a smoother has estimated
        the rig's constants, and after. Raises ValueError for more than `MOST_STATES` states.
        """
        if n > MOST_STATES:
            raise ValueError(f"a bank of shape maps has at most {MOST_STATES} states, not {n}")
        super().__init__(library, size, n, updates, inputs, memory_s)
        self.routines = Routines(library)
        self._rig_inputs = rig_inputs
        of_bank = "" if self.block == 1 else "_block"
        kernels = [f"{name}{of_bank}" for name in ("predict", *map(pad_update, PALMS), "values")] + ["predict", "named"]
        held = (*self._x, *self._P, self._score, self._nis, self._outcome, self._y, rig_inputs)
        self._shared = _Bank(
            *map(self.routines.address, kernels), *(each.ctypes.data for each in held), ctypes.addressof(self._now),
            n, self.block, memory_s,
        )  # fmt: skip
        self.address = ctypes.addressof(self._shared)
        self._values_of_one, self._variance = _Named(), _Named()
        self._added = tuple(_Named(*each) for each in added_variances)
        self._outputs = tuple(map(ctypes.addressof, (self._values_of_one, self._variance)))
        self._disagreement = _Named()
        self._disagreement_at = ctypes.addressof(self._disagreement)
        self._spread, self._rows = _Rows(), _Rows()
        self._prior_sd: FloatArray | None = None
        self._prior_variance = np.zeros((0, n))
        self._reading = _FusedReading()
        self._reading_at = ctypes.addressof(self._reading)

    def reading(self, sample: PadSample, rig: CompiledRig) -> int:
        """The address of a reading, valid until the next call; raises ValueError for an unknown pad."""
        if sample.pad not in PALMS:
            raise ValueError(f"there is no pad {sample.pad}")
        reading = self._reading
        reading.t, reading.s, reading.force, reading.pad = sample.t_sample, sample.s, rig.pressing(sample), sample.pad
        return self._reading_at

    def at(self, rig: CompiledRig, palms: TrackedPalms) -> tuple[int, int, int]:
        """The addresses of bank, palms and rig, as the routines take them."""
        assert isinstance(palms, CompiledPalms)
        return self.address, palms.address, rig.address

    def propagate(self, rig: CompiledRig, palms: TrackedPalms, t: float, until: float, repeated: float) -> None:
        """As `Filters.propagate`."""
        self.routines.carry(*self.at(rig, palms), t, until, repeated)

    def fuse_pad(
        self, rig: CompiledRig, palms: TrackedPalms, sample: PadSample, variance: float, repeated: float
    ) -> None:
        """As `Filters.fuse_pad`."""
        self.routines.read_pad(*self.at(rig, palms), self.reading(sample, rig), variance, repeated)

    def fuse_events(
        self,
        rig: CompiledRig,
        palms: TrackedPalms,
        events: Sequence[Event],
        variances: FloatArray,
        shared: FloatArray,
        t: float,
    ) -> tuple[float, int]:
        """As `ShapeFilters.fuse_events`."""
        rows = np.array([_row(event) for event in events if not isinstance(event, PadLift)])
        now = ctypes.c_double(t)
        readings = (rows.ctypes.data, len(rows), variances.ctypes.data, shared.ctypes.data)
        read = self.routines.follow(*self.at(rig, palms), *readings, ctypes.addressof(now))
        return now.value, read

    def fade(self, block: int, fraction: float, prior: Belief) -> None:
        """As `Bank.fade`."""
        first, last, _ = prior.which.indices(self.n)
        mean = np.ascontiguousarray(prior.mean)
        if len(mean) < self.size or mean.shape[1] != self.n:
            raise ValueError(f"beliefs need shape ({self.size}, {self.n}) at least, not {mean.shape}")
        if prior.sd is not self._prior_sd or mean.shape != self._prior_variance.shape:
            self._prior_sd = prior.sd
            self._prior_variance = np.ascontiguousarray(np.broadcast_to(prior.sd, mean.shape) ** 2)
        at = mean.ctypes.data, self._prior_variance.ctypes.data
        self.routines.fade(self.address, block, fraction, first, last, *at)

    def impose_nonnegative(self, block: int, rows: FloatArray) -> bool:
        """As `Bank.impose_nonnegative`."""
        return self.routines.lift(self.address, block, *self._checked(rows)) == 0

    def falls_below(self, member: int, rows: FloatArray) -> bool:
        """As `Bank.falls_below`."""
        return self.routines.falls_below(self.address, member, *self._checked(rows)) != 0

    def _checked(self, rows: FloatArray) -> tuple[int, int]:
        if rows.shape[1] != self.n:
            raise ValueError(f"rows need {self.n} columns, one for each state, not {rows.shape}")
        return self._rows.at(rows), len(rows)

    def named(
        self, rig: CompiledRig, palms: TrackedPalms, member: int, t: float, dt: float, spread: FloatArray | None
    ) -> tuple[list[float], list[float]]:
        """Values of `NAMED` and their variances for one filter, propagated from `t` to `t + dt`.

        `spread` has a row for each of the filter's states, optionally followed by one for each of the rig's constants.
        """
        table = (None, 0, 0) if spread is None else (self._spread.at(spread), *spread.shape)
        added = ctypes.addressof(self._added[spread is not None])
        self.routines.named(*self.at(rig, palms), member, t, dt, *table, added, *self._outputs)
        return self._values_of_one[:], self._variance[:]

    def disagreement(
        self, rig: CompiledRig, palms: TrackedPalms, t: float, margin: float, one_gauge: bool
    ) -> list[float] | None:
        """As `Fusion.disagreement` at `t` (s), with rivals within `margin` (nats) of the best."""
        rivals = self.routines.disagreement(*self.at(rig, palms), t, margin, one_gauge, self._disagreement_at)
        return self._disagreement[:] if rivals > 1 else None


class CompiledHistory:
    """`history.History` and `Fusion` in C; `now.t` and `now.t_start` are those of `Fusion`."""

    def __init__(self, banks: Iterable[CompiledBank], variances: FloatArray, shared: FloatArray):
        """`banks`: all banks that will be used; `variances`: of each pad's readings (m²)."""
        self._memory = {id(bank): [_blank(bank) for _ in range(EVENTS)] for bank in banks}
        self.now = _Fusion(
            t=-math.inf, t_start=math.inf, variances=tuple(variances.tolist()), shared=tuple(shared.tolist())
        )
        self._address = ctypes.addressof(self.now)

    def use(self, bank: CompiledBank, t_faded: FloatArray, early: bool) -> None:
        """Fuse into `bank` from now on, with an empty history; `t_faded` as in `Forgetting`.

        `early`: inflate the noise of the first readings.
        """
        self._bank, self._t_faded = bank, t_faded
        now = self.now
        now.faded, now.early = t_faded.ctypes.data, early
        now.count = now.waiting = now.moved = 0
        for entry, arrays in zip(now.fused, self._memory[id(bank)], strict=True):
            entry.faded, entry.x, entry.P, entry.score, entry.nis = (each.ctypes.data for each in arrays)

    def clear(self) -> None:
        """Empty the history: no earlier event can be undone."""
        self.now.count = 0

    def add(
        self, sample: PadSample, rig: CompiledRig, palms: TrackedPalms, forget: Callable[[int, float], None]
    ) -> bool:
        """Fuse one reading at its own time; False if it is too late for that.

        `forget` is called with the number of each block that is due to forget, and the `repetitions` of the reading.
        """
        bank = self._bank
        routines, at = bank.routines, bank.at(rig, palms)
        block = routines.add(self._address, *at, bank.reading(sample, rig))
        while block >= 0:
            forget(block, self.now.repeated)
            block = routines.fuse(self._address, *at)
        return block != _TOO_LATE


def _row(event: PadSample | PalmSample) -> tuple[float, ...]:
    """An event as a row of numbers for C."""
    if isinstance(event, PalmSample):
        return 0.0, event.t_sample, *event.angles, *(event.rates or _MISSING), *(event.accelerations or _MISSING)
    return event.pad, event.t_sample, event.s, math.nan if event.force is None else event.force, *_MISSING, *_MISSING


def _blank(bank: CompiledBank) -> tuple[FloatArray, ...]:
    full, n = bank.full_size, bank.n
    return np.zeros(full // bank.block), np.zeros((full, n)), np.zeros((full, n, n)), np.zeros(full), np.zeros(full)
