"""The content of a wheel: the package and its data, no study, tool or test."""

import zipfile
from pathlib import Path

import pytest

builders = pytest.importorskip("hatchling.builders.wheel", reason="nothing here builds a wheel")
ROOT = Path(__file__).parents[2]


def test_a_wheel_has_the_package_and_no_program_of_the_checkout(tmp_path):
    (wheel,) = builders.WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {"palmd/cli/table.py", "palmd/data/demo.yaml", "palmd/report/player.js"} <= names
    assert {name.split("/")[0].split("-")[0] for name in names} == {"palmd"}
    assert not [name for name in names if {"studies", "tools", "tests", "lab"} & set(name.split("/"))]
