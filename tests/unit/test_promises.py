"""Compatibility promises of a release: the stored copy against the code, and the comparison itself."""

from __future__ import annotations

import copy
import json

import pytest

from tools.promises import STORED, broken, promised


@pytest.fixture(scope="module")
def now() -> dict[str, object]:
    return json.loads(json.dumps(promised()))


def test_every_promised_name_exists_and_is_stored(now) -> None:
    stored = json.loads(STORED.read_text(encoding="utf-8"))
    assert list(broken(stored, now)) == []
    assert list(broken(now, stored)) == [], "new fields, options or keys: python -m tools.promises --write"


@pytest.mark.parametrize(
    ("path", "line"),
    [
        (("topics", "palm/estimate", "psi_rad"), "topics: palm/estimate: psi_rad is missing"),
        (("commands", "export"), "commands: export is missing"),
        (("requests", "jog"), "requests: jog is missing"),
    ],
)
def test_removed_names_are_reported(now, path, line) -> None:
    less = copy.deepcopy(now)
    inner = less
    for name in path[:-1]:
        inner = inner[name]
    del inner[path[-1]]
    assert list(broken(now, less)) == [line]


def test_a_changed_unit_and_a_removed_option_are_reported(now) -> None:
    other = copy.deepcopy(now)
    other["topics"]["palm/estimate"]["psi_rad"] = ["number", "deg"]
    other["commands"]["export"].remove("--as")
    assert list(broken(now, other)) == [
        "topics: palm/estimate: psi_rad: was ['number', 'rad'], is ['number', 'deg']",
        "commands: export: --as is missing",
    ]


def test_additions_break_nothing(now) -> None:
    more = copy.deepcopy(now)
    more["topics"]["palm/estimate"]["new_m"] = ["number", "m"]
    assert list(broken(now, more)) == []
