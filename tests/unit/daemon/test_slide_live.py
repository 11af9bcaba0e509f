"""A pivoting grasp on a slide, closed loop without wires: rolled to and fro, estimated, and told the same again."""

import math
from pathlib import Path

import msgpack
import numpy as np
import pytest

from palmd import pivot_messages as says
from palmd.config.pivot import PivotPlanSpec, pivot_rig
from palmd.observer.pivot.observer import pivot_observer
from palmd.score import score_shape
from palmd.yamlfile import load_any_config, parse, read_document
from tools.closed_loop import PivotLoop

ROOT = Path(__file__).parents[3]
CONFIG = load_any_config(ROOT / "config/slide.yaml")
PLAN = parse(read_document(ROOT / "config/plans/pivot/explore.yaml"), PivotPlanSpec)
SEED, PERIOD_S = 3, 4.0


class Lived:
    def __init__(self):
        self.rig, self.ticks = PivotLoop(CONFIG, PLAN, SEED, period_s=PERIOD_S), []
        tick = self.rig.tick

        def noted():
            self.ticks.append(tick())
            return self.ticks[-1]

        self.rig.tick = noted
        self.rig.start()
        end = math.inf
        while self.rig.t < min(end, 40.0):
            self.rig.tick()
            if self.rig.core.setpoints.over:
                end = min(end, self.rig.t + 1.0)

    def told(self, topic):
        return [tick.messages[topic] for tick in self.ticks if topic in tick.messages]


@pytest.fixture(scope="module")
def lived():
    return Lived()


def test_the_pad_bears_what_body_and_carriage_weigh(lived):
    world = lived.rig.world
    weight = (world.grasp.body.mass + CONFIG.rig.carriage_mass_kg) * CONFIG.rig.gravity_m_s2
    assert world.most_force == pytest.approx(weight, rel=0.1)
    assert (world.jams, world.contact_losses) == (0, 0)
    assert "rolled to and fro, and the outline is known" in lived.rig.core.exploring.reason


def test_the_arm_reports_the_pivot_and_not_the_stop(lived):
    last = lived.ticks[-1]
    reported, stop = last.messages["palm/pivot_motion"]["z_m"], last.messages["palm/pivot_motion"]["z_cmd_m"]
    assert reported == pytest.approx(last.truth["z_m"], abs=3e-4)
    assert reported > stop + 4e-3


def test_a_stop_that_is_lowered_says_nothing_of_how_late_the_arm_follows(lived):
    assert lived.rig.core.arm.lag.lag_s == pytest.approx(0.0475, abs=2e-3)


def test_what_is_valid_is_right_within_its_band(lived):
    off = {name: [] for name in ("psi_rad", "omega0_rad_s", "e_m", "f1_n", "z_m")}
    for tick in lived.ticks:
        said = tick.messages["palm/pivot"]
        if said["valid"]:
            for name, errors in off.items():
                errors.append((said[name] - tick.truth[name], said["sd"][name]))
    assert len(off["psi_rad"]) > 150
    for name, errors in off.items():
        error, sd = np.array(errors).T
        if name == "psi_rad":  # counted from elsewhere
            error = np.angle(np.exp(1j * (error - np.median(error))))
        assert np.sqrt(np.mean((error / sd) ** 2)) < 3.0, name
    assert np.sqrt(np.mean(np.square([error for error, _ in off["e_m"]]))) < 2e-4  # it passes over the contact


def test_the_outline_is_right_within_its_band(lived):
    shape = lived.told("palm/pivot_shape")[-1]
    mine = {"theta_rad": shape["theta_rad"], "h_m": shape["hP_m"], "touched": shape["touched"]}
    score = score_shape(mine, lived.rig.world.object_truth()["hP_m"], all_normals=False)
    touched = np.array(shape["touched"]) > 0
    assert score.e_h < 3.0 * math.sqrt(np.mean(np.array(shape["hP_sd_m"])[touched] ** 2)) < 3e-4
    assert score.touched > 0.15


def test_told_the_same_it_says_the_same_to_the_last_bit(lived):
    answers = {fields["t_tick_s"]: says.answer_of(fields) for fields in lived.told("palm/pivot_answer")}

    class Recorded:
        def submit(self, t, events):
            pass

        def collect(self, t):
            return answers.get(t)

    again = pivot_observer(pivot_rig(CONFIG), Recorded())
    for tick in lived.ticks:
        fed = tick.messages["palm/pivot_events"]
        for event in says.events_of(fed):
            again.feed(event)
        again.improve(fed["t_tick_s"])
        now = says.estimate_fields(again.estimate(fed["t_tick_s"]))
        assert msgpack.packb(now) == msgpack.packb(dict(tick.messages["palm/pivot"]))


def test_what_is_lifted_is_unknown_until_it_is_told_anew(lived):
    rig = lived.rig
    rig.world._lose_contact()
    for _ in range(60):
        tick = rig.tick()
    said = tick.messages["palm/pivot"]
    assert not said["valid"]
    assert said["reason"] == "nothing touches the pad"
    assert math.isnan(said["psi_rad"])
