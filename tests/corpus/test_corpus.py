"""The stored cases give what they gave when they were frozen; a difference is found and named."""

from __future__ import annotations

import copy

import pytest

from corpus import EXPECTED, SAMPLE, check, compare, frozen, names


def test_every_case_is_frozen() -> None:
    assert names() == sorted(path.stem for path in EXPECTED.iterdir())


@pytest.mark.parametrize("part", ["estimate", "reconstruct"])
def test_a_changed_number_is_found_and_named(part: str) -> None:
    was = frozen(names()[0])
    now = copy.deepcopy(was)
    now[part]["digest"] = "another"
    place = now["estimate"]["kept"][-1] if part == "estimate" else now["reconstruct"]["result"]
    key = "phi1_rad" if part == "estimate" else "chi2"
    place[key] *= 1 + 1e-7
    assert [line.split(":")[0].rpartition(".")[2] for line in compare(was, now, exact=True)] == [key]
    place[key] /= 1 + 1e-7
    assert not compare(was, now, exact=True)


def test_the_sample_has_each_system() -> None:
    assert {name.split("-")[0] for name in SAMPLE} == {name.split("-")[0] for name in names()}


@pytest.mark.parametrize("name", SAMPLE)
def test_a_case_gives_what_was_frozen(name: str) -> None:
    assert check([name], sample=False) == 0
