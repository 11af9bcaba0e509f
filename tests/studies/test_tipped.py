"""A thing with corners that is tipped in the emulated rig is told by where it lies, and more of it than one side."""

from dataclasses import replace

import numpy as np
import pytest

from palmd.config.two_palms import PlanSpec
from palmd.observer import data_association
from palmd.observer.data_segment import data_segments
from palmd.observer.flat_side_search import FlatSideSearch
from palmd.observer.rounded_polygon_reconstruct import rounded_polygon_reconstruction
from palmd.observer.search import Search
from palmd.score import score_outline
from tools.studies import object_logs

POSES_DEG = ((118, 50, 2.5), (54, 114, 2.0), (12, 114, 1.5), (12, 46, 2.0))  # φ1, φ2, and in what time (s)
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


@pytest.fixture(scope="module")
def tipped():
    """The first segment's search, all that was felt on sides, and the truth."""
    task = object_logs.SharpTask("corners of 3 mm", 100, 24.0, plan=ROUND)
    log, truth, _ = object_logs.simulated(task)
    search, *others = [Search(each, log.rig) for each in data_segments(log.events) if each.lasts > 1.0]
    return search, FlatSideSearch(search, 0, others), truth


@pytest.mark.nightly
@pytest.mark.xfail(
    strict=False,
    reason="ten placements of the sides explain the readings of this body (μ 0.17): of 20 s of rides 1.7 s are placed"
    " alike by all, too few for an outline",
)
def test_most_of_it_is_told_to_a_few_hundredths_of_a_millimetre(tipped, monkeypatch):
    monkeypatch.setattr(data_association, "CORNERS", (6, 5))  # others take their time
    search, sided, truth = tipped
    told = rounded_polygon_reconstruction(search, sided.record, sided.segments, 0.0)
    assert told is not None
    score = score_outline(told.theta, told.h, told.touched, np.array(truth["h_m"]))
    assert score.max_error < 1.5e-4
    assert score.touched > 0.5
    assert np.sqrt(np.mean(told.h_sd[told.touched] ** 2)) < 5e-5
    assert abs(told.mu - truth["mu"]) < 3 * told.mu_sd + 0.005
    assert len(told.sides) >= 3


def test_nothing_is_told_of_readings_that_no_one_outline_explains(tipped, monkeypatch):
    monkeypatch.setattr(data_association, "CORNERS", (6,))
    search, sided, _ = tipped
    record = sided.record
    bent = replace(record, contact_value=record.contact_value + 1e-3 * np.sin(record.contact_t / 5.0))
    assert rounded_polygon_reconstruction(search, bent, sided.segments, 0.0) is None
