"""Valid and invalid configurations, and the values derived from them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from palmd.config.addresses import from_here
from palmd.config.any_config import config_hash
from palmd.config.guards import force_limits
from palmd.config.two_palms import Config, PlanSpec, rig_description
from palmd.devices.servobus import RADIANS_PER_COUNT
from palmd.system.vibration import AVERAGED, Vibration
from palmd.yamlfile import load_config

ROOT = Path(__file__).parents[2]
PORTS: dict[str, Any] = {"pads": {"palm1": {"port": "/dev/a"}, "palm2": {"port": "/dev/b"}}, "arm": {"port": "/dev/c"}}


def config(folder: Path = Path("/etc/palmd"), **rest: Any) -> Config:
    return Config.model_validate({**PORTS, **rest}, context={"folder": folder})


def faults(**rest: Any) -> list[tuple[str, str]]:
    with pytest.raises(ValidationError) as caught:
        config(**rest)
    named = [([str(part) for part in fault["loc"]], fault["msg"]) for fault in caught.value.errors()]
    return [(".".join(part for part in loc if not part.startswith("<")), text) for loc, text in named]


def test_only_the_ports_have_no_default_and_the_defaults_are_the_shipped_rig() -> None:
    shipped = load_config(ROOT / "config/palmd.yaml")
    bare = config(ROOT / "config", plan="plans/rock.yaml")
    ports = {"pads": shipped.pads, "arm": shipped.arm}
    assert bare.model_copy(update=ports) == shipped
    assert {name for name, _ in faults(pads={}, arm={})} == {"pads.palm1", "pads.palm2", "arm.port"}


def test_relative_paths_start_at_the_configuration() -> None:
    made = config(Path("/etc/palmd"), record={"directory": "../runs"}, plan="/srv/plan.yaml")
    assert made.record.directory == Path("/etc/palmd/../runs")
    assert made.plan == Path("/srv/plan.yaml")
    assert config(Path("/etc/palmd")).record.directory == Path("/etc/palmd/runs")
    assert config(Path("/etc/palmd")).plan is None


def test_curved_palms_are_in_the_observers_rig_description() -> None:
    made = config(rig={"palm1_curvature_per_m": 13.3, "palm2_curvature_per_m": -8.0})
    assert rig_description(made).curvatures == (13.3, -8.0)
    assert not rig_description(config()).curved


def test_a_vibration_is_in_the_observers_rig_description() -> None:
    assert rig_description(config()).vibration == Vibration()
    block: dict[str, Any] = {"relation": "in_phase", "frequency_hz": 250.0, "speed_m_s": 0.015, "speed_sd_m_s": 1e-3}
    block["transmission"] = 1.0
    known = Vibration("in_phase", frequency=250.0, speed=0.015, speed_sd=1e-3, transmission=1.0)
    assert rig_description(config(rig={"vibration": block})).vibration == known
    block["speed_m_s_sd"] = block.pop("speed_sd_m_s")
    assert rig_description(config(rig={"vibration": block})).vibration == known
    assert rig_description(config(rig={"vibration": {"law": "averaged"}})).vibration == AVERAGED


def test_a_transmission_without_an_sd_is_not_exact() -> None:
    assert Vibration(transmission=0.5).nominal_transmission_sd == Vibration().nominal_transmission_sd > 0.05
    assert Vibration(transmission=0.5, transmission_sd=0.0).nominal_transmission_sd == 0.0


@pytest.mark.parametrize(
    ("block", "name"),
    [
        ({"relation": "alike"}, "relation"),
        ({"speed_m_s": 0.0}, "speed_m_s"),
        ({"frequency_hz": -1.0}, "frequency_hz"),
        ({"transmission": 1.01}, "transmission"),
        ({"transmission_sd": -0.1}, "transmission_sd"),
        ({"law": "old"}, "law"),
        ({"amplitude_mm": 0.1}, "amplitude_mm"),
    ],
)
def test_an_impossible_vibration_is_refused(block: dict[str, Any], name: str) -> None:
    assert [each for each, _ in faults(rig={"vibration": block})] == [f"rig.vibration.{name}"]


def test_features_unsupported_on_curved_palms_are_refused() -> None:
    curved = {"palm2_curvature_per_m": 13.3}
    ((name, text),) = faults(rig=curved, observer={"primary": "extended"})
    assert name == "observer"
    assert "extended knows flat palms only; these are curved: set primary to shape" in text
    ((_, text),) = faults(rig={"palm1_curvature_per_m": 40.0})
    assert "rig.palm1_curvature_per_m bends the pad by more than a quarter turn" in text


def test_only_a_cradle_may_point_downwards() -> None:
    below = {"phi1_deg": [-10, 110]}
    assert config(rig={"palm1_curvature_per_m": 13.3}, limits=below).limits.phi1_deg == (-10, 110)
    for flat in ({}, {"palm2_curvature_per_m": 13.3}, {"palm1_curvature_per_m": -8.0}):
        ((name, text),) = faults(rig=flat, limits=below)
        assert name == "limits"
        assert "only a cradle may point downwards" in text


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:9872", "tcp://127.8.9.1:1", "tcp://localhost:65535", "ipc:///run/palmd/publish"]
)
def test_addresses_on_this_machine_are_accepted(address: str) -> None:
    assert config(bus={"publish": address}).bus.publish == address


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("tcp://0.0.0.0:9872", "CURVE keys"),
        ("tcp://*:9872", "CURVE keys"),
        ("tcp://192.168.1.4:9872", "CURVE keys"),
        ("tcp://127.0.0.1.example.org:9872", "CURVE keys"),
        ("tcp://[::]:9872", "CURVE keys"),
        ("tcp://127.0.0.1", "must be tcp://ADDRESS:PORT"),
        ("tcp://127.0.0.1:0", "must be tcp://ADDRESS:PORT"),
        ("tcp://127.0.0.1:70000", "must be tcp://ADDRESS:PORT"),
        ("tcp://127.0.0.1:x", "must be tcp://ADDRESS:PORT"),
        ("tcp://127.0.0.1:98/x", "must be tcp://ADDRESS:PORT"),
        ("tcp://[::1:99", "must be tcp://ADDRESS:PORT"),
        ("udp://127.0.0.1:9872", "must be tcp://ADDRESS:PORT"),
        ("ipc://", "must be tcp://ADDRESS:PORT"),
        ("", "must be tcp://ADDRESS:PORT"),
    ],
)
def test_other_addresses_are_refused(address: str, said: str) -> None:
    ((name, text),) = faults(bus={"command": address})
    assert name == "bus.command"
    assert said in text


@pytest.mark.parametrize("address", ["tcp://0.0.0.0:9872", "tcp://192.168.1.4:9872", "tcp://127.0.0.1:1", "ipc:///x"])
def test_with_keys_any_address_of_the_machine_is_accepted(address: str) -> None:
    made = config(bus={"publish": address, "keys": "keys"})
    assert made.bus.publish == address
    assert made.bus.keys == Path("/etc/palmd/keys")


@pytest.mark.parametrize(
    "address", ["tcp://*:9872", "tcp://eth0:9872", "tcp://[::]:9872", "tcp://0.0.0.0:0", "udp://0.0.0.0:9"]
)
def test_keys_do_not_make_an_invalid_address_valid(address: str) -> None:
    ((name, text),) = faults(bus={"publish": address, "keys": "keys"})
    assert name == "bus.publish"
    assert "must be" in text


@pytest.mark.parametrize("keys", ["", 3, True])
def test_missing_keys_are_reported_at_their_own_place(keys: object) -> None:
    assert [name for name, _ in faults(bus={"publish": "tcp://0.0.0.0:9872", "keys": keys})] == ["bus.keys"]


def test_a_program_on_the_same_machine_connects_by_loopback() -> None:
    assert from_here("tcp://0.0.0.0:9872") == "tcp://127.0.0.1:9872"
    assert from_here("tcp://192.168.1.4:9872") == "tcp://192.168.1.4:9872"


def test_ports_and_addresses_must_differ() -> None:
    same = "tcp://127.0.0.1:9"
    assert faults(bus={"publish": same, "command": same})[0][0] == "bus.command"
    palm1, palm2 = {"port": "/dev/a"}, {"port": "/dev/a"}
    assert faults(pads={"palm1": palm1, "palm2": palm2})[0][0] == "pads.palm2"
    assert faults(arm={"port": "/dev/b"})[0][0] == "arm"


@pytest.mark.parametrize(
    ("section", "name"),
    [
        ({"rig": {"gravity_m_s2": 0}}, "rig.gravity_m_s2"),
        ({"rig": {"gravity_m_s2": "9.81"}}, "rig.gravity_m_s2"),
        ({"rig": {"gravity_m_s2": True}}, "rig.gravity_m_s2"),
        ({"rig": {"base_mm": [1.0, float("nan")]}}, "rig.base_mm.1"),
        ({"rig": {"hinge": "Arc"}}, "rig.hinge"),
        ({"rig": {"hinge": "fixed"}}, "arm"),
        ({"arm": {"port": "/dev/c", "kind": "scara"}}, "arm"),
        ({"arm": {"port": "/dev/c", "kind": "dynamixel"}}, "arm"),
        ({"arm": {"port": "/dev/c", "kind": "dynamixel", "servo1": {"id": 253}}}, "arm.servo1.id"),
        ({"limits": {"phi1_deg": [150, 6]}}, "limits.phi1_deg"),
        ({"limits": {"phi1_deg": [6, 6]}}, "limits.phi1_deg"),
        ({"limits": {"phi1_deg": [-31, 150]}}, "limits.phi1_deg"),
        ({"limits": {"phi2_deg": [35, 180]}}, "limits.phi2_deg"),
        ({"limits": {"rate_deg_s": float("inf")}}, "limits.rate_deg_s"),
        ({"limits": {"force_n": -1.0}}, "limits.force_n"),
        ({"limits": {"force_n": {"palm1": 0.0}}}, "limits.force_n.palm1"),
        ({"limits": {"force_n": {"palm3": 1.0}}}, "limits.force_n"),
        ({"limits": {"force_n": "much"}}, "limits.force_n"),
        ({"limits": {"following_error": {"at_rest_deg": 0}}}, "limits.following_error.at_rest_deg"),
        ({"limits": {"following_error": {"at_rest_deg": 2, "at_full_rate_deg": 1}}},
         "limits.following_error.at_full_rate_deg"),
        ({"limits": {"following_error": {"at_rest_mm": 9, "at_full_rate_mm": 8}}},
         "limits.following_error.at_full_rate_mm"),
        ({"limits": {"following_error": {"at_rest": 1}}}, "limits.following_error.at_rest"),
        ({"limits": {"following_error": 3}}, "limits.following_error"),
        ({"arm": {"port": "/dev/c", "baud": 38401}}, "arm.baud"),
        ({"arm": {"port": ""}}, "arm.port"),
        ({"loop": {"rate_hz": 5}}, "loop.rate_hz"),
        ({"observer": {"primary": "best"}}, "observer.primary"),
        ({"autostart": 1}, "autostart"),
        ({"plan": 3}, "plan"),
        ({"plans": "x"}, "plans"),
    ],
)  # fmt: skip
def test_an_error_is_reported_at_its_key(section: dict[str, Any], name: str) -> None:
    assert [fault[0] for fault in faults(**section)] == [name]


@pytest.mark.parametrize(
    ("force_n", "expected"),
    [(None, (2.54, 5.0)), (1.5, (1.5, 1.5)), ({"palm2": 1.0}, (2.54, 1.0)), ({"palm1": 1.0, "palm2": 2.0}, (1.0, 2.0))],
)
def test_force_limits_are_for_all_pads_or_each_and_default_to_saturation(force_n, expected) -> None:
    limits = config(limits={} if force_n is None else {"force_n": force_n}).limits
    assert force_limits(limits.force_n, {"palm1": 2.54, "palm2": 5.0}) == pytest.approx(expected)


def test_a_hinge_that_the_actuator_does_not_drive_is_refused_in_one_sentence() -> None:
    ((_, text),) = faults(rig={"hinge": "fixed"})
    assert "kind adept needs hinge: arc, but rig.hinge is fixed" in text
    ((_, text),) = faults(arm={"port": "/dev/c", "kind": "dynamixel"})
    assert "kind dynamixel needs hinge: fixed, but rig.hinge is arc" in text


def test_an_unknown_kind_is_answered_with_the_list_of_kinds() -> None:
    pads = {"palm1": {"port": "/dev/a", "kind": "pad"}, "palm2": {"port": "/dev/b"}}
    ((name, text),) = faults(pads=pads)
    assert (name, text) == ("pads.palm1", "kind must be one of versapad, strip, evdev, taxels")


def test_play_increases_the_sd_of_an_angle() -> None:
    made = config(rig={"hinge": "fixed"}, arm={"port": "/dev/c", "kind": "dynamixel"})
    rig = rig_description(made)
    assert math.degrees(rig.angle_sd) == pytest.approx(math.hypot(0.1, 0.125))
    assert math.degrees(rig.palm_angle_noise) == pytest.approx(0.04)
    assert rig.goal_rounding == RADIANS_PER_COUNT
    assert rig_description(config()).palm_angle_noise == 2e-4


def test_two_servos_cannot_have_the_same_id() -> None:
    ((name, text),) = faults(arm={"port": "/dev/c", "kind": "dynamixel", "servo2": {"id": 1}})
    assert (name, text) == ("arm.servo2", "Value error, id 1 is already used by servo1")


def test_the_kind_of_a_device_is_optional_and_changes_no_hash() -> None:
    explicit = config(
        pads={"palm1": {"port": "/dev/a", "kind": "versapad"}, "palm2": {"port": "/dev/b"}},
        arm={"port": "/dev/c", "kind": "adept"},
    )
    left_out = config(pads={"palm1": {"port": "/dev/a"}, "palm2": {"port": "/dev/b"}}, arm={"port": "/dev/c"})
    assert (left_out.pads.palm1.kind, left_out.arm.kind) == ("versapad", "adept")
    assert config_hash(explicit) == config_hash(left_out)
    assert "kind" not in explicit.model_dump()["arm"]


def test_the_hash_depends_on_effective_values_only() -> None:
    assert config_hash(config()) == config_hash(config(rig={"gravity_m_s2": 9.81, "base_mm": [120, 0]}))
    assert config_hash(config()) != config_hash(config(rig={"gravity_m_s2": 9.80}))
    assert len(config_hash(config())) == 64


def test_the_rig_description_has_each_pads_own_values() -> None:
    pads = {
        "palm1": {"port": "/dev/a", "length_mm": 50.0, "counts_per_mm": 4.0, "zero_sd_mm": 0.2},
        "palm2": {"port": "/dev/b", "newtons_per_count": 0.05, "noise_mm": 0.3, "lag_sd_ms": 5.0},
    }
    rig = rig_description(config(pads=pads, rig={"palm1_length_mm": 110}))
    assert (rig.hinge, rig.palm1_length, [pad.length for pad in rig.pads]) == ("arc", 0.11, [0.05, 0.0555])
    assert [pad.noise for pad in rig.pads] == [1e-4, 3e-4]
    assert [pad.resolution for pad in rig.pads] == [0.00025, 1e-3 / 7.874]
    assert [pad.force_resolution for pad in rig.pads] == [0.02, 0.05]
    assert [(pad.zero_sd, pad.lag_sd) for pad in rig.pads] == [(2e-4, 2e-3), (1e-4, 5e-3)]


def test_plan_forms() -> None:
    spec = PlanSpec.model_validate(
        {
            "name": "x",
            "repeat": "forever",
            "segments": [{"sine": {"phi1_deg": 5}, "frequency_hz": 1, "duration_s": 2}, {"explore": {}}],
        }
    )
    assert spec.segments[0].frequency_hz == (1.0, 1.0)  # type: ignore[union-attr]
    for repeat in (0, -1, 1.5, True, "often", None):
        with pytest.raises(ValidationError):
            PlanSpec.model_validate({"name": "x", "repeat": repeat, "segments": [{"hold_s": 1}]})
    with pytest.raises(ValidationError):
        PlanSpec.model_validate({"name": "x", "segments": []})
