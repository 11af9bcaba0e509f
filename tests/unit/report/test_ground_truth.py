"""Clock, frame and errors from a camera's track, against a simulated camera with known clock and frame."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palmd.events import PalmSample
from palmd.outlinefile import Outline
from palmd.record.resultfile import Result
from palmd.record.track import CameraTrack, TrackError, read_track
from palmd.report.camera_frame import motion_of
from palmd.report.ground_truth import GroundTruthError, compare
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


def arm(log):
    return log.rig.palm1_length if log.rig.hinge == "arc" else None


def exact(truth):
    """A reconstruction without errors."""
    t, psi, r1, r2, theta, h = (np.array(truth[name]) for name in ("t", "psi_rad", "r1_m", "r2_m", "theta_rad", "h_m"))
    return Result(t, psi, np.stack([r1, r2]), theta, h, np.full(360, 1e-5), theta < 2.0)


def track_of(tmp_path, run, camera=CAMERA, keep=slice(None), without=(), seed=0):
    log, truth = run
    table = filmed(truth, arm(log), camera, np.random.default_rng(seed))
    table = {name: column for name, column in table.items() if name not in without}
    path = tmp_path / "track.csv"
    path.write_text(as_csv(table, keep))
    return read_track(path)


def comparison(run, track, result=None, log=True, outline=None):
    events, truth = run
    result = exact(truth) if result is None else result
    palms = [event for event in events.events if isinstance(event, PalmSample)]
    return compare(result, motion_of(result, events.rig if log else None, palms), track, outline)


def offset_error(found, camera):
    """Error of the log time that is assigned to a camera time in mid-run."""
    true = found.clock.t_middle / (1 - camera.drift) + camera.offset_s
    return found.clock.log_time(np.array([found.clock.t_middle]))[0] - true


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))])
@pytest.mark.parametrize("palms", [True, False])
def test_clock_and_frame_are_found_within_their_sds(tmp_path, run, seed, palms):
    without = () if palms else ("palm1_angle_deg", "palm2_angle_deg")
    found = comparison(run, track_of(tmp_path, run, without=without, seed=seed))
    assert abs(offset_error(found, CAMERA)) < min(5e-3, MOST_SDS * found.clock.offset_sd)
    assert found.clock.offset_sd < 1e-3
    assert math.isnan(found.clock.drift)
    frame = found.frame
    assert abs(math.remainder(frame.angle - CAMERA.angle_rad, math.tau)) < MOST_SDS * frame.angle_sd
    for value, sd, true in (
        *zip(frame.place, frame.place_sd, CAMERA.place_m, strict=True),
        *zip(frame.mark, frame.mark_sd, CAMERA.mark_m, strict=True),
    ):
        assert abs(value - true) < MOST_SDS * sd
        assert sd < 1e-3
    assert found.psi.rms == pytest.approx(CAMERA.angle_sd_rad, rel=0.2)
    assert found.mark.rms == pytest.approx(CAMERA.place_sd_m * math.sqrt(2), rel=0.2)
    assert found.psi.skill > 0.95
    assert found.mark.skill > 0.9
    assert found.omitted == ()


def test_clock_drift_is_estimated_in_long_records(tmp_path, long_run):
    camera = replace(CAMERA, drift=500e-6)
    found = comparison(long_run, track_of(tmp_path, long_run, camera))
    assert abs(found.clock.drift - 500e-6) < MOST_SDS * found.clock.drift_sd
    assert found.clock.drift_sd < 100e-6
    assert abs(offset_error(found, camera)) < min(5e-3, MOST_SDS * found.clock.offset_sd)


def test_without_a_log_the_clock_is_found_from_orientation(tmp_path, run):
    found = comparison(run, track_of(tmp_path, run), log=False)
    assert abs(offset_error(found, CAMERA)) < min(5e-3, MOST_SDS * found.clock.offset_sd)
    assert found.frame is None
    assert found.mark is None
    assert found.psi.rms == pytest.approx(CAMERA.angle_sd_rad, rel=0.2)


@pytest.mark.parametrize("offset", [0.0, 1.7e9, -3.1])
def test_clocks_may_differ_by_any_amount(tmp_path, run, offset):
    camera = replace(CAMERA, offset_s=offset)
    assert abs(offset_error(comparison(run, track_of(tmp_path, run, camera)), camera)) < 2e-3


def test_records_that_overlap_partly_are_sufficient(tmp_path, run):
    late = np.arange(240) >= 90
    result = exact(run[1])
    early = replace(result, **{name: getattr(result, name)[..., :650] for name in ("t", "psi", "radii")})
    found = comparison(run, track_of(tmp_path, run, keep=late), early)
    assert abs(offset_error(found, CAMERA)) < 5e-3
    assert found.t[0] == pytest.approx(3.0, abs=0.1)
    assert found.t[-1] == pytest.approx(6.5, abs=0.1)


def test_gaps_are_left_out_and_reported(tmp_path, run):
    seen = np.ones(240, dtype=bool)
    seen[60:120] = False
    track = track_of(tmp_path, run, keep=seen)
    blind = replace(track, angle=np.where(np.arange(180) % 7 == 3, np.nan, track.angle))
    result = exact(run[1])
    hole = (result.t < 5.0) | (result.t > 6.0)
    holed = replace(result, **{name: getattr(result, name)[..., hole] for name in ("t", "psi", "radii")})
    found = comparison(run, blind, holed)
    assert abs(offset_error(found, CAMERA)) < 5e-3
    camera, mine = found.omitted
    assert camera.startswith("the camera saw nothing from 1.9")
    assert mine.startswith("no reconstruction from 4.99 to 6.01 s")
    assert not ((found.t > 2.0) & (found.t < 3.9)).any()
    assert not ((found.t > 5.02) & (found.t < 5.98)).any()


def test_an_error_of_known_size_is_found(tmp_path, run):
    """A wrong orientation is reported as such if the palms determine the clock; its constant part is gauge."""
    result = exact(run[1])
    wrong = replace(result, psi=result.psi + 0.7 + 0.1 * np.sin(3.0 * result.t))
    quiet = replace(CAMERA, angle_sd_rad=1e-4)
    found = comparison(run, track_of(tmp_path, run, quiet), wrong)
    assert found.psi.rms == pytest.approx(0.1 / math.sqrt(2), rel=0.1)
    assert found.psi.greatest == pytest.approx(0.1, rel=0.15)


def test_the_skill_of_no_motion_is_zero(tmp_path, run):
    result = exact(run[1])
    found = comparison(run, track_of(tmp_path, run), replace(result, psi=0.0 * result.psi))
    assert found.psi.skill == pytest.approx(0.0, abs=1e-6)


def test_the_outline_error_is_that_after_the_best_rotation(tmp_path, run):
    truth = run[1]
    result = exact(truth)
    bent = result.h + 3e-5 * np.cos(9 * result.theta)
    turned = replace(result, h=np.roll(bent, -40), touched=np.ones(360, dtype=bool))
    nan = math.nan
    outline = Outline("true", np.array(truth["h_m"]), np.zeros(360), 0.01, nan, nan, nan)
    found = comparison(run, track_of(tmp_path, run), turned, outline=outline).outline
    assert found.e_h == pytest.approx(3e-5 / math.sqrt(2), rel=0.05)
    assert found.p90 == pytest.approx(3e-5 * math.sin(0.9 * math.pi / 2), rel=0.1)
    assert found.greatest == pytest.approx(3e-5, rel=0.1)
    assert math.degrees(found.rotation) == pytest.approx(40.0, abs=0.2)
    assert found.touched == 1.0


# ----------------------------------------------------------------------------------------------------- rejected


def changed(track, **changes):
    return replace(track, **{name: change(getattr(track, name)) for name, change in changes.items()})


def test_records_that_cannot_be_compared_are_rejected_with_the_reason(tmp_path, run):
    track = track_of(tmp_path, run)
    no_palms = changed(track, palms=lambda palms: palms * np.nan)
    other = simulated("odd" if arm(run[0]) is None else "friction", 7, 8.0)
    for wrong, log, reason in (
        (changed(no_palms, angle=lambda angle: 0 * angle), False, "the best explains 0%"),
        (changed(track, angle=np.negative, palms=np.negative), True, "y axis point down"),
        (changed(no_palms, angle=lambda angle: np.unwrap(angle) * math.pi / 180), False, "are they in radians"),
        (track_of(tmp_path, other), True, "the track of this run"),
        (changed(track, t=lambda t: t * 1e-3), True, "the shorter record lasts 0.01 s"),
    ):
        with pytest.raises(GroundTruthError, match=reason):
            comparison(run, wrong, log=log)


@pytest.mark.parametrize(("swing", "reason"), [(1.0, "ambiguous"), (0.01, "no angle changes by more than 2 degrees")])
def test_a_periodic_or_absent_motion_does_not_determine_the_clock(swing, reason):
    t = np.arange(0.0, 12.0, 0.01)
    ones = np.full(360, 0.02)
    result = Result(t, swing * np.sin(4.0 * t), np.zeros((2, len(t))), np.radians(np.arange(360)), ones, ones, ones > 0)
    seen = np.arange(3.0, 9.0, 0.03)
    noise = np.random.default_rng(0).normal(0.0, 5e-3, len(seen))
    nothing = np.full((len(seen), 2), np.nan)
    track = CameraTrack(seen, nothing, swing * np.sin(4.0 * seen) + noise, nothing)
    with pytest.raises(GroundTruthError, match=reason):
        compare(result, motion_of(result, None, []), track, None)


HEADER = "t_s,object_x_mm,object_y_mm,object_angle_deg"
ROWS = [f"{0.03 * i:.2f},{i},2,{i}" for i in range(40)]


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ([], r"csv:1: the file is empty"),
        (["t_s,x,y", *ROWS], r"csv:1: the column object_x_mm is missing"),
        ([HEADER + ",t_s", *ROWS], r"csv:1: the column t_s is twice"),
        ([HEADER, *ROWS[:5], "1,2,3", *ROWS[5:]], r"csv:7: 3 cells under 4 columns"),
        ([HEADER, *ROWS[:5], "1,2,3,b", *ROWS[5:]], r"csv:7: object_angle_deg is 'b', not a number"),
        ([HEADER, *ROWS[:5], "1,2,inf,3", *ROWS[5:]], r"csv:7: object_y_mm is infinite"),
        ([HEADER, *ROWS[:5], ",2,3,4", *ROWS[5:]], r"csv:7: t_s is missing"),
        ([HEADER, *ROWS[:5], ROWS[4], *ROWS[5:]], r"csv:7: t_s is 0.12 after 0.12: time must increase"),
        ([HEADER, *ROWS[:20]], r"csv: 20 rows show the object; 30 are needed"),
        ([HEADER, *(f"{i},,nan,3" for i in range(40))], r"csv: 0 rows show the object"),
        ([HEADER, *(f"{i},{i * 1e-4},2,3" for i in range(40))], r"moves by only 0.0039 mm: .* in metres\?"),
        ([HEADER, *(f"{i},{i * 1e3},2,3" for i in range(40))], r"moves by 3.9e\+04 mm: .* in µm\?"),
    ],
)
def test_an_unreadable_track_is_rejected_with_the_line(tmp_path, lines, reason):
    path = tmp_path / "track.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(TrackError, match=reason) as caught:
        read_track(path)
    assert "\n" not in str(caught.value)


def test_columns_may_have_any_order_and_cells_may_be_empty(tmp_path):
    path = tmp_path / "track.csv"
    rows = [f"{i},{90 + i},x,{i},{0.03 * i},-3,{'' if i == 4 else 7}" for i in range(40)]
    head = "palm2_angle_deg,object_angle_deg,note,object_x_mm,t_s,object_y_mm,palm1_angle_deg"
    path.write_text("\ufeff" + "\r\n".join([head, *rows, "", ""]))
    track = read_track(path)
    assert track.t[10] == pytest.approx(0.3)
    np.testing.assert_allclose(track.mark[10], [0.010, -0.003])
    assert track.angle[10] == pytest.approx(math.radians(100.0))
    np.testing.assert_allclose(track.palms[10], np.radians([7.0, 10.0]))
    assert np.isnan(track.palms[4, 0])


def test_a_missing_or_binary_track_is_rejected(tmp_path):
    with pytest.raises(TrackError, match="No such file"):
        read_track(tmp_path / "none.csv")
    (tmp_path / "a.csv").write_bytes(HEADER.encode() + b"\n\xff\n")
    with pytest.raises(TrackError, match="not text"):
        read_track(tmp_path / "a.csv")
