"""Read trajectories and outlines for comparison, from recordings, results, and tracks of other systems."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmd.events import FloatArray, PalmSample
from palmd.observer.palm_path import smoothed_path
from palmd.record import is_recording
from palmd.record.resultfile import ResultError, read_result
from palmd.record.run import AnyRun, RunError, read_any_run
from palmd.system.description import RigDescription

MIN_ROWS = 30
MAX_BYTES = 200_000_000
CAMERA_COLUMNS = ("t_s", "object_x_mm", "object_y_mm", "object_angle_deg")
EXTENT_MM = (0.2, 1000.0)  # plausible range of a mark's motion; others hint at a wrong unit
_TUM_COLUMNS = 8


class TrackFileError(Exception):
    """A file that cannot be compared; the text is one line `file: what is wrong`."""


@dataclass(frozen=True, slots=True)
class OutlineShape:
    """A planar outline: support function `h` (m) on normals `theta` (rad), and which normals were touched."""

    theta: FloatArray
    h: FloatArray
    touched: FloatArray


@dataclass(frozen=True, slots=True)
class PoseTrack:
    """n poses of one object at times `t` (s): `position` (n, 3) in m, NaN where unknown, and `rotation`.

    `valid` is the fraction of recorded ticks with a valid estimate, NaN for tracks; `truth` is the track of an emulated
    rig's truth, on the same clock and in the same frame.
    """

    name: str
    t: FloatArray
    position: FloatArray
    rotation: Rotation
    body: OutlineShape | None = None
    valid: float = math.nan
    truth: PoseTrack | None = None


def read_pose_track(path: Path, palms: tuple[RigDescription, Sequence[PalmSample]] | None = None) -> PoseTrack:
    """Read the trajectory in a file of any format of `palmd runs compare`; raises TrackFileError. Not for the loop.

    palms: rig and palm angles of a planar result's run, which determine its positions.
    """
    try:
        if not path.exists():
            raise TrackFileError(f"{path}: no such file; `palmd runs FOLDER` lists the recordings in a folder")
        if path.is_dir():
            raise TrackFileError(f"{path}: is a folder; name a file")
        if path.stat().st_size > MAX_BYTES and path.suffix != ".mcap":
            raise TrackFileError(f"{path}: longer than {MAX_BYTES // 1_000_000} MB")
        if path.suffix == ".csv":
            return _from_csv(path)
        if path.suffix == ".json":
            return _from_result(path, palms)
        if path.suffix in (".tum", ".txt"):
            return _from_tum(path)
        if is_recording(path):
            return _from_run(read_any_run(path))
    except OSError as error:
        raise TrackFileError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise TrackFileError(f"{path}: not text (UTF-8)") from None
    except (RunError, ResultError) as error:
        raise TrackFileError(str(error)) from None
    raise TrackFileError(f"{path}: is not a recording; tracks have the suffix .csv or .tum, results .json")


def planar_fields(t: FloatArray, x: FloatArray, y: FloatArray, angle: FloatArray, **more: Any) -> dict[str, Any]:
    """The fields of a `PoseTrack` for planar motion: x, y (m), angle (rad)."""
    position = np.stack([x, y, np.zeros_like(x)], axis=1)
    return {
        "t": t,
        "position": position,
        "rotation": Rotation.from_rotvec(angle[:, None] * np.array([0.0, 0.0, 1.0])),
        **more,
    }


def _from_csv(path: Path) -> PoseTrack:
    """Read a camera's track: columns `CAMERA_COLUMNS` in any order, others are ignored.

    The mark on the object and the object's arrow in the camera's frame; rows with empty cells or NaN show nothing.
    """
    rows: list[list[float]] = []
    with path.open(encoding="utf-8-sig", newline="") as stream:
        reader = csv.reader(stream)
        try:
            names = [cell.strip() for cell in next(reader, [])]
            for name in CAMERA_COLUMNS:
                if names.count(name) != 1:
                    fault = "twice" if name in names else "missing"
                    raise TrackFileError(
                        f"{path}:1: the column {name} is {fault}; required columns: {','.join(CAMERA_COLUMNS)}"
                    )
            columns = [names.index(name) for name in CAMERA_COLUMNS]
            for cells in filter(any, reader):
                where = f"{path}:{reader.line_num}"
                if len(cells) != len(names):
                    raise TrackFileError(f"{where}: {len(cells)} cells under {len(names)} columns")
                try:
                    row = [float(cells[i].strip() or "nan") for i in columns]
                except ValueError as error:
                    raise TrackFileError(f"{where}: {error}") from None
                _check_time(where, rows, row)
                rows.append(row)
        except csv.Error as error:
            raise TrackFileError(f"{path}:{max(reader.line_num, 1)}: {error}") from None
    table = np.array(rows).reshape(len(rows), len(CAMERA_COLUMNS))
    t, x, y, angle = table[np.isfinite(table).all(axis=1)].T
    if len(t) < MIN_ROWS:
        raise TrackFileError(f"{path}: {len(t)} rows show the object; {MIN_ROWS} are needed")
    extent = float(max(np.ptp(x), np.ptp(y)))
    if not EXTENT_MM[0] <= extent <= EXTENT_MM[1]:
        unit = "metres" if extent < EXTENT_MM[0] else "µm"
        raise TrackFileError(f"{path}: the object moves by {extent:.3g} mm: are object_x_mm and object_y_mm in {unit}?")
    return PoseTrack(path.name, **planar_fields(t, x * 1e-3, y * 1e-3, np.radians(angle)))


def _check_time(where: str, rows: Sequence[Sequence[float]], row: Sequence[float]) -> None:
    """Raise TrackFileError unless the row's time is a number after that of the last of `rows`."""
    before = rows[-1][0] if rows else -math.inf
    if not before < row[0] < math.inf:
        raise TrackFileError(f"{where}: time is {row[0]:g} after {before:g}: it must increase")


def _from_tum(path: Path) -> PoseTrack:
    """Read the format of the TUM RGB-D benchmark: lines `time x y z qx qy qz qw` (s, m), `#` begins a comment."""
    rows: list[list[float]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        if len(words) != _TUM_COLUMNS:
            raise TrackFileError(f"{path}:{number}: {len(words)} columns; a line is time x y z qx qy qz qw")
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise TrackFileError(f"{path}:{number}: a column is not a number") from None
        if not all(map(math.isfinite, row)) or not any(row[4:]):
            raise TrackFileError(f"{path}:{number}: a column is not finite, or the quaternion is zero")
        _check_time(f"{path}:{number}", rows, row)
        rows.append(row)
    if len(rows) < MIN_ROWS:
        raise TrackFileError(f"{path}: {len(rows)} poses; {MIN_ROWS} are needed")
    table = np.array(rows)
    return PoseTrack(path.name, table[:, 0], table[:, 1:4], Rotation.from_quat(table[:, 4:]))


def _from_result(path: Path, palms: tuple[RigDescription, Sequence[PalmSample]] | None) -> PoseTrack:
    """Read a result of `palmd reconstruct`; planar ones have a position only with the palms' angles."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        content = None  # read_result reports the error
    trajectory = content.get("trajectory") if isinstance(content, dict) else None
    if isinstance(trajectory, dict) and "quat_xyzw" in trajectory:
        try:
            t, quat, com = (np.array(trajectory[name], dtype=np.float64) for name in ("t", "quat_xyzw", "com_m"))
            return PoseTrack(path.name, t, com.reshape(len(t), 3), Rotation.from_quat(quat.reshape(len(t), 4)))
        except (KeyError, TypeError, ValueError) as error:
            raise TrackFileError(f"{path}: its trajectory cannot be read: {error}") from None
    result = read_result(path)
    com = np.full((len(result.t), 2), math.nan)
    if palms is not None:
        rig, samples = palms
        com = com_of(smoothed_path(list(samples), rig.palm_angle_noise).at(result.t)[:, :2], result.radii, rig)
    body = OutlineShape(result.theta, result.h, result.touched.astype(np.float64))
    return PoseTrack(path.name, **planar_fields(result.t, com[:, 0], com[:, 1], result.psi, body=body))


def com_of(angles: FloatArray, radii: FloatArray, rig: RigDescription) -> FloatArray:
    """The centre of mass in the world (n, 2), m: n1·c′ = r1, n2·c′ = r2 about the hinge O = B − L1 t1(φ1) of an arc.

    angles (n, 2): φ1, φ2 (rad); radii (2, n): r1, r2. Since n1·t2 = −sin φ2 and n2·t1 = sin φ2,
    c′ = (r2 t1 − r1 t2) / sin φ2.
    """
    directions = angles.cumsum(axis=1)
    along = np.stack([np.cos(directions), np.sin(directions)], axis=-1)  # t1 and −t2
    from_hinge = (radii[1, :, None] * along[:, 0] + radii[0, :, None] * along[:, 1]) / np.sin(angles[:, 1])[:, None]
    base, length = rig.arc
    return np.asarray(np.array(base) - length * along[:, 0] + from_hinge)


# -------------------------------------------------------------------------------------------------------- recordings


def _from_run(run: AnyRun) -> PoseTrack:
    """The valid estimates of the object with the most of them, and an emulated rig's truth if recorded."""
    topics = run.topics
    estimates: dict[int, list[dict[str, Any]]] = {}
    shapes: dict[int, dict[str, Any]] = {}
    truths: list[dict[str, Any]] = []
    true_object: dict[str, Any] = {}
    ticks, object_now, is_valid = 0, 0, False
    for message in run.messages(topics.estimate.name, topics.shape.name, topics.truth.name, topics.body.name):
        fields = message.fields
        if message.topic == topics.estimate.name:
            ticks, object_now, is_valid = ticks + 1, fields["object"], bool(fields["valid"])
            if is_valid:
                estimates.setdefault(object_now, []).append(fields)
        elif message.topic == topics.shape.name:
            if is_valid:
                shapes[object_now] = fields
        elif message.topic == topics.truth.name:
            truths.append(fields)
        else:
            true_object = fields
    if not estimates:
        raise TrackFileError(f"{run.path}: no estimate in it is valid; there is nothing to compare")
    best = max(estimates, key=lambda number: len(estimates[number]))
    count = sum(map(len, estimates.values()))
    if len(estimates[best]) < MIN_ROWS:
        raise TrackFileError(f"{run.path}: {count} valid estimates; {MIN_ROWS} of one object are needed")
    name = run.path.stem
    truth = None
    if len(truths) >= MIN_ROWS:
        truth = PoseTrack(f"truth of {name}", **_poses(truths), body=_body(true_object))
    body = _body(shapes.get(best, {}))
    return PoseTrack(name, **_poses(estimates[best]), body=body, valid=count / ticks, truth=truth)


def _poses(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Time, position and rotation from messages, by the fields of their system."""

    def column(name: str) -> FloatArray:
        return np.array([row.get(name, math.nan) for row in rows], dtype=np.float64)

    t = column("mono_ns") * 1e-9
    if "quat_xyzw" in rows[0]:
        position = np.stack([column(f"com_{axis}_m") for axis in "xyz"], axis=1)
        return {"t": t, "position": position, "rotation": Rotation.from_quat([row["quat_xyzw"] for row in rows])}
    x, y = ("com_x_m", "com_y_m") if "com_x_m" in rows[0] else ("x_m", "z_m")
    return planar_fields(t, column(x), column(y), column("psi_rad"))


def _body(shape: dict[str, Any]) -> OutlineShape | None:
    """A published or true planar outline; None for other shapes."""
    h = shape.get("h_m") or shape.get("hP_m")
    theta = shape.get("theta_rad")
    if not h or not theta:
        return None
    return OutlineShape(np.array(theta), np.array(h), np.array(shape.get("touched", [1.0] * len(h)), dtype=np.float64))
