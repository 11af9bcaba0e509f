"""The table of systems: its parts are there, and none is loaded by a rig of another system."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from palmd.systems import LIVE, SYSTEMS, load_part

PARTS = [
    pytest.param(part, id=f"{name}-{field}")
    for name, live in LIVE.items()
    for field, part in asdict(live).items()
    if ":" in part
] + [pytest.param(system.log, id=f"{system.name}-log") for system in SYSTEMS.values()]


@pytest.mark.parametrize("part", PARTS)
def test_every_part_of_the_table_is_there(part):
    assert load_part(part) is not None


def test_a_configuration_says_which_row_is_its_own():
    assert {name: load_part(live.config).system for name, live in LIVE.items()} == {name: name for name in LIVE}
