"""Export of a recorded run as a LeRobot data set, format version 3.0: one episode, one frame per tick while tracking.

The only module that needs pandas and pyarrow, an optional extra. The format is described at
https://github.com/huggingface/lerobot: Parquet tables below `data` and `meta`, features and statistics in JSON. The
data set has no images.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palmd.messages import Fields
from palmd.quantities import Topic
from palmd.record import RunError
from palmd.record.run import AnyRun

VERSION = "v3.0"
CHUNK = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
FIRST = CHUNK.format(chunk_index=0, file_index=0)
ACTION, STATE, CONTACTS, OBJECT = "action", "observation.state", "observation.contacts", "observation.object"
COMMANDED = "_cmd_"
_SCALARS = {"timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64",
            "task_index": "int64"}  # fmt: skip


def write_lerobot(run: AnyRun, folder: Path, done: Callable[[], None]) -> None:
    """Write the data set; `done` is called after each message. Raises RunError if the arm never tracked, OSError.

    `action` are the commanded joints, `observation.state` the reported ones, `observation.contacts` the pad readings,
    `observation.object` the estimate with its validity first. Unknown values are 0.
    """
    columns = _columns(run, done)
    names = _names(run)
    count = len(columns[ACTION])
    if not count:
        raise RunError(f"{run.path}: the arm was never commanded, so there is no action to learn from")
    fps = round(run.config.loop.rate_hz)
    frames = {name: list(np.array(rows, dtype=np.float32)) for name, rows in columns.items()}
    number = np.arange(count, dtype=np.int64)
    zero = np.zeros(count, dtype=np.int64)
    scalars = {"timestamp": (number / fps).astype(np.float32), "frame_index": number, "episode_index": zero,
               "index": number, "task_index": zero}  # fmt: skip
    task = ", ".join(dict.fromkeys(columns_plans(run))) or "palmd"
    for inner in ("data/chunk-000", "meta/episodes/chunk-000"):
        (folder / inner).mkdir(parents=True)
    pd.DataFrame(frames | scalars).to_parquet(folder / "data" / FIRST, index=False)
    pd.DataFrame({"task_index": np.array([0])}, index=[task]).to_parquet(folder / "meta/tasks.parquet")
    stats = {name: _statistics(np.array(rows, dtype=np.float64)) for name, rows in columns.items()}
    stats |= {name: _statistics(values.astype(np.float64)[:, None]) for name, values in scalars.items()}
    episode = {
        "episode_index": [0], "tasks": [[task]], "length": [count], "data/chunk_index": [0], "data/file_index": [0],
        "dataset_from_index": [0], "dataset_to_index": [count], "meta/episodes/chunk_index": [0],
        "meta/episodes/file_index": [0],
    }  # fmt: skip
    flat = {f"stats/{name}/{key}": [value] for name, found in stats.items() for key, value in found.items()}
    pd.DataFrame(episode | flat).to_parquet(folder / "meta/episodes" / FIRST, index=False)
    features: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [len(names[name])], "names": list(names[name]), "fps": fps}
        for name in frames
    }
    features |= {name: {"dtype": kind, "shape": [1], "names": None, "fps": fps} for name, kind in _SCALARS.items()}
    info = {
        "codebase_version": VERSION, "robot_type": f"palmd {run.system}", "total_episodes": 1, "total_frames": count,
        "total_tasks": 1, "chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 500,
        "fps": fps, "splits": {"train": "0:1"}, "data_path": f"data/{CHUNK}", "video_path": None, "features": features,
    }  # fmt: skip
    for name, value in (("info", info), ("stats", stats)):
        (folder / f"meta/{name}.json").write_text(json.dumps(value, indent=4), encoding="utf-8")


def columns_plans(run: AnyRun) -> Iterator[str]:
    """The names of the plans that were run, in order, with repetitions."""
    for message in run.messages(run.topics.motion.name):
        fields = message.fields
        if fields.get("plan") and fields.get("segment", -1) >= 0:
            yield fields["plan"]


def _names(run: AnyRun) -> dict[str, tuple[str, ...]]:
    """Field names of each feature."""
    commanded = tuple(name for name in _numbers(run.topics.motion) if COMMANDED in name)
    contacts = tuple(name for name in _numbers(run.topics.contact) if not name.endswith("_ms"))
    estimated = tuple(name for name in _numbers(run.topics.estimate) if name not in ("valid", "object"))
    return {
        ACTION: commanded,
        STATE: tuple(name.replace(COMMANDED, "_") for name in commanded),
        CONTACTS: contacts,
        OBJECT: ("valid", *estimated),
    }


def _numbers(topic: Topic) -> Iterator[str]:
    yield from (each.name for each in topic.quantities if each.kind in ("number", "bool"))


def _columns(run: AnyRun, done: Callable[[], None]) -> dict[str, list[list[float]]]:
    """Rows of each feature: one per motion message while the joints are commanded."""
    names, topics = _names(run), run.topics
    contact: Fields = {}
    estimate: Fields = {}
    rows: dict[str, list[list[float]]] = {name: [] for name in names}
    for message in run.messages():
        fields = message.fields
        if message.topic == topics.contact.name:
            contact = fields
        elif message.topic == topics.estimate.name:
            estimate = fields
        elif message.topic == topics.motion.name and contact and estimate:
            source = {ACTION: fields, STATE: fields, CONTACTS: contact, OBJECT: estimate if estimate["valid"] else {}}
            if all(math.isfinite(fields[name]) for name in names[ACTION]):
                for name, wanted in names.items():
                    rows[name].append([_known(source[name].get(each, 0.0)) for each in wanted])
        done()
    return rows


def _known(value: float) -> float:
    return float(value) if math.isfinite(value) else 0.0


def _statistics(rows: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, list[float]]:
    found = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    return {key: value.tolist() for key, value in found.items()} | {"count": [len(rows)]}
