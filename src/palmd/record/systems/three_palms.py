"""Event logs of three flat palms in space: reading, estimation and reconstruction."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from palmd.events import FloatArray, ObserverName, PadSample, PalmSample
from palmd.jsonvalues import column, or_none
from palmd.model.rotation import quaternions
from palmd.observer.three_palms.incremental import SimulatedIncrementalSmoother
from palmd.observer.three_palms.live import BodyObserver
from palmd.observer.three_palms.path import JointPath, joint_path
from palmd.observer.three_palms.reconstruct import BodyReconstruction, reconstruct
from palmd.observer.three_palms.record import PadReadings
from palmd.outlinefile import Outline
from palmd.record import verdict
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
from palmd.record.replay import TICKS_PER_SHAPE, TickFields, feed_ticks
from palmd.record.surface import Mesh
from palmd.record.systems import NotYetError, Reconstructed, SystemLog
from palmd.system.reasons import Code, Reason
from palmd.system.three_palms import JOINTS, MECHANISM, PALMS, RELATIONS, PadPlane, ThreePalmsRig
from palmd.system.three_palms import SYSTEM as NAME
from palmd.three_palms_messages import estimate_fields, shape_fields

EDGE_M = 0.01  # distance beyond the pad's edge up to which a reading is accepted


ThreePalmsLog = SystemLog[ThreePalmsRig, PadSample | PalmSample]
"""Its events are in the order of their sample times."""


class ThreePalms:
    """See `palmd.record.systems.System`."""

    name = NAME
    kinds = ("pad", "joints")

    def rig(self, line: Line) -> ThreePalmsRig:
        mechanism = line.get("mechanism")
        if mechanism != MECHANISM:
            raise BadLineError(f"rig.mechanism must be {MECHANISM}, got {shown(mechanism)}")
        pad, default, vibration = block(line, "pad"), ThreePalmsRig(), read_vibration(line)
        if vibration.relation not in RELATIONS:
            given = shown(vibration.relation)
            raise BadLineError(f"vibration.relation must be {' or '.join(RELATIONS)} for three palms, got {given}")
        return ThreePalmsRig(
            gravity=positive(line, "gravity_m_s2"),
            pad=PadPlane(
                side=positive(pad, "side_m"),
                noise=positive(pad, "noise_m"),
                resolution=not_negative(pad, "resolution_m"),
                force_scale_std=positive(line, "force_scale_std", default.pad.force_scale_std),
            ),
            angle_noise=positive(line, "palm_angle_noise_rad", default.angle_noise),
            vibration=vibration,
        )

    def events(self, t: float, line: Line, rig: ThreePalmsRig) -> Iterator[PadSample | PalmSample | None]:
        if "pad" in line:
            pad = line["pad"]
            if type(pad) is not int or pad not in PALMS:
                raise BadLineError(f"pad must be {', '.join(map(str, PALMS[:-1]))} or {PALMS[-1]}, got {shown(pad)}")
            a, b = number(line, "a_m"), number(line, "b_m")
            force = optional(line, "force_n")
            off_pad = max(abs(a), abs(b)) > rig.pad.side + EDGE_M
            yield None if off_pad else PadSample(t, pad, b, force, a)
        if "joints" in line:
            joints = block(line, "joints")
            angle = _joints(joints, "angle_rad")
            if angle is None:
                raise BadLineError("angle_rad is missing")
            rate, acceleration = _joints(joints, "rate_rad_s"), _joints(joints, "acc_rad_s2")
            planned = rate is not None and acceleration is not None
            yield PalmSample(t, angle, rate, acceleration) if planned else PalmSample(t, angle)

    def log(self, rig: ThreePalmsRig, events: tuple[Any, ...], notes: tuple[str, ...]) -> ThreePalmsLog:
        return SystemLog(rig, tuple(sorted(events, key=lambda event: event.t_sample)), notes)

    def known_to(self, log: ThreePalmsLog, sds: Mapping[str, float]) -> ThreePalmsLog:
        if any(sds.values()):
            raise NotYetError("three palms in space are assumed to be exactly as described: omit --calibration-sd")
        return log

    def reconstruct(
        self, log: ThreePalmsLog, seed: int, progress: Callable[[str], None] | None = None
    ) -> Reconstructed:
        del seed, progress  # deterministic and fast
        joints, readings = path_and_readings(log)
        if joints is None:
            reason = Reason(Code.NO_ARM_REPORTS, "the joints are never reported")
            rejected = verdict.verdict(False, None, reason)
            return Reconstructed(rejected, verdict.in_one_line(rejected, ""), None, reason)
        answer = reconstruct(joints, readings, log.rig)
        line = as_line(answer)
        text = verdict.in_one_line(line, summary(answer) if answer.converged else "")
        mesh = (
            Mesh(answer.points, answer.triangles, answer.h_sd, answer.touched)
            if answer.converged and answer.points is not None
            else None
        )
        return Reconstructed(line, text, None, line["reason"] or "", mesh)

    def estimate(self, log: ThreePalmsLog, observer: ObserverName, outlines: Sequence[Outline]) -> Iterator[TickFields]:
        del observer
        if outlines:
            raise NotYetError("three palms in space cannot recognise stored outlines")
        return self._ticks(log)

    def _ticks(self, log: ThreePalmsLog) -> Iterator[TickFields]:
        live = BodyObserver(log.rig, SimulatedIncrementalSmoother(log.rig))
        for tick, t in feed_ticks(log, log.events, live):
            estimate = live.estimate(t)
            shape = live.shape(t) if tick % TICKS_PER_SHAPE == 0 else None
            published = None if shape is None else shape_fields(shape, estimate.object_count, estimate.valid)
            yield TickFields(tick, t, estimate_fields(estimate), published)


SYSTEM = ThreePalms()


def _joints(line: Line, key: str) -> tuple[float, ...] | None:
    values = line.get(key)
    if values is None:
        return None
    if not isinstance(values, list) or len(values) != len(JOINTS):
        raise BadLineError(f"{key} must be a list of {len(JOINTS)} numbers, got {shown(values)}")
    return tuple(number({key: value}, key) for value in values)


def path_and_readings(log: ThreePalmsLog) -> tuple[JointPath | None, PadReadings]:
    """The joints' path and the readings in time order; the path is None with fewer than 8 joint reports."""
    reports = {event.t_sample: event for event in log.events if isinstance(event, PalmSample)}
    contacts = [event for event in log.events if isinstance(event, PadSample)]
    readings = PadReadings(
        np.array([each.t_sample for each in contacts]),
        np.array([each.pad - 1 for each in contacts], dtype=np.int64),
        np.array([[each.across, each.s] for each in contacts]).reshape(-1, 2),
        np.array([math.nan if each.force is None else each.force for each in contacts]),
    )
    if len(reports) < 8:
        return None, readings
    plans = [(each.rates, each.accelerations) for each in reports.values()]
    plan: FloatArray | None = None if any(rates is None for rates, _ in plans) else np.array(plans)
    t, angle = np.array(list(reports)), np.array([each.angles for each in reports.values()])
    return joint_path(t, angle, plan, log.rig.angle_noise), readings


def as_line(answer: BodyReconstruction) -> Line:
    """The result as `palmd reconstruct` writes it: SI units, the unit in each name, None for unknown values."""
    shape = answer.h is not None
    return {
        **verdict.verdict(answer.converged, answer.touched, answer.reason),
        "chi2": or_none(answer.chi2),
        "directions": answer.directions.round(9).tolist(),
        "triangles": answer.triangles.tolist(),
        "h_m": column(answer.h),
        "h_sd_m": column(answer.h_sd),
        "touched": None if answer.touched is None else answer.touched.astype(int).tolist(),
        "points_m": column(answer.points),
        "inertia_m2": column(answer.inertia),
        "inertia_sd_m2": column(answer.inertia_sd),
        "mu": or_none(answer.mu),
        "mu_sd": or_none(answer.mu_sd),
        "mass_kg": or_none(answer.mass),
        "mass_sd_kg": or_none(answer.mass_sd),
        "trajectory": {
            "t": answer.t.tolist(),
            "quat_xyzw": quaternions(answer.R).tolist(),
            "omega_rad_s": answer.omega.tolist(),
            "com_m": answer.centre.tolist(),
            "contacts_body_m": answer.contacts.tolist(),
        } if shape else None,
        "seconds": answer.seconds,
    }  # fmt: skip


def summary(answer: BodyReconstruction) -> str:
    """One line on a converged result."""
    if answer.h_sd is None or answer.touched is None:
        raise ValueError("there is no shape")
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    parts = [
        f"surface ± {band * 1e6:.0f} µm on {np.mean(answer.touched):.0%} of the directions",
        f"mu {answer.mu:z.4f} ± {answer.mu_sd:.4f}",
        f"mass {answer.mass * 1e3:.2f} ± {answer.mass_sd * 1e3:.2f} g" if math.isfinite(answer.mass) else "no mass",
        f"{answer.seconds:.1f} s",
    ]
    return ", ".join(parts)
