"""Event logs whose forces end at the pad's full scale."""

import json

import pytest

from palmd.record.eventlog import read_log

RIG = {
    "palmd_log": 1,
    "rig": {
        "gravity_m_s2": 9.81,
        "hinge": {"mode": "fixed"},
        "pad": {"length_m": 0.0555, "noise_m": 1e-4, "resolution_m": 1.27e-4},
        "force_scale_std": 0.05,
        "force_resolution_n": 0.02,
    },
}


@pytest.mark.parametrize(("most_n", "saturated"), [(2.54, 6), (3.0, 0), (2.0, 0)])
def test_readings_at_the_last_count_are_at_least_that(tmp_path, most_n, saturated):
    forces = [min(0.5 * n, most_n) for n in range(1, 12)]
    lines = [RIG, *({"t": 0.01 * n, "pad": 1, "s_m": 0.02, "force_n": force} for n, force in enumerate(forces))]
    path = tmp_path / "log.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)), encoding="utf-8")
    samples = read_log(path).events
    clipped = [sample for sample in samples if sample.at_least is not None]
    assert len(clipped) == saturated
    assert all(sample.force is None for sample in clipped)
