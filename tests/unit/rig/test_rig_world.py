"""The whole emulated rig without ports: closed loop with the host's link, determinism, fault injection."""

import math

import numpy as np
import pytest

from palmd.config.vibration import VibrationConfig
from palmd.devices.actuator import make_actuator
from palmd.devices.armlink import ArmState, Pose
from palmd.devices.pad import make_pad
from palmd.events import PadLift, PadSample
from palmd.rig.adept_arm import arm_limits
from palmd.rig.arm import Linkage
from palmd.rig.dry_plant import DryPlant
from palmd.rig.fault_injection import order
from palmd.rig.plant import Plant, PlantOptions
from palmd.rig.vibrating_plant import VibratingPlant
from palmd.rig.world import World, default_config

CONFIG = default_config()
LINKAGE = Linkage.from_config(CONFIG)


class Loop:
    """A world, and a host that rocks the palms through the link, in steps of milliseconds."""

    def __init__(self, seed=1, *, rocking=True, config=CONFIG, **options):
        self.world = World(config, seed, t=100.0, **options)
        self.host = make_actuator(config.arm)
        self.pads = [make_pad(number, CONFIG.pads.of(number)) for number in (1, 2)]
        self.rocking = rocking
        self.asked = False
        self.t_tracking = math.inf
        self.events, self.reports, self.truth = [], [], []
        self.said = b""
        self.ms = 0

    @property
    def status(self):
        return self.world.status()

    def inject(self, name, **settings):
        self.world.fault_injector.add(order(name, self.world.t, **settings))

    def run(self, seconds):
        for _ in range(round(seconds * 1e3)):
            self.ms += 1
            self._tick(100.0 + self.ms * 1e-3)
        return self

    def _tick(self, t):
        out = self.world.advance(t)
        self.said += out["pad1"] + out["pad2"] + out["arm"]
        for number, pad in enumerate(self.pads, 1):
            self.events += pad.feed(out[f"pad{number}"], t)
            lift = pad.poll(t)
            self.events += [lift] if lift else []
        self.reports += self.host.feed(out["arm"], t)
        if self.rocking and not self.asked and self.host.state is ArmState.READY:
            self.asked = True
            self.host.request_tracking()
        if self.host.tracking:
            self.t_tracking = min(self.t_tracking, t)
        said = self.host.poll(t, self._target(t) if self.host.tracking else None).data
        if said:
            self.world.receive("arm", said)
        self.truth.append((t, self.world.truth()))

    def _target(self, t):
        u = t - self.t_tracking
        grow = min(u, 1.0) ** 2 * (3.0 - 2.0 * min(u, 1.0))
        swing = grow * np.radians((15.0, 7.0)) * np.sin(2 * math.pi * np.array((0.4, 0.31)) * u)
        return LINKAGE.pose(math.radians(45.0) + swing[0], math.radians(90.0) + swing[1])

    def true(self, name):
        return [t for t, _ in self.truth], [truth[name] for _, truth in self.truth]


@pytest.fixture(scope="module")
def long_run():
    return Loop(seed=2).run(6.0)


def test_nothing_is_lost_or_refused_without_faults(long_run):
    status = long_run.status
    assert status["arm_state"] == "T"
    assert status["setpoints"] == status["accepted"] > 300
    none = ("crc_errors", "unparsable", "superseded", "clamped", "braked", "contact_losses", "falls", "jams")
    assert [status[name] for name in (*none, "setpoints_outside_limits")] == [0] * 9
    assert status["largest_rate_deg_s"] < 60.0
    assert status["largest_tool_error_deg"] < 0.05


def test_pad_reports_are_true_at_their_sample_times(long_run):
    for pad in (1, 2):
        samples = [e for e in long_run.events if isinstance(e, PadSample) and e.pad == pad]
        t = [sample.t_sample for sample in samples]
        error = np.array([sample.s for sample in samples]) - np.interp(t, *long_run.true(f"s{pad}_m"))
        assert len(samples) > 500
        assert abs(error.mean()) < 2e-5
        assert error.std() < 1.3e-4
        force = np.array([sample.force for sample in samples]) / np.interp(t, *long_run.true(f"f{pad}_n"))
        assert force.mean() == pytest.approx(1.0, abs=0.12)
        assert 0.02 < force.std() < 0.08


def test_arm_reports_are_true_at_their_sample_times(long_run):
    t = [report.t_sample for report in long_run.reports]
    angles = np.array([LINKAGE.angles(report.pose.x_m, report.pose.y_m) for report in long_run.reports])
    for column, name in enumerate(("phi1_rad", "phi2_rad")):
        error = angles[:, column] - np.interp(t, *long_run.true(name))
        assert abs(error.mean()) < 5e-5
        assert 5e-5 < error.std() < 3e-4


def test_a_packets_first_byte_arrives_when_it_was_measured():
    world = World(CONFIG, 1)
    pad = world._pads["pad1"]
    measured, arrived, report = [], [], pad.report
    pad.report = lambda t, presses: measured.append(t) or report(t, presses)
    for k in range(1, 4000):
        if any(byte & 0xC0 == 0xC0 for byte in world.advance(k * 1e-4)["pad1"]):
            arrived.append(k * 1e-4)
    assert len(arrived) > 20
    np.testing.assert_allclose(arrived, measured[: len(arrived)], atol=2e-4)


def test_the_same_seed_and_input_give_the_same_bytes():
    first, again, other = (Loop(seed).run(0.6) for seed in (5, 5, 6))
    assert first.said == again.said
    assert first.said != other.said
    assert first.world.object_truth() == again.world.object_truth()


def test_before_any_command_the_arm_is_ready_with_a_body_at_rest():
    still = CONFIG.rig.model_copy(update={"vibration": VibrationConfig(relation="none")})
    loop = Loop(rocking=False, config=CONFIG.model_copy(update={"rig": still})).run(0.3)
    truth = loop.world.truth()
    assert truth["arm_state"] == "R"
    assert (truth["phi1_rad"], truth["phi2_rad"]) == pytest.approx((math.radians(45), math.radians(90)))
    assert truth["contact1"]
    assert truth["contact2"]
    assert abs(truth["omega0_rad_s"]) < 1e-3


def test_the_true_outline_is_that_of_the_contacts():
    world = Loop(rocking=False).run(0.1).world
    body, truth = world.object_truth(), world.truth()
    theta1 = (truth["phi1_rad"] - truth["psi_rad"] - math.pi / 2) % math.tau
    h = np.interp(theta1, body["theta_rad"], body["h_m"], period=math.tau)
    assert h == pytest.approx(truth["r1_m"], abs=2e-6)
    assert len(body["h_m"]) == 360


def test_arm_limits_contain_every_allowed_pose_and_rate():
    limits = arm_limits(CONFIG)
    for phi1 in np.radians(np.linspace(6, 150, 23)):
        for phi2 in np.radians(np.linspace(35, 155, 19)):
            if phi1 + phi2 < math.radians(172.0):
                assert limits.contain(LINKAGE.pose(phi1, phi2))
    assert not limits.contain(LINKAGE.pose(math.radians(1.0), math.radians(20.0)))
    omega = math.radians(120.0)
    assert limits.v_max > 0.12 * omega + 0.12 * 2 * omega


def test_a_home_outside_the_limits_is_moved_inside():
    limits = CONFIG.limits.model_copy(update={"phi2_deg": (100.0, 120.0)})
    world = World(CONFIG.model_copy(update={"limits": limits}), 1)
    assert world.truth()["phi2_rad"] == pytest.approx(math.radians(100.0))


def test_a_silent_host_makes_the_arm_hold_and_give_up():
    loop = Loop().run(1.0)
    world, t = loop.world, loop.world.t
    loop.host = make_actuator(CONFIG.arm)
    world.advance(t + 0.1)
    assert world.status()["arm_state"] == "H"
    world.advance(t + 0.3)
    assert world.status()["arm_state"] == "F"


def test_an_absurd_target_cannot_break_the_linkage():
    limits = CONFIG.limits.model_copy(update={"phi1_deg": (6.0, 179.0), "phi2_deg": (20.0, 179.0)})
    loop = Loop(config=CONFIG.model_copy(update={"limits": limits}))
    stretched = LINKAGE.pose(0.1, math.radians(178.0))
    start = LINKAGE.pose(math.radians(45.0), math.radians(90.0))
    loop.run(0.3)

    def towards(t):
        u = min(1.0, (t - loop.t_tracking) / 1.0)
        x, y = (a + u * (b - a) for a, b in ((start.x_m, stretched.x_m), (start.y_m, stretched.y_m)))
        return Pose(x, y, start.t_rad)

    loop._target = towards
    loop.run(1.5)
    assert loop.status["jams"] > 0
    assert all(math.isfinite(truth["psi_rad"]) for _, truth in loop.truth)


@pytest.mark.parametrize(
    ("name", "state", "after"), [("estop", "X", "R"), ("power_off", "P", "R"), ("manual", "M", "R")]
)
def test_an_operators_action_changes_the_arms_state_and_its_end_restores_it(name, state, after):
    loop = Loop().run(0.8)
    loop.inject(name, for_s=0.3)
    loop.run(0.2)
    assert loop.status["arm_state"] == state
    loop.run(0.2)
    assert loop.status["arm_state"] == after
    if name == "estop":
        assert loop.host.last_error == -621


def test_repeated_manual_mode_leaves_the_palms_within_their_limits():
    loop = Loop(rocking=False).run(0.1)
    low, high = CONFIG.limits.phi1_deg
    away_deg = []
    for _ in range(6):
        loop.inject("manual")
        loop.run(1.0)
        loop.world.fault_injector.cancel("manual", None)
        loop.run(0.1)
        phi1_deg = math.degrees(loop.world.truth()["phi1_rad"])
        assert low < phi1_deg < high
        away_deg.append(phi1_deg - 45.0)
    assert away_deg[0] == pytest.approx(4.0, abs=0.1)
    assert max(map(abs, away_deg)) < 4.5


def test_a_break_on_the_line_faults_the_moving_arm():
    loop = Loop().run(0.8)
    loop.inject("break")
    loop.run(0.2)
    assert loop.status["arm_state"] == "F"
    assert loop.host.last_error == -504


@pytest.mark.parametrize("name", ["drop", "garble", "misbaud"])
def test_damaged_bytes_reach_both_ends(name):
    loop = Loop().run(0.5)
    loop.inject(name)
    loop.run(1.0)
    assert loop.pads[0].counts()["bytes_discarded"] > 5
    controller, host = loop.world.status(), loop.host.counters.line
    if name == "misbaud":
        assert controller["arm_state"] == "F"
    else:
        assert controller["crc_errors"] > 0
        assert host.crc_errors + host.unframed > 0


def test_mute_is_silence_both_ways():
    loop = Loop().run(0.8)
    loop.inject("mute", port="arm")
    before, accepted = len(loop.reports), loop.status["accepted"]
    loop.run(0.1)
    assert len(loop.reports) <= before + 1
    assert loop.status["accepted"] <= accepted + 1
    assert len([e for e in loop.events if isinstance(e, PadLift)]) == 0


def test_late_and_burst_shift_bytes_in_time():
    quiet, late, burst = Loop(rocking=False), Loop(rocking=False), Loop(rocking=False)
    late.inject("late", port="pad1", strength=0.1)
    burst.inject("burst", port="pad1", strength=0.05)
    arrivals = []
    for loop in (quiet, late, burst):
        loop.run(1.0)
        arrivals.append([e.t_sample for e in loop.events if isinstance(e, PadSample) and e.pad == 1])
    shift = arrivals[1][50] - arrivals[0][50]
    assert shift == pytest.approx(0.1, abs=2e-3)
    assert loop.pads[0].counts()["batches"] > 10


def test_a_finger_shifts_the_reading_towards_itself():
    loop = Loop(rocking=False).run(0.5)
    mean = np.mean([e.s for e in loop.events if isinstance(e, PadSample) and e.pad == 1])
    loop.inject("touch", port="pad1", strength=2.0)
    loop.run(0.1)
    loop.events.clear()
    loop.run(0.5)
    touched = np.mean([e.s for e in loop.events if isinstance(e, PadSample) and e.pad == 1])
    assert touched > mean + 5e-3


def test_an_object_is_lifted_and_put_back():
    loop = Loop(rocking=False).run(0.5)
    loop.inject("lift", for_s=0.5)
    loop.run(0.4)
    assert {e.pad for e in loop.events if isinstance(e, PadLift)} == {1, 2}
    assert not loop.status["on_palms"]
    loop.events.clear()
    loop.run(0.5)
    assert {e.pad for e in loop.events if isinstance(e, PadSample)} == {1, 2}
    assert loop.status["object"] == 1
    assert loop.status["falls"] == 0


def test_swap_gives_another_body():
    loop = Loop(rocking=False).run(0.2)
    before = loop.world.object_truth()["h_m"]
    loop.inject("swap")
    loop.run(0.5)
    assert not loop.status["on_palms"]
    loop.run(1.0)
    assert loop.status["on_palms"]
    assert loop.status["object"] == 2
    assert loop.world.object_truth()["h_m"] != before


def test_a_pad_with_a_handshake_sends_its_identity_after_each_break():
    pads = CONFIG.pads.model_copy(update={"palm1": CONFIG.pads.palm1.model_copy(update={"handshake": "break_twice"})})
    world = World(CONFIG.model_copy(update={"pads": pads}), 1)
    world.opened("pad1")
    world.opened("pad2")
    out = {"pad1": b"", "pad2": b""}
    for k in range(1, 1300):
        for port, data in world.advance(k * 1e-3).items():
            if port != "arm":
                out[port] += data
    assert out["pad1"].count(b"VPEMU1\r") == 2
    assert b"VP" not in out["pad2"]


def test_a_pinned_hinge_and_extra_lag_change_the_motion():
    ends = [
        Loop(seed=3, options=options).run(2.0).world.truth()["psi_rad"]
        for options in (PlantOptions(), PlantOptions(hinge_travels=False), PlantOptions(lag_s=0.05))
    ]
    assert abs(ends[1] - ends[0]) > 1e-4
    assert abs(ends[2] - ends[0]) > 1e-3


@pytest.mark.parametrize(
    ("vibration", "plant"),
    [
        ({}, VibratingPlant),
        ({"relation": "unknown"}, VibratingPlant),
        ({"relation": "none"}, DryPlant),
        ({"law": "averaged"}, Plant),
    ],
)
def test_the_palms_vibrate_as_configured(vibration, plant):
    rig = CONFIG.rig.model_copy(update={"vibration": VibrationConfig(**vibration)})
    world = World(CONFIG.model_copy(update={"rig": rig}), 1)
    assert type(world.plant) is plant


def test_a_configured_speed_and_phase_are_those_of_the_emulated_palms():
    block = VibrationConfig(
        relation="antiphase", speed_m_s=0.02, speed_sd_m_s=0.0, frequency_hz=300.0, transmission=0.5
    )
    rig = CONFIG.rig.model_copy(update={"vibration": block})
    world = World(CONFIG.model_copy(update={"rig": rig}), 1)
    one, two = world.plant.shaking.palms
    assert (one.speed, one.frequency) == (two.speed, two.frequency) == (0.02, 300.0)
    assert (two.phase - one.phase) % math.tau == pytest.approx(math.pi)
    assert 0.1 < one.mount.mass / (one.mount.mass + world.plant.body.mass) < 0.95
    assert world.object_truth()["dither_m_s"] == pytest.approx(0.5 * math.pi * 0.02)
    world.advance(0.3)
    assert all(contact.touching for contact in world.plant.contacts())
