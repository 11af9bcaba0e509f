"""`palmd build CONFIG`: what a configuration needs, and no more."""

from __future__ import annotations

from pathlib import Path

import pytest

from palmd.cli import build, main
from palmd.console.shipped import shipped
from palmd.yamlfile import load_config


def _names(config: Path) -> list[str]:
    return [what for what, _ in build.needed_by(load_config(config))]


def test_a_cradle_needs_all_of_its_own_kernels_and_flat_palms_none_of_them() -> None:
    cradle, flat = _names(shipped("cradle.yaml")), _names(shipped("palmd.yaml"))
    assert flat == [
        "shape observer", "shape observer with a smoother's harmonics", "observability", "smoother", "explorer",
    ]  # fmt: skip
    assert cradle == [*(f"curved palms, {what}" for what in flat), "smoother's equations"]


def test_another_observer_needs_neither_smoother_nor_explorer(tmp_path: Path) -> None:
    config = tmp_path / "palmd.yaml"
    text = shipped("palmd.yaml").read_text(encoding="utf-8")
    assert "primary: shape" in text
    config.write_text(text.replace("primary: shape", "primary: extended"), encoding="utf-8")
    assert _names(config) == ["extended observer"]


def test_it_makes_just_these_and_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(build, "needed_by", lambda _: [("curved palms, smoother", lambda: "c")])
    assert main(["build", str(shipped("cradle.yaml"))]) == 0
    assert capsys.readouterr().out == "curved palms, smoother: compiled C, 0.0 s\n"


def test_a_configuration_that_is_not_there_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build", "nowhere.yaml"]) == 1
    assert "no such file" in capsys.readouterr().err


def test_a_demo_has_everything_made_before_it_starts_and_is_silent_when_that_is_quick(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[str] = []
    parts = [("one", lambda: made.append("one") or "c"), ("two", lambda: made.append("two") or "c")]  # type: ignore[func-returns-value]
    monkeypatch.setattr(build, "needed_by", lambda _: parts)
    told: list[str] = []
    build.made_ready(load_config(shipped("cradle.yaml")), told.append)
    assert made == ["one", "two"]
    assert not told
