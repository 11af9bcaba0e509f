"""A body with corners tipped in the emulated rig is located by its contacts, and more than one side is found."""

from dataclasses import replace

import numpy as np
import pytest

from palmd.config.two_palms import PlanSpec
from palmd.observer import data_association
from palmd.observer.data_segment import data_segments
from palmd.observer.flat_side_search import FlatSideSearch
from palmd.observer.rounded_polygon_reconstruct import rounded_polygon_reconstruction
from palmd.observer.search import Search
from tools.studies import object_logs

POSES_DEG = ((118, 50, 2.5), (54, 114, 2.0), (12, 114, 1.5), (12, 46, 2.0))  # φ1, φ2, and duration (s)
ROUND = PlanSpec.model_validate(
    {
        "name": "round",
        "repeat": "forever",
        "segments": [
            {"move": {"phi1_deg": first, "phi2_deg": opening}, "duration_s": duration}
            for first, opening, duration in POSES_DEG
        ],
    }
)


@pytest.mark.nightly
def test_readings_that_no_single_outline_explains_give_no_estimate(monkeypatch):
    monkeypatch.setattr(data_association, "CORNERS", (6,))
    log, *_ = object_logs.simulated(object_logs.SharpTask("corners of 3 mm", 100, 24.0, plan=ROUND))
    search, *others = [Search(each, log.rig) for each in data_segments(log.events) if each.lasts > 1.0]
    sided = FlatSideSearch(search, 0, others)
    record = sided.record
    bent = replace(record, contact_value=record.contact_value + 1e-3 * np.sin(record.contact_t / 5.0))
    assert rounded_polygon_reconstruction(search, bent, sided.segments, 0.0) is None
