"""A comparison with a camera as text and as JSON, together with the results of the paper's hardware. Pure."""

from __future__ import annotations

import math
from typing import Any

from palmd.report.camera_frame import CameraClock, CameraFrame
from palmd.report.ground_truth import CameraComparison, CameraErrors, CameraOutlineErrors

# Digitised from figure 3.15: ψ (rad) and its skill relative to an object at rest, outline (m), touched fraction.
PAPER_PSI_RMS_RAD, PAPER_PSI_SKILL = 0.27, 0.08
PAPER_OUTLINE_RMS_M, PAPER_OUTLINE_P90_M, PAPER_TOUCHED = 1.9e-3, 2.9e-3, 0.54


def report_lines(found: CameraComparison) -> list[str]:
    """One line each on clock, frame, orientation, position, outline, and omitted spans."""
    lines = [_clock(found.clock)]
    if found.frame is not None:
        lines.append(_frame(found.frame))
    psi = found.psi
    lines.append(
        f"orientation: RMS {psi.rms:.4f} rad, max {psi.greatest:.4f} rad, skill {psi.skill:.1%} relative to no motion"
        f" (paper: {PAPER_PSI_RMS_RAD} rad, {PAPER_PSI_SKILL:.0%})"
    )
    if found.mark is not None:
        mark = found.mark
        lines.append(f"position: RMS {mark.rms * 1e3:.2f} mm, max {mark.greatest * 1e3:.2f} mm, skill {mark.skill:.1%}")
    if found.outline is not None:
        one = found.outline
        lines.append(
            f"outline: RMS {one.e_h * 1e3:.3f} mm, p90 {one.p90 * 1e3:.3f} mm, max {one.greatest * 1e3:.3f} mm on "
            f"{one.touched:.0%} touched (paper: {PAPER_OUTLINE_RMS_M * 1e3} mm, {PAPER_OUTLINE_P90_M * 1e3} mm, "
            f"{PAPER_TOUCHED:.0%})"
        )
    return [*lines, *found.omitted]


def as_line(found: CameraComparison) -> dict[str, Any]:
    """All results, the unit in each name; None for what was not compared, NaN for unknown values."""
    clock = found.clock
    return {
        "rows": len(found.t),
        "clock": {
            "offset_s": clock.offset, "offset_sd_s": clock.offset_sd, "at_camera_s": clock.t_middle,
            "drift_ppm": clock.drift * 1e6, "drift_sd_ppm": clock.drift_sd * 1e6,
        },
        "frame": None if found.frame is None else _frame_line(found.frame),
        "psi": _errors(found.psi, "rad"),
        "mark": None if found.mark is None else _errors(found.mark, "m"),
        "outline": None if found.outline is None else _outline(found.outline),
        "paper": {
            "psi_rms_rad": PAPER_PSI_RMS_RAD, "psi_skill": PAPER_PSI_SKILL, "e_h_m": PAPER_OUTLINE_RMS_M,
            "p90_m": PAPER_OUTLINE_P90_M, "touched": PAPER_TOUCHED,
        },
        "left_out": list(found.omitted),
    }  # fmt: skip


def _clock(clock: CameraClock) -> str:
    drift = "drift not determined, as the record is too short"
    if math.isfinite(clock.drift):
        drift = f"drift {clock.drift * 1e6:.1f} ± {clock.drift_sd * 1e6:.1f} ppm"
    return f"clock: log time = camera time {clock.offset:+.4f} s ± {clock.offset_sd * 1e3:.1f} ms, {drift}"


def _frame(frame: CameraFrame) -> str:
    (x, y), (mark_x, mark_y) = frame.place, frame.mark
    return (
        f"frame: world origin at ({x * 1e3:.2f}, {y * 1e3:.2f}) mm, rotated by {math.degrees(frame.angle):.2f} ± "
        f"{math.degrees(frame.angle_sd):.2f}°; the mark at ({mark_x * 1e3:.2f}, {mark_y * 1e3:.2f}) mm from the centre "
        f"of mass, ± {max(frame.mark_sd) * 1e3:.2f} mm"
    )


def _frame_line(frame: CameraFrame) -> dict[str, float]:
    line = {"angle_rad": frame.angle, "angle_sd_rad": frame.angle_sd}
    for name in ("place", "mark"):
        for axis, value, sd in zip("xy", getattr(frame, name), getattr(frame, f"{name}_sd"), strict=True):
            line |= {f"{name}_{axis}_m": value, f"{name}_{axis}_sd_m": sd}
    return line


def _errors(errors: CameraErrors, unit: str) -> dict[str, float]:
    return {
        f"rms_{unit}": errors.rms, f"max_{unit}": errors.greatest, f"still_rms_{unit}": errors.static_rms,
        "skill": errors.skill,
    }  # fmt: skip


def _outline(errors: CameraOutlineErrors) -> dict[str, float]:
    return {
        "e_h_m": errors.e_h, "max_m": errors.greatest, "p90_m": errors.p90, "touched": errors.touched,
        "rotation_rad": errors.rotation,
    }  # fmt: skip
