"""A turned cylinder on the emulated palms: its pose at rest, and errors in its description."""

import math

import pytest

from palmd.cli import main
from palmd.config.vibration import VibrationConfig
from palmd.events import PalmMotion
from palmd.rig.plant import stable_poses
from palmd.rig.shapes import area_moments, cylinder
from palmd.rig.world import World, default_config

BODY = cylinder(0.02, 0.1)


def test_it_is_a_disc_of_uniform_density():
    area, cx, cy, rho = area_moments(BODY.support)
    assert area == pytest.approx(math.pi * 0.02**2, rel=1e-4)
    assert (cx, cy) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert BODY.rho == pytest.approx(rho, rel=1e-4)
    assert BODY.support.at(1.234) == pytest.approx((0.02, 0.0, 0.0), abs=1e-12)


def test_it_rests_at_any_angle():
    for phi2 in (0.8, 1.6, 2.4):
        assert stable_poses(BODY, PalmMotion.at_rest((0.6, phi2))) == [0.0]


def test_it_rests_on_both_palms_and_returns():
    config = default_config()
    rig = config.rig.model_copy(update={"vibration": VibrationConfig(law="averaged")})  # the body stays at rest
    world = World(config.model_copy(update={"rig": rig}), 1, bodies=[BODY])
    for _ in range(2):
        world.advance(world.t + 1.5)
        truth = world.truth()
        # a V of 45° and 90° about the vertical: s = R, and both forces m g sin 45°
        assert (truth["s1_m"], truth["s2_m"]) == pytest.approx((0.02, 0.02), abs=1e-5)
        assert (truth["f1_n"], truth["f2_n"]) == pytest.approx((0.981 / math.sqrt(2.0),) * 2, rel=1e-3)
        assert abs(truth["omega0_rad_s"]) < 1e-6
        world.new_object()
    assert world.object_truth()["shape"] == "cylinder"


@pytest.mark.parametrize("text", ["20", "20,100,3", "a,b", "nan,100", "20,-1", "0,100", "201,100", "20,inf"])
def test_an_invalid_cylinder_is_rejected(text, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["rig", f"--cylinder={text}"])
    assert caught.value.code == 2
    assert "--cylinder" in capsys.readouterr().err


def test_a_cylinder_and_a_marble_exclude_each_other():
    with pytest.raises(SystemExit):
        main(["rig", "--cylinder", "20,100", "--marble", "1"])
