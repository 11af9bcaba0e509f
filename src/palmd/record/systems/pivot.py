"""Logs of the pivoting grasp: an object held in a freely turning gripper and dragged over one pad."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from palmd.devices.pad import MARGIN_MM
from palmd.events import PadSample
from palmd.record.logline import BadLineError, Line, block, not_negative, number, optional, positive, shown
from palmd.system.description import AS_CALIBRATED, CALIBRATION_KEYS, PadSensor
from palmd.system.pivot import GripperSample, PivotEvent, PivotRig

_FARTHEST_M = 1.0
_PLAN = ("vx_m_s", "ax_m_s2", "vz_m_s", "az_m_s2")


@dataclass(frozen=True, slots=True)
class PivotLog:
    """A run: the rig, its events in the order of the file, and notes on what was left out of them."""

    rig: PivotRig
    events: tuple[PivotEvent, ...]
    notes: tuple[str, ...] = ()


class PivotForm:
    """How logs of the pivoting grasp are read."""

    kinds = ("pad", "arm")

    def rig(self, line: Line) -> PivotRig:
        """What line 1 says of gripper and pad."""
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
        )
        return rig.known_to(_calibration_sds(line))

    def events(self, t: float, line: Line, rig: PivotRig) -> Iterator[PivotEvent | None]:
        """A reading of the pad, or where the arm has the pivot, or both."""
        if "pad" in line:
            if type(line["pad"]) is not int or line["pad"] != 1:
                raise BadLineError(f"pad must be 1: a pivoting grasp has one, got {shown(line['pad'])}")
            s = number(line, "s_m")
            if abs(s) > _FARTHEST_M:
                raise BadLineError(f"s_m is {s:g}, which is no place on a pad; it is in metres")
            on_it = 0.0 < s <= rig.pad.length + MARGIN_MM * 1e-3
            yield PadSample(t, 1, s, optional(line, "force_n")) if on_it else None
        if "arm" in line:
            yield _gripper_sample(t, block(line, "arm"))

    def log(self, rig: PivotRig, events: tuple[PivotEvent, ...], notes: tuple[str, ...]) -> PivotLog:
        """The run."""
        return PivotLog(rig, events, notes)


def _gripper_sample(t: float, arm: Line) -> GripperSample:
    x, z = number(arm, "x_m"), optional(arm, "z_m")
    for name, value in (("x_m", x), ("z_m", z)):
        if value is not None and abs(value) > _FARTHEST_M:
            raise BadLineError(f"{name} is {value:g}, which is no place near a pad; it is in metres")
    vx, ax, vz, az = (optional(arm, name) for name in _PLAN)
    return GripperSample(t, x, z, vx, ax, vz, az)


def _calibration_sds(line: Line) -> Mapping[str, float]:
    """How well the rig's constants are known: as the log says, else as calibrated, or known if all it names are."""
    told: dict[str, Any] = {} if line.get("calibration_sd") is None else block(line, "calibration_sd")
    named = [value for value in told.values() if value is not None]
    default = dict.fromkeys(AS_CALIBRATED, 0.0) if named and not any(named) else AS_CALIBRATED
    return {name: not_negative(told, CALIBRATION_KEYS[name], each) for name, each in default.items()}
