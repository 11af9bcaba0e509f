"""A simulated camera's track of a run: clock, frame and mark are found within their standard deviations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palmd.report.alignment import AlignmentError, compare
from palmd.report.tracks import PoseTrack, TrackFileError, com_of, planar_fields, read_pose_track
from tools.camera import Camera, as_csv, filmed
from tools.studies.simulated import simulated

MOST_SDS = 4.0
CAMERA = Camera()


@pytest.fixture(scope="module", params=["rig", "nominal"])
def run(request):
    return simulated(request.param, 1, 8.0)


@pytest.fixture(scope="module")
def long_run():
    return simulated("nominal", 2, 24.0)


def exact(run, positions=True):
    """A reconstruction without errors."""
    log, truth = run
    t, psi, phi1, phi2, r1, r2 = (
        np.array(truth[name]) for name in ("t", "psi_rad", "phi1_rad", "phi2_rad", "r1_m", "r2_m")
    )
    com = com_of(np.stack([phi1, phi2], axis=1), np.stack([r1, r2]), log.rig)
    if not positions:
        com = np.full_like(com, math.nan)
    return PoseTrack("result", **planar_fields(t, com[:, 0], com[:, 1], psi))


def track_of(tmp_path, run, camera=CAMERA, keep=slice(None), seed=0):
    log, truth = run
    arm = log.rig.palm1_length if log.rig.hinge == "arc" else None
    path = tmp_path / "track.csv"
    path.write_text(as_csv(filmed(truth, arm, camera, np.random.default_rng(seed)), keep))
    return read_pose_track(path)


def offset_error(found, camera):
    """Error of the offset, camera's time minus log's, in mid-run."""
    return found.offset - (found.t_middle - found.t_middle / (1 - camera.drift) - camera.offset_s)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))])
def test_clock_frame_and_mark_are_found_within_their_sds(tmp_path, run, seed):
    compared = compare(track_of(tmp_path, run, seed=seed), exact(run))
    found = compared.alignment
    assert abs(offset_error(found, CAMERA)) < min(5e-3, MOST_SDS * found.offset_sd)
    assert found.offset_sd < 2e-3
    assert math.isnan(found.drift)
    turned = math.remainder(found.frame[2] - CAMERA.angle_rad, math.tau)
    assert abs(turned) < MOST_SDS * found.frame_sd[2] < 0.05
    for values, sds, true in (
        (found.place, found.place_sd, CAMERA.place_m),
        (found.mark, found.mark_sd, CAMERA.mark_m),
    ):
        assert (np.abs(values[:2] - true) < MOST_SDS * sds[:2]).all()
        assert (sds[:2] < 2e-3).all()
        assert math.isnan(sds[2]), "nothing determines it in a plane"
    assert compared.rotation.rms == pytest.approx(CAMERA.angle_sd_rad, rel=0.2)
    assert compared.position.rms == pytest.approx(CAMERA.place_sd_m * math.sqrt(2), rel=0.2)


def test_clock_drift_is_estimated_in_long_records(tmp_path, long_run):
    camera = replace(CAMERA, drift=500e-6)
    found = compare(track_of(tmp_path, long_run, camera), exact(long_run)).alignment
    assert abs(found.drift + 500e-6) < MOST_SDS * found.drift_sd
    assert found.drift_sd < 100e-6
    assert abs(offset_error(found, camera)) < min(5e-3, MOST_SDS * found.offset_sd)


def test_without_positions_the_clock_is_found_from_orientation(tmp_path, run):
    compared = compare(track_of(tmp_path, run), exact(run, positions=False))
    found = compared.alignment
    assert abs(offset_error(found, CAMERA)) < min(5e-3, MOST_SDS * found.offset_sd)
    assert np.isnan([found.frame_sd[2], *found.place_sd, *found.mark_sd]).all()
    assert math.isnan(compared.position.rms)
    assert compared.rotation.rms == pytest.approx(CAMERA.angle_sd_rad, rel=0.2)


@pytest.mark.parametrize("offset", [0.0, 1.7e9, -3.1])
def test_clocks_may_differ_by_any_amount(tmp_path, run, offset):
    camera = replace(CAMERA, offset_s=offset)
    assert abs(offset_error(compare(track_of(tmp_path, run, camera), exact(run)).alignment, camera)) < 2e-3


def test_records_that_overlap_partly_are_sufficient(tmp_path, run):
    whole = exact(run)
    early = replace(whole, t=whole.t[:650], position=whole.position[:650], rotation=whole.rotation[:650])
    compared = compare(track_of(tmp_path, run, keep=np.arange(240) >= 90), early)
    assert abs(offset_error(compared.alignment, CAMERA)) < 5e-3
    assert compared.t[[0, -1]] + CAMERA.offset_s == pytest.approx([3.0, 6.5], abs=0.1)


def test_gaps_of_either_are_left_out(tmp_path, run):
    seen = np.ones(240, dtype=bool)
    seen[60:120] = False
    whole = exact(run)
    rows = np.flatnonzero((whole.t < 5.0) | (whole.t > 6.0))
    holed = replace(whole, t=whole.t[rows], position=whole.position[rows], rotation=whole.rotation[rows])
    compared = compare(track_of(tmp_path, run, keep=seen), holed)
    t = compared.t + CAMERA.offset_s
    assert abs(offset_error(compared.alignment, CAMERA)) < 5e-3
    assert not ((t > 2.0) & (t < 3.9)).any()
    assert not ((t > 5.02) & (t < 5.98)).any()


def test_an_error_of_known_size_is_found(tmp_path, long_run):
    """Its constant part is gauge."""
    right = exact(long_run)
    extra = 0.7 + 0.05 * np.sin(9.0 * right.t)
    wrong = replace(right, **planar_fields(right.t, *right.position[:, :2].T, np.array(long_run[1]["psi_rad"]) + extra))
    found = compare(track_of(tmp_path, long_run, replace(CAMERA, angle_sd_rad=1e-4)), wrong)
    assert found.rotation.rms == pytest.approx(0.05 / math.sqrt(2), rel=0.15)


# ----------------------------------------------------------------------------------------------------- rejected


def test_records_that_cannot_be_compared_are_rejected_with_the_reason(tmp_path, run):
    track = track_of(tmp_path, run)
    angle = np.unwrap(track.rotation.as_rotvec()[:, 2])
    x, y = track.position[:, :2].T
    other = simulated("odd" if run[0].rig.hinge != "arc" else "friction", 7, 8.0)
    for wrong, reason in (
        (PoseTrack("track", **planar_fields(track.t, x, y, angle * math.pi / 180)), "angles in degrees"),
        (track_of(tmp_path, other), "same motion"),
        (replace(track, t=track.t * 1e-3), "lasts 0.0"),
    ):
        with pytest.raises(AlignmentError, match=reason):
            compare(wrong, exact(run))


@pytest.mark.parametrize(("swing", "reason"), [(1.0, "ambiguous"), (0.001, "turns by less than 2 degrees")])
def test_a_periodic_or_absent_motion_does_not_determine_the_clock(swing, reason):
    t = np.arange(0.0, 12.0, 0.01)
    seen = np.arange(3.0, 9.0, 0.03)
    noise = np.random.default_rng(0).normal(0.0, 5e-3 * swing, len(seen))
    true, mine = (
        PoseTrack(name, **planar_fields(at, 0 * at, 0 * at, swing * np.sin(4.0 * at) + extra))
        for name, at, extra in (("track", seen, noise), ("result", t, 0.0))
    )
    with pytest.raises(AlignmentError, match=reason):
        compare(true, mine)


HEADER = "t_s,object_x_mm,object_y_mm,object_angle_deg"
ROWS = [f"{0.03 * i:.2f},{i},2,{i}" for i in range(40)]


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ([], r"csv:1: the column t_s is missing"),
        (["t_s,x,y", *ROWS], r"csv:1: the column object_x_mm is missing"),
        ([HEADER + ",t_s", *ROWS], r"csv:1: the column t_s is twice"),
        ([HEADER, *ROWS[:5], "1,2,3", *ROWS[5:]], r"csv:7: 3 cells under 4 columns"),
        ([HEADER, *ROWS[:5], "1,2,3,b", *ROWS[5:]], r"csv:7: could not convert string to float: 'b'"),
        ([HEADER, *ROWS[:5], ",2,3,4", *ROWS[5:]], r"csv:7: time is nan after 0.12: it must increase"),
        ([HEADER, *ROWS[:5], ROWS[4], *ROWS[5:]], r"csv:7: time is 0.12 after 0.12: it must increase"),
        ([HEADER, *ROWS[:20]], r"csv: 20 rows show the object; 30 are needed"),
        ([HEADER, *(f"{i},,nan,3" for i in range(40))], r"csv: 0 rows show the object"),
        ([HEADER, *(f"{i},{i * 1e-4},2,3" for i in range(40))], r"moves by 0.0039 mm: .* in metres\?"),
        ([HEADER, *(f"{i},{i * 1e3},2,3" for i in range(40))], r"moves by 3.9e\+04 mm: .* in µm\?"),
    ],
)
def test_an_unreadable_track_is_rejected_with_the_line(tmp_path, lines, reason):
    path = tmp_path / "track.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(TrackFileError, match=reason) as caught:
        read_pose_track(path)
    assert "\n" not in str(caught.value)


def test_columns_may_have_any_order_and_cells_may_be_empty(tmp_path):
    path = tmp_path / "track.csv"
    rows = [f"{i},{90 + i},x,{i},{0.03 * i},-3,{'' if i == 4 else 7}" for i in range(40)]
    head = "palm2_angle_deg,object_angle_deg,note,object_x_mm,t_s,object_y_mm,palm1_angle_deg"
    path.write_text("\ufeff" + "\r\n".join([head, *rows, "", ""]))
    track = read_pose_track(path)
    assert track.t[10] == pytest.approx(0.3)
    np.testing.assert_allclose(track.position[10], [0.010, -0.003, 0.0])
    assert track.rotation[10].as_rotvec()[2] == pytest.approx(math.radians(100.0))


def test_a_missing_or_binary_track_is_rejected(tmp_path):
    with pytest.raises(TrackFileError, match="no such file"):
        read_pose_track(tmp_path / "none.csv")
    (tmp_path / "a.csv").write_bytes(HEADER.encode() + b"\n\xff\n")
    with pytest.raises(TrackFileError, match="not text"):
        read_pose_track(tmp_path / "a.csv")
