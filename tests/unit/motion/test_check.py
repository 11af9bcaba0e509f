"""`palmd check` of configurations and plans together: all errors with their places."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from shut import shut

from palmd.config.two_palms import LimitsConfig
from palmd.console.shipped import shipped
from palmd.daemon.planner import read_plan
from palmd.keys import make_pair
from palmd.motion.check import check_files, load_trajectory, motion_limits, shaking_notes
from palmd.motion.limits import MotionLimits
from palmd.yamlfile import ConfigError, load_config

ROOT = Path(__file__).parents[3]
PORTS = "pads: {palm1: {port: /dev/a}, palm2: {port: /dev/b}}\narm: {port: /dev/c}\n"
ROCK = """\
name: rock
segments:
  - {move: {phi1_deg: 45, phi2_deg: 90}, duration_s: 2.0}
  - {rate: {phi1_deg_s: 20}, until: {phi1_deg: 75}}
  - {explore: {coverage: 0.95, time_limit_s: 60}}
"""
WRONG = """\
name: wrong
repeat: 2
segments:
  - {explore: {coverage: 0.95, time_limit_s: 60}}
  - {hold_s: 1}
dither: {amplitude_deg: 0.1, frequency_hz: 10}
"""


def write(folder: Path, **files: str) -> list[Path]:
    paths = [folder / f"{name}.yaml" for name in files]
    for path, text in zip(paths, files.values(), strict=True):
        path.write_text(text)
    return paths


def test_every_shipped_file_is_valid() -> None:
    configs = sorted((ROOT / "config").glob("*.yaml"))
    plans = sorted((ROOT / "config/plans").glob("*.yaml"))
    assert len(configs) >= 2
    assert len(plans) >= 3
    for config in configs:
        text = config.read_text()
        own = "curvature" in text or "system:" in text  # has its own limits and plans
        assert check_files([config] if own else [config, *plans]) == []
    assert check_files(plans) == []
    assert check_files(configs) == []  # like `palmd check config/*.yaml`: each plan within its configuration's limits


def test_a_plan_named_by_a_configuration_is_checked_within_that_ones_limits(tmp_path: Path) -> None:
    wide, tight, _ = write(
        tmp_path,
        wide=PORTS + "plan: rock.yaml\n",
        tight=PORTS + "limits: {phi1_deg: [6, 70]}\nplan: other.yaml\n",
        rock=ROCK,
    )
    (tmp_path / "other.yaml").write_text(ROCK.replace("75", "65"))
    assert check_files([wide, tight]) == check_files([tight, wide]) == []


def test_a_plans_limits_are_those_of_the_given_configuration_or_the_defaults(tmp_path: Path) -> None:
    config, plan = write(tmp_path, palmd=PORTS + "limits: {phi1_deg: [6, 70]}\n", rock=ROCK)
    assert check_files([plan]) == []
    expected = [f"{plan}:4:5: segments.1: phi1 reaches 75°, the limit is 70°"]
    assert check_files([plan, config]) == expected
    assert check_files([config, plan]) == expected


def test_errors_of_all_files_are_reported_together(tmp_path: Path) -> None:
    broken = PORTS + "limits: {phi1_deg: [6, 70]}\nloop: {rate_hz: fast}\n"
    config, plan, other = write(tmp_path, palmd=broken, rock=ROCK, other="name: x\nsegments: []\n")
    errors = check_files([config, plan, other, tmp_path / "none.yaml"])
    assert errors == [
        f"{tmp_path / 'none.yaml'}:1:1: no such file",
        f"{config}:4:17: loop.rate_hz: must be a number; got the text fast",
        f"{plan}:4:5: segments.1: phi1 reaches 75°, the limit is 70°",
        f"{other}:2:11: segments: must have at least 1 entries; got 0",
    ]


def test_with_invalid_limits_only_the_plans_form_is_checked(tmp_path: Path) -> None:
    config, plan = write(tmp_path, palmd=PORTS + "limits: {phi1_deg: [70, 6]}\n", rock=ROCK)
    assert [error.split(":")[0] for error in check_files([config, plan])] == [str(config)]


def test_a_plan_named_by_a_configuration_is_checked_once(tmp_path: Path) -> None:
    config, plan = write(tmp_path, palmd=PORTS + "limits: {phi1_deg: [6, 70]}\nplan: rock.yaml\n", rock=ROCK)
    assert len(check_files([config])) == 1
    assert len(check_files([config, plan])) == 1


def test_a_missing_plan_is_reported_where_it_is_named(tmp_path: Path) -> None:
    config, plan = write(tmp_path, palmd=PORTS + "plan: rok.yaml\n", rock=ROCK)
    expected = f"{config}:3:7: plan: {tmp_path / 'rok.yaml'} does not exist"
    assert check_files([config]) == [f"{expected}; did you mean {plan}?"]
    plan.unlink()
    assert check_files([config]) == [expected]
    config.write_text(PORTS + "plan: nowhere/rock.yaml\n")
    assert check_files([config]) == [f"{config}:3:7: plan: {tmp_path / 'nowhere/rock.yaml'} does not exist"]


def test_faults_of_the_key_folder_and_the_run_folder_are_found(tmp_path: Path) -> None:
    more = "bus: {keys: keys}\nrecord: {directory: palmd.yaml/runs}\n"
    (config,) = write(tmp_path, palmd=PORTS + more)
    assert check_files([config]) == [
        f"{config}:3:13: bus.keys: {tmp_path}/keys/server.key_secret: no such file; palmd keys new makes one",
        f"{config}:4:21: record.directory: {config} is no folder: nothing could be recorded",
    ]
    make_pair(tmp_path / "keys", "server")
    config.write_text(PORTS + "bus: {keys: keys}\n")
    assert check_files([config]) == []


def test_keys_that_only_the_service_may_read_are_no_error() -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        (config,) = write(folder, palmd=PORTS + "bus: {keys: keys}\n")
        make_pair(folder / "keys", "server")
        with shut(folder / "keys"):
            assert check_files([config]) == []


def test_invalid_uses_of_an_exploration_are_reported_with_their_place(tmp_path: Path) -> None:
    (plan,) = write(tmp_path, rock=ROCK)
    limits = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
    assert load_trajectory(plan, limits).labels == ("move", "rate", "explore")
    (wrong,) = write(tmp_path, wrong=WRONG)
    with pytest.raises(ConfigError) as caught:
        load_trajectory(wrong, limits)
    expected = [f"{wrong}:2:9: repeat: ", f"{wrong}:4:5: segments.0: ", f"{wrong}:6:9: dither: "]
    for line, start in zip(caught.value.errors, expected, strict=True):
        assert line.startswith(start)
    assert check_files([wrong]) == caught.value.errors
    shipped = load_trajectory(ROOT / "config/plans/lively.yaml", motion_limits(load_config(ROOT / "config/demo.yaml")))
    assert shipped.name == "lively"


def test_a_plan_that_explores_needs_an_observer_with_an_outline(tmp_path: Path) -> None:
    config, plan = write(tmp_path, palmd=PORTS + "observer: {primary: extended}\nplan: rock.yaml\n", rock=ROCK)
    (error,) = check_files([config])
    assert error.startswith(f"{config}:3:21: observer.primary: ")
    assert str(plan) in error
    config.write_text(PORTS + "observer: {primary: shape}\nplan: rock.yaml\n")
    assert check_files([config]) == []


def test_a_plan_in_an_unreadable_folder_is_reported() -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "plans").mkdir()
        (config,) = write(folder, palmd=PORTS + "plan: plans/rock.yaml\n")
        expected = f"{folder}/plans/rock.yaml:1:1: cannot be read: Permission denied"
        with shut(folder / "plans"):
            assert check_files([config]) == [expected]
            with pytest.raises(ConfigError, match=expected):
                read_plan(folder / "plans/rock.yaml", motion_limits(load_config(config)), None)


def test_notes_on_vibration_and_dither(tmp_path: Path) -> None:
    """A vibration and its strength, one that is too slow, and a plan's dither."""
    text = shipped("palmd.yaml").read_text(encoding="utf-8")
    plan = tmp_path / "dither.yaml"
    plan.write_text("name: d\nsegments:\n  - hold_s: 5\ndither: {amplitude_deg: 0.1, frequency_hz: 10}\n", "utf-8")

    def notes(vibration: str) -> list[str]:
        path = tmp_path / "rig.yaml"
        kept = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("plan:"))
        path.write_text(kept.replace("rig:\n", f"rig:\n  vibration: {vibration}\n", 1), "utf-8")
        assert check_files([path, plan]) == []
        return [note.partition(": ")[2] for note in shaking_notes([path, plan])]

    assert [note for note in notes("{relation: independent}") if "rig.vibration:" in note] == []
    (note_text, *_) = notes("{relation: independent, frequency_hz: 250, speed_m_s: 0.015}")
    assert "averaged" in note_text
    (note_text, *_) = notes("{relation: independent, frequency_hz: 250, speed_m_s: 0.006}")
    assert "weak" in note_text
    assert "0.21" in note_text
    (note_text, *_) = notes("{relation: independent, frequency_hz: 30}")
    assert "50 Hz" in note_text
    dry = notes("{relation: none}")
    assert "dry" in dry[0]
    assert [note for note in dry if note.startswith("dither")] == [dry[1]]
    assert "0.0081" in dry[1]
    assert len([note for note in notes("{relation: independent}") if note.startswith("dither")]) == 2
