"""A run as a LeRobot data set, read back according to the format's documentation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import synthetic_runs

from palmd.cli import main
from palmd.quantities import MOTION

pd = pytest.importorskip("pandas", reason="the extra lerobot is not installed")
pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("run")
    commanded = {"phi1_cmd_rad": 0.7, "phi2_cmd_rad": 1.5}
    messages = (
        (topic, fields | commanded if topic == MOTION.name else fields, t, number)
        for topic, fields, t, number in synthetic_runs.messages(2.0)
    )
    run = synthetic_runs.write(path, messages)
    assert main(["export", str(run), "-o", str(path / "set"), "--as", "lerobot"]) == 0
    return path / "set"


def test_files_are_where_the_information_file_says(folder) -> None:
    info = json.loads((folder / "meta/info.json").read_text())
    data = pd.read_parquet(folder / info["data_path"].format(chunk_index=0, file_index=0))
    assert info["codebase_version"] == "v3.0"
    assert len(data) == info["total_frames"] > 100
    assert set(data.columns) == set(info["features"])
    for name, feature in info["features"].items():
        values = np.stack(data[name]) if feature["shape"] != [1] or feature["names"] else data[name].to_numpy()[:, None]
        assert values.shape[1:] == tuple(feature["shape"])
        assert values.dtype == feature["dtype"]
        assert np.isfinite(values).all()
    assert info["features"]["action"]["names"] == ["phi1_cmd_rad", "phi2_cmd_rad"]
    assert info["features"]["observation.state"]["names"] == ["phi1_rad", "phi2_rad"]


def test_times_tasks_episodes_and_statistics_agree(folder) -> None:
    info = json.loads((folder / "meta/info.json").read_text())
    data = pd.read_parquet(folder / "data/chunk-000/file-000.parquet")
    assert np.allclose(np.diff(data["timestamp"]), 1.0 / info["fps"], atol=1e-5)
    tasks = pd.read_parquet(folder / "meta/tasks.parquet")
    assert tasks.task_index.tolist() == [0]
    episodes = pd.read_parquet(folder / "meta/episodes/chunk-000/file-000.parquet")
    assert list(episodes["tasks"][0]) == list(tasks.index)
    assert (episodes["dataset_from_index"][0], episodes["dataset_to_index"][0]) == (0, len(data))
    stats = json.loads((folder / "meta/stats.json").read_text())
    actions = np.stack(data["action"]).astype(np.float64)
    assert np.allclose(stats["action"]["mean"], actions.mean(axis=0), atol=1e-6)
    assert stats["action"]["count"] == [len(data)]
