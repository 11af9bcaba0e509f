"""Stored outlines: read as the body they were taken from, or rejected with the reason and the place."""

import json
import math

import numpy as np
import pytest
from shut import shut

from palmd.cli import main
from palmd.outlinefile import H_SD_M, OutlineError, read_library, read_outline
from palmd.polygon import lamina
from palmd.rig.shapes import KINDS, area_moments, random_body
from palmd.rig.simulate import simulate_log

THETA = np.arange(360) * (math.tau / 360)


def body(seed=0, kind="nominal"):
    return random_body(kind, np.random.default_rng([KINDS.index(kind), seed]))


def points(support, count):
    """A number of points on the outline (m), equally spaced along the curve."""
    fine = np.linspace(0.0, math.tau, 20_001)
    v = support.sample(fine) + support.sample(fine, 2)
    arc = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2)])
    theta = np.interp(np.arange(count) * (arc[-1] / count), arc, fine)
    h, slope = support.sample(theta), support.sample(theta, 1)
    cos, sin = np.cos(theta), np.sin(theta)
    return np.stack([h * cos - slope * sin, h * sin + slope * cos], axis=1)


def as_json(path, theta=THETA, h=None, **more):
    h = body().support.sample(np.asarray(theta)) if h is None else h
    path.write_text(json.dumps({"theta_rad": list(theta), "h_m": list(h)} | more))
    return path


def as_csv(path, xy, *comments):
    lines = [*comments, "x_mm,y_mm", *(f"{x * 1e3:.7f},{y * 1e3:.7f}" for x, y in xy)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def file(tmp_path):
    return lambda name="stone.json": tmp_path / name


# ------------------------------------------------------------------------------------------ support functions


@pytest.mark.parametrize(("count", "start"), [(360, 0.0), (90, 0.0), (90, 1.0), (181, -math.pi), (720, 0.3)])
def test_any_even_spacing_is_resampled_to_whole_degrees(file, count, start):
    outline = read_outline(as_json(file(), start + np.arange(count) * (math.tau / count)))
    np.testing.assert_allclose(outline.h, body().support.sample(THETA), atol=1e-12)


def test_values_on_whole_degrees_are_kept(file):
    """Up to the highest harmonic that the normals resolve."""
    theta = THETA[::4]
    rough = body().support.sample(theta) + np.random.default_rng(0).normal(0.0, 1e-6, 90)
    np.testing.assert_allclose(read_outline(as_json(file(), theta, rough)).h[::4], rough, atol=1e-12)


def test_values_of_the_file_are_used(file):
    theta = 2.0 + np.arange(120) * (math.tau / 120)
    sd = 1e-5 * (2 + np.cos(theta))
    given = {
        "h_sd_m": sd.tolist(),
        "rho_m": 0.013,
        "rho_sd_m": 1e-4,
        "mass_kg": 0.1,
        "mass_sd_kg": 2e-3,
        "name": "pebble",
    }
    outline = read_outline(as_json(file(), theta, **given))
    assert (outline.name, outline.rho, outline.rho_sd) == ("pebble", 0.013, 1e-4)
    assert (outline.mass, outline.mass_sd) == (0.1, 2e-3)
    np.testing.assert_allclose(outline.h_sd, 1e-5 * (2 + np.cos(THETA)), atol=1e-8)


def test_missing_values_are_those_of_a_uniform_lamina(file):
    outline = read_outline(as_json(file()))
    assert outline.name == "stone"
    assert outline.rho == pytest.approx(area_moments(body().support)[3], rel=1e-4)
    assert outline.rho_sd == pytest.approx(0.05 * outline.rho)
    assert math.isnan(outline.mass)
    assert math.isnan(outline.mass_sd)
    assert (outline.h_sd == H_SD_M).all()


def test_the_centre_of_mass_need_not_be_the_centroid(file):
    moved = body().support.moved(2e-3, -1e-3)
    outline = read_outline(as_json(file(), h=moved.sample(THETA)))
    np.testing.assert_allclose(outline.h, moved.sample(THETA), atol=1e-12)
    assert outline.rho == pytest.approx(area_moments(body().support)[3], rel=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_a_simulators_truth_is_an_outline(file, kind):
    _, truth = simulate_log(kind, 0, 1.0)
    file("a.truth.json").write_text(json.dumps(truth))
    outline = read_outline(file("a.truth.json"))
    np.testing.assert_allclose(outline.h, truth["h_m"], atol=1e-12)
    assert (outline.rho, outline.mass) == (truth["rho_m"], truth["mass_kg"])


def test_an_outline_rounded_to_micrometres_is_still_convex(file):
    strong = min((body(seed, "odd") for seed in range(20)), key=lambda each: each.support.min_curvature_radius)
    read_outline(as_json(file(), h=np.round(strong.support.sample(THETA), 6)))


H = body().support.sample(THETA)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"converged": False}, "has not converged"),
        ({"h": H * 1e3}, r"mean radius is \S+ m: is h_m in mm\?"),
        ({"h": H * 1e-3}, r"mean radius is \S+ m: is h_m in km\?"),
        ({"h": H * 10}, "mean radius is"),
        ({"h": H + 0.03 * np.cos(THETA)}, "lies outside"),
        ({"h": H + 1e-3 * np.cos(6 * THETA)}, r"not convex: at \d+°"),
        ({"h": [*H[:77], math.nan, *H[78:]]}, r"h_m\[77\] is NaN, not a number"),
        ({"h": [*H[:-1], None]}, r"h_m\[359\] is null, not a number"),
        ({"h": [*H[:-1], True]}, r"h_m\[359\] is true, not a number"),
        ({"h": H[:-1]}, "h_m has 359 values for 360"),
        ({"h": H[:80], "theta": THETA[:80]}, "needs 90 or more"),
        ({"theta": np.degrees(THETA), "h": H}, r"is it in degrees\?"),
        ({"theta": np.linspace(0.0, math.tau, 360), "h": H}, "the first not repeated"),
        ({"theta": THETA / 2, "h": H}, r"theta_rad\[1\] is .* evenly spaced"),
        ({"theta": np.roll(THETA, 3), "h": H}, r"theta_rad\[3\]"),
        ({"h_sd_m": [-1e-5] * 360}, r"h_sd_m\[0\] is -1e-05"),
        ({"h_sd_m": [1e-5] * 180}, "180 values for 360"),
        ({"rho_m": 13.0}, "wrong unit"),
        ({"rho_m": "a"}, 'rho_m is "a", not a number'),
        ({"mass_kg": 120.0}, r"is it in grams\?"),
        ({"mass_kg": -0.1}, "mass_kg is -0.1"),
        ({"mass_kg": 0.1, "mass_sd_kg": -0.1}, "negative"),
        ({"name": ""}, "name must be text"),
    ],
)  # fmt: skip
def test_an_invalid_outline_is_rejected_with_the_reason(file, changes, reason):
    with pytest.raises(OutlineError, match=reason) as caught:
        read_outline(as_json(file(), **changes))
    assert str(caught.value).startswith(f"{file()}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"", r"json: the file is empty"),
        (b'{"h_m": [1,\n 2,,]}', r"json:2:4: not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b"[]", "must be an object"),
        (b"{}", "theta_rad is missing"),
        (b'{"a":"b",\n"\xff"}', r"json:2: not text"),
    ],
)
def test_invalid_json_is_rejected_with_the_place(file, raw, reason):
    file().write_bytes(raw)
    with pytest.raises(OutlineError, match=reason):
        read_outline(file())


def test_a_missing_file_or_one_of_another_kind_is_rejected(file):
    with pytest.raises(OutlineError, match="No such file"):
        read_outline(file())
    file("stone.txt").write_text("x")
    with pytest.raises(OutlineError, match=r"a \.json or a \.csv"):
        read_outline(file("stone.txt"))


# ---------------------------------------------------------------------------------------------------- points


def centred(support):
    _, x, y, _ = area_moments(support)
    return support.moved(-x, -y)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", ["as it is", "backwards", "first repeated", "elsewhere"])
def test_exact_points_give_the_original_body(file, kind, change):
    support = body(3, kind).support
    xy = points(support, 200)
    if change == "backwards":
        xy = xy[::-1]
    elif change == "first repeated":
        xy = np.concatenate([xy, xy[:1]])
    elif change == "elsewhere":
        xy = xy + np.array([0.4, -0.1])
    outline = read_outline(as_csv(file("stone.csv"), xy))
    true = centred(support)
    np.testing.assert_allclose(outline.h, true.sample(THETA), atol=5e-7)
    assert outline.rho == pytest.approx(area_moments(true)[3], rel=1e-4)
    np.testing.assert_allclose(outline.h_sd, H_SD_M, rtol=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_digitising_noise_is_averaged_and_estimated(file, seed):
    support = body(seed, "odd").support
    xy = points(support, 400)
    noisy = xy + np.random.default_rng(seed).normal(0.0, 1e-4, xy.shape)
    outline = read_outline(as_csv(file("stone.csv"), noisy))
    error = outline.h - centred(support).sample(THETA)
    assert np.sqrt(np.mean(error**2)) < 5e-5
    assert np.abs(error).max() < 4 * outline.h_sd[0]
    assert H_SD_M < outline.h_sd[0] < 1e-4


def test_comments_supplement_points(file):
    support = body(1).support
    comments = ("# a stone", "# com_mm: 1.5, -0.5", "# rho_mm: 12.5", "# mass_kg: 0.2")
    outline = read_outline(as_csv(file("stone.csv"), points(support, 200), *comments))
    np.testing.assert_allclose(outline.h, support.moved(-1.5e-3, 0.5e-3).sample(THETA), atol=1e-7)
    assert (outline.rho, outline.mass) == (pytest.approx(0.0125), 0.2)


XY = points(body().support, 200)
EIGHT = 0.02 * np.stack([np.sin(2 * THETA + 0.01), np.sin(THETA + 0.005)], axis=1)
_U = np.linspace(-1.0, 1.0, 51)[:-1]
_ONE = np.ones_like(_U)
SQUARE = 0.02 * np.concatenate(
    [np.stack(side, axis=1) for side in ((_U, -_ONE), (_ONE, _U), (-_U, _ONE), (-_ONE, -_U))]
)
BEAN = XY * (1 - 0.3 * np.exp(-((np.arange(200)[:, None] - 50) ** 2) / 200))


@pytest.mark.parametrize(
    ("xy", "reason"),
    [
        (XY[:150], r"csv:151: the curve is open: no point for \S+ mm until line 2"),
        (np.delete(XY, range(80, 90), axis=0), r"csv:81: the curve is open"),
        (EIGHT, r"csv:\d+: the curve crosses itself near line \d+"),
        (np.concatenate([XY, XY]), r"csv:2: the curve winds 2 times round"),
        (BEAN, r"csv:5\d: the outline is not convex: \(.*\) mm lies \S+ mm inside the hull"),
        (SQUARE, r"points deviate by \S+ mm \(RMS\) from a smooth outline: .* corners too sharp"),
        (XY[::5], "40 points; an outline needs 60 to 5000"),
        (points(body().support, 5001), "5001 points"),
        (XY * 1e-3, r"mean radius is \S+ mm: is x_mm in metres\?"),
        (XY * 1e3, r"mean radius is \S+ mm: is x_mm in µm\?"),
        (XY * 0, "mean radius is 0 mm"),
    ],
)
def test_points_that_are_no_outline_are_rejected_with_the_line(file, xy, reason):
    with pytest.raises(OutlineError, match=reason) as caught:
        read_outline(as_csv(file("stone.csv"), xy))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda rows: ["x,y", *rows[1:]], r"csv:1: the header must be x_mm,y_mm, got x,y"),
        (lambda rows: rows[1:], r"csv:1: the header must be"),
        (lambda rows: [*rows[:7], "1.0", *rows[7:]], r"csv:8: expected 2 numbers, got 1"),
        (lambda rows: [*rows[:7], "1,2,3", *rows[7:]], r"csv:8: expected 2 numbers, got 3"),
        (lambda rows: [*rows[:7], "1,b", *rows[7:]], r"csv:8: b is not a number"),
        (lambda rows: [*rows[:7], "1,", *rows[7:]], r"csv:8: nothing is not a number"),
        (lambda rows: [*rows[:7], "nan,2", *rows[7:]], r"csv:8: nan is out of range"),
        (lambda rows: ["# com_mm: 1", *rows], r"csv:1: expected 2 numbers, got 1"),
        (lambda rows: ["# com_mm: 100, 0", *rows], "com_mm is wrong"),
        (lambda rows: ["# rho_mm: 0.013", *rows], "wrong unit"),
        (lambda rows: rows[:1], "0 points"),
        (lambda _: ["# nothing"], "0 points"),
    ],
)
def test_an_unreadable_table_is_rejected_with_the_line(file, change, reason):
    path = as_csv(file("stone.csv"), XY)
    path.write_text("\n".join(change(path.read_text().splitlines())))
    with pytest.raises(OutlineError, match=reason):
        read_outline(path)


def test_files_of_other_systems_are_read_alike(file):
    path = as_csv(file("stone.csv"), XY)
    plain = read_outline(path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    np.testing.assert_array_equal(read_outline(path).h, plain.h)


def test_a_lamina_does_not_depend_on_the_distribution_of_its_points():
    """A rectangle of 4 × 2 with many points in one corner: ρ² = (4² + 2²) / 12."""
    rectangle = np.array(
        [[1, 1], [1.1, 1], [1.2, 1], [1.3, 1], [5, 1], [5, 3], [1, 3], [1, 1.2], [1, 1.1]], dtype=float
    )
    plate = lamina(rectangle)
    assert (plate.area, plate.centroid) == (pytest.approx(8.0), pytest.approx((3.0, 2.0)))
    assert plate.rho == pytest.approx(math.sqrt(20 / 12))


# --------------------------------------------------------------------------------------------------- library


def test_a_library_is_every_outline_of_a_folder_in_order_of_name(tmp_path):
    as_json(tmp_path / "b.json")
    as_csv(tmp_path / "c.csv", XY)
    as_json(tmp_path / "z.json", name="a")
    (tmp_path / "notes.txt").write_text("no outline")
    assert [outline.name for outline in read_library(tmp_path)] == ["a", "b", "c"]
    assert [outline.name for outline in read_library(tmp_path / "b.json")] == ["b"]


def test_an_unusable_library_is_rejected(tmp_path):
    with pytest.raises(OutlineError, match="holds no outline"):
        read_library(tmp_path)
    as_json(tmp_path / "a.json")
    as_csv(tmp_path / "a.csv", XY)
    with pytest.raises(OutlineError, match=r'a\.json: has the same name "a" as .*a\.csv'):
        read_library(tmp_path)
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(OutlineError, match=r"a\.json: theta_rad is missing"):
        read_library(tmp_path)
    with pytest.raises(OutlineError, match="No such file"):
        read_library(tmp_path / "none.json")


def test_check_accepts_outlines(tmp_path, capsys):
    good, bad = as_json(tmp_path / "a.json"), as_csv(tmp_path / "b.csv", XY[:150])
    assert main(["check", str(good)]) == 0
    assert capsys.readouterr().out == f"{good}: good\n"
    assert main(["check", str(good), str(bad)]) == 1
    assert "b.csv:151: the curve is open" in capsys.readouterr().err


@pytest.mark.parametrize("what", ["", "/outline.json"])
def test_an_unreadable_library_is_reported(tmp_path, what):
    (tmp_path / "library").mkdir()
    path = tmp_path / f"library{what}"
    with shut(tmp_path / "library"), pytest.raises(OutlineError, match=f"^{path}: Permission denied$"):
        read_library(path)
