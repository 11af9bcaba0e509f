"""Read trajectories and outlines for comparison, from recordings, results, and tracks of other systems."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmd.events import FloatArray
from palmd.record import is_recording
from palmd.record.resultfile import ResultError, read_result
from palmd.record.run import AnyRun, RunError, read_any_run
from palmd.record.track import TrackError, read_track

MIN_ROWS = 30
MAX_BYTES = 200_000_000
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


def read_pose_track(path: Path) -> PoseTrack:
    """Read the trajectory in a file of any format of `palmd compare`; raises TrackFileError. Not for the loop."""
    try:
        if not path.exists():
            raise TrackFileError(f"{path}: no such file; `palmd runs FOLDER` lists the recordings in a folder")
        if path.is_dir():
            raise TrackFileError(f"{path}: is a folder; name a file")
        if path.stat().st_size > MAX_BYTES and path.suffix != ".mcap":
            raise TrackFileError(f"{path}: longer than {MAX_BYTES // 1_000_000} MB")
        if path.suffix == ".csv":
            return _from_track(path)
        if path.suffix == ".json":
            return _from_result(path)
        if path.suffix in (".tum", ".txt"):
            return _from_tum(path)
        if is_recording(path):
            return _from_run(read_any_run(path))
    except OSError as error:
        raise TrackFileError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise TrackFileError(f"{path}: not text (UTF-8)") from None
    except (RunError, ResultError, TrackError) as error:
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


def _from_track(path: Path) -> PoseTrack:
    track = read_track(path)
    seen = np.isfinite(track.angle)
    return PoseTrack(
        path.name, **planar_fields(track.t[seen], track.mark[seen, 0], track.mark[seen, 1], track.angle[seen])
    )


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
        if rows and row[0] <= rows[-1][0]:
            raise TrackFileError(f"{path}:{number}: time is {row[0]:g} after {rows[-1][0]:g}: it must increase")
        rows.append(row)
    if len(rows) < MIN_ROWS:
        raise TrackFileError(f"{path}: {len(rows)} poses; {MIN_ROWS} are needed")
    table = np.array(rows)
    return PoseTrack(path.name, table[:, 0], table[:, 1:4], Rotation.from_quat(table[:, 4:]))


def _from_result(path: Path) -> PoseTrack:
    """Read a result of `palmd reconstruct`; planar ones have no position, which would need the palms' angles."""
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
    unknown = np.full(len(result.t), math.nan)
    body = OutlineShape(result.theta, result.h, result.touched.astype(np.float64))
    return PoseTrack(path.name, **planar_fields(result.t, unknown, unknown, result.psi, body=body))


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
