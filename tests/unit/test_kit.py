"""`make kit`: the build folder, its checks, the list of parts, weights and forces."""

import csv
import io
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from palmd.config.two_palms import LimitsConfig
from palmd.devices.strip import POSITION_MAX
from tools.tabletop import firmware, kit, loads
from tools.tabletop.assembly import assembled, collisions
from tools.tabletop.geometry import TABLETOP
from tools.tabletop.mesh import Mesh, box, fits, inside, open_edges, overlaps, read_stl, turned
from tools.tabletop.parts import STALL_NM, Choice, as_csv, parts_list

M3_NUT_MM = 2.4
"""Height of a nut, ISO 4032."""
CUBE = box((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))


def test_a_box_is_closed_and_a_hole_is_found():
    assert CUBE.volume == pytest.approx(1000.0)
    assert open_edges(CUBE) == 0
    assert open_edges(Mesh(CUBE.triangles[1:])) > 0
    inverted = Mesh(np.concatenate([CUBE.triangles[:1, ::-1], CUBE.triangles[1:]]))
    assert open_edges(inverted) > 0, "a triangle that faces inwards"
    assert fits(CUBE, 10.0)
    assert not fits(CUBE, 9.9)


def test_points_within_a_rotated_box():
    turn = turned("y", 30.0) @ turned("z", 20.0)
    moved = CUBE.moved(turn, np.array([3.0, -2.0, 5.0]))
    points = np.random.default_rng(1).uniform(-2.0, 12.0, (2000, 3))
    within = np.all((points > 0.0) & (points < 10.0), axis=1)
    assert (inside(moved, points @ turn.T + [3.0, -2.0, 5.0]) == within).all()


@pytest.mark.parametrize(("shift", "overlap"), [((10.0, 0, 0), False), ((9.8, 0, 0), True), ((3.0, 3.0, 3.0), True)])
def test_touching_parts_do_not_overlap(shift, overlap):
    small = box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)).moved(np.eye(3), np.array(shift))
    assert overlaps(CUBE, small) is overlap
    assert overlaps(small, CUBE) is overlap


def test_every_part_has_a_number_with_its_source_or_a_specification():
    found = parts_list()
    assert {part.name for part in found.parts} >= {
        "servo",
        "servo adapter",
        "supply",
        "strip",
        "strip board",
        "bearing",
    }
    with pytest.raises(ValueError, match="source"):
        Choice(maker="Somebody", number="X-1")
    with pytest.raises(ValueError, match="specification"):
        Choice(note="nothing")
    rows = list(csv.DictReader(io.StringIO(as_csv(found))))
    assert len(rows) == sum(len(part.choices) for part in found.parts)
    assert all(row["source"] for row in rows if row["number"])


def test_the_base_lies_flat_on_its_screws():
    (screw,) = (part for part in parts_list().parts if part.name == "screw M3")
    length = float(re.search(r"M3 × (\d+)", screw.choices[0].specification).group(1))
    grip = TABLETOP.bracket_thickness + TABLETOP.base_thickness
    assert grip - TABLETOP.nut_depth + M3_NUT_MM <= length <= grip, "through the nut, but not out of its pocket"


def test_servos_are_strong_and_palms_stiff_enough():
    worst = loads.worst(TABLETOP, LimitsConfig())
    assert 4.0 * worst.torque_nm < STALL_NM
    give = loads.deflection_mm(TABLETOP, worst.force_n, worst.s_mm)
    assert give / worst.s_mm < np.radians(0.125), "half the servo's play"
    assert loads.deflection_mm(TABLETOP, 0.1 * 9.81, 30.0) < 0.05, "the value of standoff_sd_mm"


def test_the_carrier_vibrates_below_its_resonance_fast_enough():
    lowest, highest = min(loads.MOTORS_HZ), max(loads.MOTORS_HZ)
    assert highest - lowest > 5.0, "independent vibrations"
    force = loads.motor_force_n()
    for stiffness in (1.0, *loads.FOAM_RANGE):
        mount = loads.mount(TABLETOP, stiffness)
        assert highest < 0.5 * mount.resonance_hz, "no law of friction is valid near the resonance"
        assert mount.speed_m_s(force, lowest) > 0.009
    assert loads.mount(TABLETOP).speed_m_s(force, lowest) > 2.0 * 0.012, "reserve"


def test_the_carrier_sinks_little():
    mount, worst = loads.mount(TABLETOP), loads.worst(TABLETOP, LimitsConfig())
    assert mount.sink_mm(worst.force_n, worst.s_mm) < 0.1
    assert mount.tilt_rad(worst.force_n, worst.s_mm) < np.radians(0.125), "half the servo's play"
    assert mount.sink_mm(0.1 * 9.81, 20.0) < 0.05, "the value of standoff_sd_mm"


def test_limits_of_the_mount():
    mount = loads.mount(TABLETOP)
    assert mount.tilt_rad(1.0, mount.middle_mm) == pytest.approx(0.0)
    assert mount.sink_mm(1.0, mount.middle_mm) == pytest.approx(1e3 / mount.normal_n_m)
    slow = mount.speed_m_s(1.0, 1.0) / (2.0 * np.pi)
    assert slow == pytest.approx(1.0 / mount.shear_n_m, rel=1e-4), "far below the resonance: the foam's stiffness"
    fast = mount.speed_m_s(1.0, 1e5) * 2.0 * np.pi * 1e5
    assert fast == pytest.approx(1.0 / mount.mass_kg, rel=1e-3), "far above it: the mass"
    assert loads.mount(TABLETOP, 4.0).resonance_hz == pytest.approx(2.0 * mount.resonance_hz)
    one = loads.mount(replace(TABLETOP, foam_pads=2, foam_length=31.25))
    assert one.tilting_nm_rad == pytest.approx(one.normal_n_m * 0.0625**2 / 12.0), "two pads that touch"


def test_the_firmware_drives_the_motors_at_the_computed_frequencies():
    program = (firmware.FIRMWARE / "strip.ino").read_text()
    assert f"PERIOD_PALM1 = {loads.MOTOR_PERIODS[0]}, PERIOD_PALM2 = {loads.MOTOR_PERIODS[1]};" in program


def test_forces_balance_the_weight():
    g, weight = TABLETOP, loads.LARGEST_KG * loads.GRAVITY_M_S2
    load = loads.worst(g, LimitsConfig(phi1_deg=(44.0, 46.0), phi2_deg=(90.0, 92.0)), 20.0)
    assert load.force_n == pytest.approx(weight / 2**0.5, rel=0.06)
    assert load.s_mm == pytest.approx(20.0, rel=0.04)
    assert load.torque_nm == pytest.approx((load.force_n * load.s_mm + 0.0233 * 9.81 * 26.5) * 1e-3, rel=0.05)


def test_without_the_programs_the_skipped_steps_are_listed(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    lines = kit.make(tmp_path / "kit", TABLETOP)
    assert {path.name for path in (tmp_path / "kit").iterdir()} == set(kit.TEXTS)
    assert sum("skipped" in line and "apt-get install" in line for line in lines) == 3


def test_another_dimension_is_accepted_and_an_invalid_one_refused(tmp_path, capsys):
    assert kit.changed(["strip_length=73.5"]).strip_end == 76.0
    assert kit.main(["-o", str(tmp_path), "--set", "strip=3"]) == 1
    assert "there is no dimension 'strip'" in capsys.readouterr().err
    assert kit.main(["-o", str(tmp_path), "--set", "strip_length=long"]) == 1
    assert "is not a number" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("openscad") is None, reason="openscad is not installed")
def test_printed_parts_are_closed_fit_the_bed_and_do_not_overlap(tmp_path, monkeypatch):
    """With fewer facets than `make kit` prints, which takes a fraction of the time."""
    program = tmp_path / "coarse" / kit.PROGRAM.name
    program.parent.mkdir()
    program.write_text(kit.PROGRAM.read_text().replace("$fn = 64;", "$fn = 20;"))
    monkeypatch.setattr(kit, "PROGRAM", program)
    (tmp_path / "parameters.scad").write_text(kit.TEXTS["parameters.scad"](TABLETOP))
    assert len(kit.printed(tmp_path, TABLETOP)) == 5
    parts = {name: read_stl(tmp_path / f"{name}.stl") for name in ("palm", "carrier", "bracket", "base")}
    assert parts["base"].size == pytest.approx((TABLETOP.base_length, TABLETOP.base_width, TABLETOP.base_thickness))
    palm = parts["palm"].triangles.reshape(-1, 3)
    assert palm[:, 0].max() == pytest.approx(TABLETOP.palm_length)
    assert palm[:, 1].max() == pytest.approx(TABLETOP.cheek_end)
    assert parts["palm"].volume * 1e-9 * loads.PLA_KG_M3 == pytest.approx(loads.palm_mass_kg(TABLETOP), rel=0.1)
    carrier = loads.carrier_mass_kg(TABLETOP) - loads.MOTOR_KG
    assert parts["carrier"].volume * 1e-9 * loads.PLA_KG_M3 == pytest.approx(carrier, rel=0.3), "without the strip"
    low = {**parts, "carrier": parts["carrier"].moved(np.eye(3), np.array([0.0, 0.0, -1.2]))}
    assert any("palm 1 and carrier 1" in line for line in collisions(TABLETOP, low)), "1.2 mm of 1 mm of foam"
    thick = {**parts, "palm": parts["palm"].moved(np.eye(3), np.array([0.0, 0.3, 0.0]))}
    assert any("palm 1 and palm 2" in line for line in collisions(TABLETOP, thick)), "each 0.3 mm out of 0.5"
    assert set(assembled(TABLETOP, parts, 45.0, 135.0)) >= {"palm 1", "palm 2", "servo 1", "bracket 2", "base"}


@pytest.mark.skipif(
    shutil.which("avr-g++") is None or not firmware.ARDUINO.is_dir(), reason="no AVR compiler or Arduino core"
)
def test_the_strips_firmware_is_built_for_a_board(tmp_path):
    assert firmware.build(tmp_path)["strip-atmega32u4.hex"].startswith("built")
    assert 2000 < firmware.flash_bytes(tmp_path / "strip-atmega32u4.hex") < firmware.FLASH_BYTES
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == []


def test_ten_bits_read_four_times_are_within_the_packets_range():
    assert POSITION_MAX >= 4 * 4 * 1023
