"""The table of systems: its parts are there, and none is loaded by a rig of another system."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import asdict

import pytest

from palmd.systems import LIVE, SYSTEMS, load_part

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
def test_every_part_of_the_table_is_there(part):
    assert load_part(part) is not None


def test_a_configuration_says_which_row_is_its_own():
    assert {name: load_part(live.config).system for name, live in LIVE.items()} == {name: name for name in LIVE}


def test_a_rig_of_two_palms_loads_nothing_of_another_system():
    told = subprocess.run([sys.executable, "-c", LOADED, "demo.yaml"], capture_output=True, text=True, check=True)
    names = "pivot", "three_palms", "dragging", "drags"
    loaded = {name for name in told.stdout.split() if any(each in name for each in names)}
    assert loaded == {"palmd.system.pivot"}  # what its axes and topics are called
