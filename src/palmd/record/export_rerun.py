"""Export of a recorded run for the rerun viewer: numbers as time series, the scene in 3-D, states and faults as a log.

The only module that needs the package rerun-sdk, an optional extra.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr

from palmd.events import FloatArray
from palmd.messages import Fields
from palmd.quantities import STATE
from palmd.record.run import AnyRun
from palmd.record.scene import Scene
from palmd.record.tables import flat

TIMELINE = "time"
ROWS = 10_000  # rows of a series per call of the library
_OUTLINE, _FAINT_OUTLINE = [0, 114, 178], [150, 190, 215]
_PALMS, _CENTRE = [120, 120, 120], [213, 94, 0]
_OUTLINE_RADIUS, _PALM_RADIUS, _CENTRE_RADIUS = 2e-4, 5e-4, 1e-3  # m


def write_rerun(run: AnyRun, path: Path, done: Callable[[], None]) -> None:
    """Write the file; times are the messages' stamps. `done` is called after each message. Raises RunError, OSError."""
    scenes = run.scene_builder()
    path.touch()  # raises OSError if the file cannot be written
    recording = rr.RecordingStream("palmd", recording_id=run.metadata["started"])
    recording.save(path)
    recording.log("scene", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    series: dict[str, _Series] = {}
    states = _StateLog()
    for message in run.messages():
        fields, t_ns = message.fields, message.publish_time_ns
        for name, value in flat(fields):
            if isinstance(value, int | float):
                entity = f"{message.topic}/{name.replace('.', '/')}"
                series.setdefault(entity, _Series(recording, entity)).add(t_ns, value)
        scene = None if scenes is None else scenes(message.topic, fields)
        if scene is not None:
            _log_scene(recording, t_ns, scene)
        if message.topic == STATE.name:
            states.log(recording, t_ns, fields)
        done()
    for each in series.values():
        each.send()
    recording.flush()
    recording.disconnect()


class _Series:
    """One field of one topic, collected and sent as columns, which is many times faster than row by row."""

    def __init__(self, recording: rr.RecordingStream, entity: str) -> None:
        self._recording, self._entity = recording, entity
        self._t_ns, self._values = array("q"), array("d")

    def add(self, t_ns: int, value: float) -> None:
        self._t_ns.append(t_ns)
        self._values.append(value)
        if len(self._t_ns) == ROWS:
            self.send()

    def send(self) -> None:
        if not self._t_ns:
            return
        times = rr.TimeColumn(TIMELINE, timestamp=np.array(self._t_ns).astype("datetime64[ns]"))
        self._recording.send_columns(self._entity, [times], rr.Scalars.columns(scalars=np.array(self._values)))
        self._t_ns, self._values = array("q"), array("d")


class _StateLog:
    """Logs state and faults when they change."""

    def __init__(self) -> None:
        self._last: tuple[str, tuple[str, ...]] = ("", ())

    def log(self, recording: rr.RecordingStream, t_ns: int, fields: Fields) -> None:
        state, faults = fields["state"], tuple(fields["faults"])
        if (state, faults) == self._last:
            return
        self._last = (state, faults)
        recording.set_time(TIMELINE, timestamp=np.datetime64(t_ns, "ns"))
        text = ": ".join([state, ", ".join(faults)] if faults else [state])
        recording.log(f"{STATE.name}/text", rr.TextLog(text, level="WARN" if faults else "INFO"))


def _log_scene(recording: rr.RecordingStream, t_ns: int, scene: Scene) -> None:
    recording.set_time(TIMELINE, timestamp=np.datetime64(t_ns, "ns"))
    recording.log("scene/palms", rr.LineStrips3D([_in_space(scene.palms)], radii=_PALM_RADIUS, colors=[_PALMS]))
    outline = rr.LineStrips3D(
        [_in_space(scene.outline)],
        radii=_OUTLINE_RADIUS,
        colors=[_OUTLINE if scene.valid else _FAINT_OUTLINE],
    )
    recording.log("scene/outline", outline)
    recording.log(
        "scene/centre_of_mass", rr.Points3D(_in_space(scene.centre[None]), radii=_CENTRE_RADIUS, colors=[_CENTRE])
    )


def _in_space(points: FloatArray) -> FloatArray:
    return np.column_stack([points, np.zeros(len(points))])
