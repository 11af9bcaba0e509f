"""The table of systems: its parts exist, and a rig of another system loads none of them."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import asdict, replace
from typing import ClassVar, Literal

import pytest

from palmd.cli import build
from palmd.config.pivot import PivotConfig, PivotRigConfig
from palmd.console.shipped import shipped
from palmd.daemon.core import Core
from palmd.daemon.planner import read_plan
from palmd.daemon.systems import live_system
from palmd.motion import pivot
from palmd.motion.check import check_files
from palmd.motion.pivot import PivotLimits
from palmd.pivot_quantities import PIVOT, PIVOT_MOTION
from palmd.quantities import STATE
from palmd.record.metadata import preface
from palmd.system import mechanism, three_palms
from palmd.system import pivot as pivoting
from palmd.system.naming import PAD_NUMBERS
from palmd.systems import LIVE, SYSTEMS, load_part
from palmd.topics import SYSTEM_TOPICS
from palmd.yamlfile import ConfigError, load_any_config, load_config
from tools.closed_loop import AtOnce, ClosedLoop

PARTS = [
    pytest.param(part, id=f"{name}-{field}")
    for name, live in LIVE.items()
    for field, part in asdict(live).items()
    if ":" in part
] + [pytest.param(system.log, id=f"{system.name}-log") for system in SYSTEMS.values()]

LOADED = """
import sys
from palmd.console.shipped import shipped
from palmd.daemon.systems import live_system
from palmd.daemon import app
from palmd.rig import app
from palmd.cli import build, demo
from palmd.motion import check
from palmd.record import metadata, recheck, run
from palmd.yamlfile import load_any_config
config = load_any_config(shipped(sys.argv[1]))
live_system(config).info("", [])
build.needed_by(config)
metadata.preface(config, "")
check.check_files([shipped(sys.argv[1])])
print(*sorted(name for name in sys.modules if name.startswith("palmd.")))
"""


@pytest.mark.parametrize("part", PARTS)
def test_every_part_of_the_table_exists(part):
    assert load_part(part) is not None


def test_a_configuration_selects_its_row():
    assert {name: load_part(live.config).system for name, live in LIVE.items()} == {name: name for name in LIVE}


def test_a_rig_of_two_palms_loads_nothing_of_another_system():
    done = subprocess.run([sys.executable, "-c", LOADED, "demo.yaml"], capture_output=True, text=True, check=True)
    names = "pivot", "three_palms", "dragging", "drags"
    loaded = {name for name in done.stdout.split() if any(each in name for each in names)}
    assert loaded == {
        "palmd.system.pivot",
        "palmd.pivot_quantities",
        "palmd.system.three_palms",
        "palmd.three_palms_quantities",
    }  # names of axes and topics


class TwinRig(PivotRigConfig):
    system: Literal["twin"]


class TwinConfig(PivotConfig):
    system: ClassVar[str] = "twin"
    rig: TwinRig


class TwinLimits(PivotLimits):
    system: ClassVar[str] = "twin"


PLANS = replace(pivot.PLANS, configured=TwinLimits.of, over=TwinLimits.over)


@pytest.fixture
def twin(monkeypatch, tmp_path):
    """The configuration of a system that exists only in the table: it moves as a pivoting grasp."""
    parts = replace(LIVE["pivot"], config=f"{__name__}:TwinConfig", plans=f"{__name__}:PLANS")
    monkeypatch.setitem(LIVE, "twin", parts)
    monkeypatch.setitem(SYSTEMS, "twin", replace(SYSTEMS["pivot"], name="twin", words="a twin", live=parts))
    monkeypatch.setitem(SYSTEM_TOPICS, "twin", SYSTEM_TOPICS["pivot"])
    path, text = tmp_path / "twin.yaml", shipped("pivot.yaml").read_text(encoding="utf-8")
    plan = shipped("plans") / "pivot/explore.yaml"
    path.write_text(text.replace("system: pivot", "system: twin").replace("plans/pivot/explore.yaml", str(plan)))
    return path


def test_a_row_is_sufficient_to_check_and_run_another_system(twin):
    assert check_files([twin]) == []
    config = load_any_config(twin)
    assert type(config) is TwinConfig
    with pytest.raises(ConfigError, match="is for a twin, but this supports two palms on a hinge only"):
        load_config(twin)
    system = live_system(config)
    plan = read_plan(config.plan, system.limits, None)
    assert plan.explores
    with ExitStack() as stack:
        estimator, _ = system.observer((), stack)
        world = load_part(LIVE["twin"].rig)(config, 3)
        loop = ClosedLoop(world, Core(config, estimator, AtOnce(), plan, system=system), config.loop.rate_hz)
        loop.start()
        topics = {topic for instant in loop.run(0.5) for topic in instant.messages}
    assert {topic.name for topic in (PIVOT, PIVOT_MOTION, STATE)} <= topics
    assert [what for what, _ in build.needed_by(config)] == ["pivoting grasp"]
    assert json.loads(preface(config, "").attachments["rig.json"])["gravity"] == config.rig.gravity_m_s2


def test_a_gauge_for_two_palms_is_refused_by_another_rig():
    command = [sys.executable, "-m", "palmd", "rig", str(shipped("pivot.yaml")), "--marble", "1"]
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "need two palms; this is a pivoting grasp" in refused.stderr


def test_every_systems_pads_have_faults_and_counters() -> None:
    for module in (mechanism, pivoting, three_palms):
        assert set(module.NAMING.pads) <= set(PAD_NUMBERS)
