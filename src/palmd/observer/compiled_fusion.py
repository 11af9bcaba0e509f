"""What `model/fusion.c` computes for a bank of shape maps, and the memory that it does so in; safe inside the loop.

Each class here has a twin in NumPy, which serves where there is no compiler and is what it is checked against:
`palms.PalmTracker`, `filters.shape_map.ShapeFilters` and, for whole sequences of events, `fusion.Fusion`.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from palmd.events import Event, FloatArray, PadLift, PadSample, PalmMotion, PalmSample
from palmd.model import shape_map
from palmd.model.compiled import EXPORTED, Library
from palmd.model.dynamics import VIBRATION_ERROR_INPUTS
from palmd.model.outputs import FRICTION_INPUT, NAMED, RIG_INPUTS
from palmd.model.smoothing import RIG_CONSTANTS, R
from palmd.observer.filters.base import pad_update
from palmd.observer.history import EVENTS
from palmd.observer.palms import repetitions
from palmd.system.mechanism import JOINTS, PALMS

if TYPE_CHECKING:
    from palmd.observer.bank import Bank, Belief
    from palmd.observer.rig_error import RigError

MOST_STATES = 64
_JOINTS = len(JOINTS)
_TOO_LATE = -2
_UNTOLD = (math.nan,) * _JOINTS
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
        *_doubles("t", "t_start", "repeated"), ("variances", _Joints), *_pointers("faded"),
        *((name, ctypes.c_long) for name in ("early", "count", "waiting", "moved")),
        ("fused", _Fused * EVENTS), ("queue", _FusedReading * (EVENTS + 1)),
    )  # fmt: skip


class _Rows:
    """Where a table begins that C reads, row by row: found out once for as long as it is the same one."""

    def __init__(self) -> None:
        self._given: FloatArray | None = None

    def at(self, table: FloatArray) -> int:
        """Its address, good until the next call."""
        if table is not self._given:
            self._given, self._held = table, np.ascontiguousarray(table)
            self._address: int = self._held.ctypes.data
        return self._address


class Routines:
    """The functions of `model/fusion.c` in one compiled library of shape maps."""

    def __init__(self, library: Library):
        """Raises RuntimeError where their sizes are not the model's."""
        self.library = ctypes.CDLL(str(library.path))
        of_pads = (R.ZERO, R.SCALE, R.SAGITTA, R.LAG, R.STANDOFF)
        constants = (*of_pads, R.TILT, R.TURN, R.FRICTION, R.FORCE, R.KAPPA, RIG_CONSTANTS)
        inputs = (RIG_INPUTS, FRICTION_INPUT, VIBRATION_ERROR_INPUTS.start)
        sizes = (_JOINTS, *inputs, len(NAMED), MOST_STATES, EVENTS, shape_map.Z.SHAPE, *constants)
        if tuple((ctypes.c_long * len(sizes)).in_dll(self.library, "fusion_sizes")) != sizes:
            raise RuntimeError("model/fusion.c has other sizes than the model")
        pointer, number, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_long
        of_bank = (pointer, pointer, pointer)
        self.palms_at = self._bound("palms_at", pointer, number, pointer)
        self.palms_variance = self._bound("palms_variance", pointer, number, pointer, pointer)
        self.palms_feed = self._bound("palms_feed", pointer, pointer)
        self.carry = self._bound("carry", *of_bank, number, number, number)
        self.read_pad = self._bound("read_pad", *of_bank, pointer, number, number)
        self.follow = self._bound("follow", *of_bank, pointer, integer, pointer, pointer, gives=integer)
        self.fade = self._bound("fade", pointer, integer, number, integer, integer, pointer, pointer)
        self.lift = self._bound("lift", pointer, integer, pointer, integer, gives=integer)
        self.falls_below = self._bound("falls_below", pointer, integer, pointer, integer, gives=integer)
        told = (pointer, pointer, pointer)
        self.named = self._bound("named", *of_bank, integer, number, number, pointer, integer, integer, *told)
        self.disagreement = self._bound("disagreement", *of_bank, number, number, integer, pointer, gives=integer)
        self.add = self._bound("add", pointer, *of_bank, pointer, gives=integer)
        self.fuse = self._bound("fuse", pointer, *of_bank, gives=integer)

    def address(self, kernel: str) -> int:
        """Where a kernel begins."""
        return ctypes.cast(self.library[EXPORTED + kernel], ctypes.c_void_p).value or 0

    def _bound(self, name: str, *arguments: type, gives: type | None = None) -> Callable[..., int]:
        function = self.library[name]
        function.argtypes, function.restype = arguments, gives
        return function


class CompiledPalms:
    """As `palms.PalmTracker`."""

    def __init__(self, routines: Routines, angle_noise: float):
        """`angle_noise` is the one-sigma of a measured palm angle (rad)."""
        self._does = routines
        self._now = _Palms(t=-math.inf, moved=0.0, plan_t=math.nan, variance=angle_noise**2)
        self.address = ctypes.addressof(self._now)
        self.jerk: FloatArray = np.ctypeslib.as_array(self._now.jerk)
        self._report = _Report()
        self._report_at = ctypes.addressof(self._report)
        self._motion = (ctypes.c_double * (3 * _JOINTS))()
        self._motion_at = ctypes.addressof(self._motion)

    @property
    def known(self) -> bool:
        """Whether a report has come."""
        return self.t > -math.inf

    @property
    def t(self) -> float:
        """Time of the last report; -inf before the first."""
        return float(self._now.t)

    @property
    def repeated(self) -> float:
        """The `repetitions` of what is read now."""
        return float(repetitions(self._now.t - self._now.moved)) if self.known else 1.0

    def sd(self, t: float) -> tuple[FloatArray, FloatArray]:
        """One-sigma of both angles (rad) and of both rates (rad/s) at `t` (s)."""
        angles, rates = np.empty(_JOINTS), np.empty(_JOINTS)
        self._does.palms_variance(self.address, t, angles.ctypes.data, rates.ctypes.data)
        return np.sqrt(angles), np.sqrt(rates)

    def feed(self, sample: PalmSample) -> None:
        """Fuse one report; reports older than the last one are ignored."""
        report = self._report
        report.t = sample.t_sample
        # by slices, which take lists as well: what has crossed to another process is of lists
        report.angles[:], report.rates[:] = sample.angles, sample.rates or _UNTOLD
        report.accelerations[:] = sample.accelerations or _UNTOLD
        self._does.palms_feed(self.address, self._report_at)

    def at(self, t: float) -> FloatArray:
        """Angles, rates and accelerations of all joints at `t`, seconds on the samples' clock."""
        self._does.palms_at(self.address, t, self._motion_at)
        return np.array(self._motion)

    def motion(self, t: float) -> PalmMotion:
        """The same as a value with names."""
        self._does.palms_at(self.address, t, self._motion_at)
        values = tuple(self._motion)
        return PalmMotion(values[:_JOINTS], values[_JOINTS : 2 * _JOINTS], values[2 * _JOINTS :])


class CompiledRig:
    """A `RigError` as C sees it."""

    def __init__(self, error: RigError):
        self.pressing = error.pressing
        lengths, curvatures = np.array(error.pad_lengths), np.array(error.curvatures)
        self._held = error.values, lengths, curvatures, error.s, error.most
        self._now = _RigError(*(each.ctypes.data for each in self._held))
        self.address = ctypes.addressof(self._now)


class CompiledBank:
    """What a bank of shape maps does with readings; `rig` is what `ShapeFilters.rig_error` says of the rig."""

    def __init__(self, routines: Routines, bank: Bank, rig_inputs: FloatArray, besides: Sequence[FloatArray]):
        """`rig_inputs` as `model.outputs.rig_inputs` gives them; C writes the friction asymmetry there.

        `besides` are two sets of variances that are added to those of `NAMED`: for use before a smoother has estimated
        the rig's constants, and after.
        """
        if bank.n > MOST_STATES:
            raise ValueError(f"there is room for {MOST_STATES} states, not {bank.n}")
        self.does = routines
        self.blocks = bank.blocks
        self.bank = bank
        self._rig_inputs = rig_inputs
        of_bank = "" if bank.block == 1 else "_block"
        kernels = [f"{name}{of_bank}" for name in ("predict", *map(pad_update, PALMS), "values")] + ["predict", "named"]
        (x0, x1), (P0, P1), score, nis, outcome, y, now = bank.memory()
        arrays = (each.ctypes.data for each in (x0, x1, P0, P1, score, nis, outcome, y, rig_inputs))
        self._now = _Bank(
            *map(routines.address, kernels), *arrays, ctypes.addressof(now), bank.n, bank.block, bank.memory_s
        )
        self.address = ctypes.addressof(self._now)
        self._y, self._variance, self._besides = _Named(), _Named(), tuple(_Named(*each) for each in besides)
        self._told = tuple(map(ctypes.addressof, (self._y, self._variance)))
        self._apart = _Named()
        self._apart_at = ctypes.addressof(self._apart)
        self._spread, self._rows = _Rows(), _Rows()
        self._believed_sd: FloatArray | None = None
        self._believed = np.zeros((0, bank.n))  # as variances
        self._reading = _FusedReading()
        self._reading_at = ctypes.addressof(self._reading)

    def reading(self, sample: PadSample, rig: CompiledRig) -> int:
        """The address of a reading, until the next one; ValueError for a pad that there is not."""
        if sample.pad not in PALMS:
            raise ValueError(f"there is no pad {sample.pad}")
        reading = self._reading
        reading.t, reading.s, reading.force, reading.pad = sample.t_sample, sample.s, rig.pressing(sample), sample.pad
        return self._reading_at

    def carry(self, rig: CompiledRig, palms: CompiledPalms, t: float, until: float, repeated: float) -> None:
        """As `Filters.carry`."""
        self.does.carry(self.address, palms.address, rig.address, t, until, repeated)

    def read(self, rig: CompiledRig, palms: CompiledPalms, sample: PadSample, variance: float, repeated: float) -> None:
        """Fuse one contact reading, one of `repeated` that share one error."""
        self.does.read_pad(self.address, palms.address, rig.address, self.reading(sample, rig), variance, repeated)

    def follow(
        self, rig: CompiledRig, palms: CompiledPalms, events: Sequence[Event], variances: FloatArray, t: float
    ) -> tuple[float, int]:
        """As `ShapeFilters.follow`."""
        rows = np.array([_row(event) for event in events if not isinstance(event, PadLift)])
        now = ctypes.c_double(t)
        at = (self.address, palms.address, rig.address, rows.ctypes.data, len(rows), variances.ctypes.data)
        read = self.does.follow(*at, ctypes.addressof(now))
        return now.value, read

    def fade(self, block: int, fraction: float, prior: Belief) -> None:
        """As `Bank.fade`."""
        first, last, _ = prior.which.indices(self.bank.n)
        mean = np.ascontiguousarray(prior.mean)
        if len(mean) < self.bank.size or mean.shape[1] != self.bank.n:
            raise ValueError(f"beliefs are of {self.bank.size} filters' {self.bank.n} states, not {mean.shape}")
        if prior.sd is not self._believed_sd or mean.shape != self._believed.shape:
            self._believed_sd = prior.sd
            self._believed = np.ascontiguousarray(np.broadcast_to(prior.sd, mean.shape) ** 2)
        at = mean.ctypes.data, self._believed.ctypes.data
        self.does.fade(self.address, block, fraction, first, last, *at)

    def lift(self, block: int, rows: FloatArray) -> bool:
        """As `Bank.lift`."""
        return self.does.lift(self.address, block, *self._checked(rows)) == 0

    def falls_below(self, member: int, rows: FloatArray) -> bool:
        """As `Bank.falls_below`."""
        return self.does.falls_below(self.address, member, *self._checked(rows)) != 0

    def _checked(self, rows: FloatArray) -> tuple[int, int]:
        if rows.shape[1] != self.bank.n:
            raise ValueError(f"rows are of {self.bank.n} states, not {rows.shape}")
        return self._rows.at(rows), len(rows)

    def named(
        self, rig: CompiledRig, palms: CompiledPalms, member: int, t: float, dt: float, spread: FloatArray | None
    ) -> tuple[list[float], list[float]]:
        """Values of `NAMED` and their variances for one filter, taken from `t` to `t + dt`.

        `spread` has a row for each of the filter's states, and perhaps one for each of the rig's constants.
        """
        by = (None, 0, 0) if spread is None else (self._spread.at(spread), *spread.shape)
        besides = ctypes.addressof(self._besides[spread is not None])
        self.does.named(self.address, palms.address, rig.address, member, t, dt, *by, besides, *self._told)
        return self._y[:], self._variance[:]

    def disagreement(
        self, rig: CompiledRig, palms: CompiledPalms, t: float, margin: float, one_gauge: bool
    ) -> list[float] | None:
        """As `Fusion.disagreement` at `t` (s), the rivals being within `margin` (nats) of the best."""
        at = (self.address, palms.address, rig.address)
        rivals = self.does.disagreement(*at, t, margin, one_gauge, self._apart_at)
        return self._apart[:] if rivals > 1 else None


class CompiledHistory:
    """Events in the order of their own times, each with the bank as it was before: as `history.History` and `Fusion`.

    `now.t` and `now.t_start` are those of `Fusion`.
    """

    def __init__(self, banks: Iterable[CompiledBank], variances: FloatArray):
        """`banks` are all that will ever be used; `variances` of each pad's readings (m²)."""
        self._memory = {id(bank): [_blank(bank) for _ in range(EVENTS)] for bank in banks}
        self.now = _Fusion(t=-math.inf, t_start=math.inf, variances=tuple(variances.tolist()))
        self._address = ctypes.addressof(self.now)

    def use(self, bank: CompiledBank, t_faded: FloatArray, early: bool) -> None:
        """From now on the events are fused into `bank`; none can be undone yet. `t_faded` as in `Forgetting`."""
        self._bank, self._t_faded = bank, t_faded
        now = self.now
        now.faded, now.early = t_faded.ctypes.data, early
        now.count = now.waiting = now.moved = 0
        for entry, arrays in zip(now.fused, self._memory[id(bank)], strict=True):
            entry.faded, entry.x, entry.P, entry.score, entry.nis = (each.ctypes.data for each in arrays)

    def clear(self) -> None:
        """What came before can no longer be undone."""
        self.now.count = 0

    def add(
        self, sample: PadSample, rig: CompiledRig, palms: CompiledPalms, forget: Callable[[int, float], None]
    ) -> bool:
        """Fuse one reading in its place; False when it is too late for that.

        `forget` is told the number of a block whenever that is to forget, and of how many readings of one place one is.
        """
        bank = self._bank
        does, at = bank.does, (bank.address, palms.address, rig.address)
        block = does.add(self._address, *at, bank.reading(sample, rig))
        while block >= 0:
            forget(block, self.now.repeated)
            block = does.fuse(self._address, *at)
        return block != _TOO_LATE


def _row(event: PadSample | PalmSample) -> tuple[float, ...]:
    """An event as C takes it."""
    if isinstance(event, PalmSample):
        return 0.0, event.t_sample, *event.angles, *(event.rates or _UNTOLD), *(event.accelerations or _UNTOLD)
    return event.pad, event.t_sample, event.s, math.nan if event.force is None else event.force, *_UNTOLD, *_UNTOLD


def _blank(bank: CompiledBank) -> tuple[FloatArray, ...]:
    full, n = bank.bank.full_size, bank.bank.n
    return np.zeros(bank.blocks), np.zeros((full, n)), np.zeros((full, n, n)), np.zeros(full), np.zeros(full)
