"""Event logs of the pivoting grasp: an object held in a freely turning gripper and dragged over one pad."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from palmd.aliases import PIVOT_RESULT, with_former_names
from palmd.devices.pad import MARGIN_MM
from palmd.events import ObserverName, PadSample
from palmd.jsonvalues import column, or_none
from palmd.observer.pivot.incremental import SimulatedSmoothing, as_fed
from palmd.observer.pivot.observer import pivot_observer
from palmd.observer.pivot.reconstruct import PivotReconstruction, reconstruct
from palmd.outlinefile import Outline
from palmd.pivot_messages import estimate_fields, shape_fields
from palmd.record import verdict
from palmd.record.eventlog import calibration_sds
from palmd.record.logline import (
    BadLineError,
    Line,
    block,
    not_negative,
    number,
    optional,
    positive,
    read_vibration,
    shown,
)
from palmd.record.outline_files import curves_factory
from palmd.record.replay import TICKS_PER_SHAPE, TickFields, feed_ticks
from palmd.record.systems import NotYetError, Reconstructed, SystemLog
from palmd.system.description import PadSensor
from palmd.system.pivot import GripperSample, PivotEvent, PivotRig

_MAX_DISTANCE_M = 1.0
_PLAN = ("vx_m_s", "ax_m_s2", "vz_m_s", "az_m_s2")

_NO_MASS = (
    "mass: a rigid gripper carries an unknown share of the weight; only mass times centre of mass and the inertia about"
    " the pivot affect the pad (moment_kg_m, inertia_pivot_kg_m2), so com_from_pivot_m and inertia_pivot_m2 have no"
    " value"
)

PivotLog = SystemLog[PivotRig, PivotEvent]
"""Its events are in file order."""


class PivotLogParser:
    """Parser for logs of the pivoting grasp."""

    kinds = ("pad", "arm")

    def rig(self, line: Line) -> PivotRig:
        """Parse gripper and pad from line 1."""
        gripper = block(line, "gripper")
        vertical = gripper.get("vertical")
        if vertical not in ("rigid", "float"):
            raise BadLineError(f"gripper.vertical must be rigid or float, got {shown(vertical)}")
        measured = gripper.get("z_measured", True)
        if not isinstance(measured, bool):
            raise BadLineError(f"gripper.z_measured must be true or false, got {shown(measured)}")
        slides = vertical == "float"
        default = PivotRig()
        pad = block(line, "pad")
        sensor = replace(
            PadSensor(),
            length=positive(pad, "length_m"),
            noise=positive(pad, "noise_m"),
            resolution=not_negative(pad, "resolution_m"),
            force_scale_std=positive(line, "force_scale_std"),
            force_resolution=not_negative(line, "force_resolution_n", PadSensor().force_resolution),
        )
        rig = PivotRig(
            gravity=positive(line, "gravity_m_s2"),
            vertical=vertical,
            z_measured=measured,
            carriage_mass=positive(gripper, "carriage_mass_kg") if slides else 0.0,
            carriage_damping=not_negative(gripper, "damping_n_s_m", 0.0) if slides else 0.0,
            arm_noise=positive(line, "arm_noise_m", default.arm_noise),
            pad=sensor,
            vibration=read_vibration(line),
        )
        return rig.known_to(calibration_sds(line))

    def events(self, t: float, line: Line, rig: PivotRig) -> Iterator[PivotEvent | None]:
        """Yield the pad reading, the gripper position, or both; None for a reading off the pad."""
        if "pad" in line:
            if type(line["pad"]) is not int or line["pad"] != 1:
                raise BadLineError(f"pad must be 1, as a pivoting grasp has one pad; got {shown(line['pad'])}")
            s = number(line, "s_m")
            if abs(s) > _MAX_DISTANCE_M:
                raise BadLineError(f"s_m is {s:g}, not a position on a pad; the unit is metres")
            on_pad = 0.0 < s <= rig.pad.length + MARGIN_MM * 1e-3
            yield PadSample(t, 1, s, optional(line, "force_n")) if on_pad else None
        if "arm" in line:
            yield _gripper_sample(t, block(line, "arm"))

    def log(self, rig: PivotRig, events: tuple[PivotEvent, ...], notes: tuple[str, ...]) -> PivotLog:
        """Build the log from rig, events and notes."""
        return SystemLog(rig, events, notes)


class Pivot(PivotLogParser):
    """See `palmd.record.systems.System`."""

    name = "pivot"

    def known_to(self, log: PivotLog, sds: Mapping[str, float]) -> PivotLog:
        return replace(log, rig=log.rig.known_to(sds))

    def reconstruct(self, log: PivotLog, seed: int, progress: Callable[[str], None] | None = None) -> Reconstructed:
        del seed, progress  # all starts are tried
        answer = reconstruct(log.events, log.rig)
        line = as_line(answer, log.rig)
        text = verdict.in_one_line(line, summary(answer) if answer.converged else "")
        curves = curves_factory(answer.theta, answer.h, answer.h_sd, answer.touched, mass_kg=answer.mass)
        return Reconstructed(line, text, curves, line["reason"] or "")

    def estimate(self, log: PivotLog, observer: ObserverName, outlines: Sequence[Outline]) -> Iterator[TickFields]:
        del observer
        if outlines:
            raise NotYetError("a pivoting grasp cannot recognise stored outlines")
        return self._ticks(log)

    def _ticks(self, log: PivotLog) -> Iterator[TickFields]:
        live = pivot_observer(log.rig, SimulatedSmoothing(log.rig))
        slides = log.rig.vertical == "float"
        events = (as_fed(event, slides=slides) for event in sorted(log.events, key=lambda event: event.t_sample))
        for tick, t in feed_ticks(log, events, live):
            estimate, shape = live.estimate(t), live.shape(t) if tick % TICKS_PER_SHAPE == 0 else None
            yield TickFields(tick, t, estimate_fields(estimate), None if shape is None else shape_fields(shape))


SYSTEM = Pivot()


def as_line(answer: PivotReconstruction, rig: PivotRig) -> Line:
    """The result as `palmd reconstruct` writes it: SI units, the unit in each name, None for unknown values.

    `unobservable` lists in words the quantities that the run cannot determine.
    """
    trajectory = {"t": answer.t, "psi_rad": answer.psi, "omega0_rad_s": answer.omega0}
    line = {
        "system": SYSTEM.name,
        **verdict.verdict(answer.converged, answer.touched, answer.reason),
        "chi2": or_none(answer.chi2),
        "theta_rad": answer.theta.tolist(),
        "hP_m": column(answer.h),
        "hP_sd_m": column(answer.h_sd),
        "touched": None if answer.touched is None else answer.touched.astype(int).tolist(),
        "mu": or_none(answer.mu),
        "mu_sd": or_none(answer.mu_sd),
        "com_from_pivot_m": column(answer.com),
        "com_from_pivot_sd_m": column(answer.com_sd),
        "inertia_pivot_m2": or_none(answer.inertia),
        "inertia_pivot_sd_m2": or_none(answer.inertia_sd),
        "mass_kg": or_none(answer.mass),
        "mass_sd_kg": or_none(answer.mass_sd),
        "moment_kg_m": column(answer.moment),
        "moment_sd_kg_m": column(answer.moment_sd),
        "inertia_pivot_kg_m2": or_none(answer.inertia_kg),
        "inertia_pivot_sd_kg_m2": or_none(answer.inertia_kg_sd),
        "unobservable": [_NO_MASS] if rig.vertical == "rigid" else [],
        "trajectory": {name: column(values) for name, values in trajectory.items()} if len(answer.t) else None,
        "seconds": or_none(answer.seconds),
    }
    return with_former_names(PIVOT_RESULT, line)


def summary(answer: PivotReconstruction) -> str:
    """One line on a converged result: outline's standard deviation where touched (RMS), friction, mass or moment."""
    if answer.h_sd is None or answer.touched is None or answer.moment is None or answer.moment_sd is None:
        raise ValueError("there is no outline")
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    moment, moment_sd = float(np.hypot(*answer.moment)), float(answer.moment_sd.max())
    weighed = (
        f"mass {answer.mass * 1e3:.1f} ± {answer.mass_sd * 1e3:.1f} g"
        if math.isfinite(answer.mass)
        else f"mass times distance from the pivot {moment * 1e6:.1f} ± {moment_sd * 1e6:.1f} g mm, mass unknown"
    )
    return (
        f"outline about the pivot ± {band * 1e6:.1f} µm on {np.mean(answer.touched):.0%} of the normals,"
        f" mu {answer.mu:.4f} ± {answer.mu_sd:.4f}, {weighed}, {answer.seconds:.1f} s"
    )


def _gripper_sample(t: float, arm: Line) -> GripperSample:
    x, z = number(arm, "x_m"), optional(arm, "z_m")
    for name, value in (("x_m", x), ("z_m", z)):
        if value is not None and abs(value) > _MAX_DISTANCE_M:
            raise BadLineError(f"{name} is {value:g}, not a position near a pad; the unit is metres")
    vx, ax, vz, az = (optional(arm, name) for name in _PLAN)
    return GripperSample(t, x, z, vx, ax, vz, az)
