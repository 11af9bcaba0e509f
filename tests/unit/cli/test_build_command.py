"""`palmd doctor build CONFIG`: it compiles what a configuration needs, and no more."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from palmd.cli import build, main
from palmd.console.errors import CliError
from palmd.console.shipped import shipped
from palmd.model import compiled, compiler
from palmd.yamlfile import load_config


def _names(config: Path) -> list[str]:
    return [what for what, _ in build.needed_by(load_config(config))]


def test_a_cradle_needs_its_own_kernels_and_flat_palms_need_none_of_them() -> None:
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


def test_it_compiles_exactly_these_and_reports_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(build, "needed_by", lambda _: [("curved palms, smoother", lambda: "c")])
    assert main(["doctor", "build", str(shipped("cradle.yaml"))]) == 0
    assert re.fullmatch(r"curved palms, smoother: compiled C, \d+\.\d s\n", capsys.readouterr().out)


def test_a_demo_compiles_everything_before_it_starts_and_prints_nothing_if_that_is_quick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def make(name: str) -> str:
        (tmp_path / name).touch()
        return "c"

    parts = [("one", lambda: make("one")), ("two", lambda: make("two"))]
    monkeypatch.setattr(build, "needed_by", lambda _: parts)
    notices: list[str] = []
    build.prepare_kernels(load_config(shipped("cradle.yaml")), notices.append)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["one", "two"]
    assert not notices


def test_a_slow_compilation_is_reported_once_and_does_not_block_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def after_all_others() -> str:
        while {"notices", "short", "shorter"} - {each.name for each in tmp_path.iterdir()}:
            time.sleep(0.01)
        return "c"

    def short(name: str) -> str:
        (tmp_path / name).touch()
        return "c"

    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(build, "_PATIENCE_S", 0.01)
    notices: list[str] = []

    def lasts() -> None:
        notices.append("patience")
        (tmp_path / "notices").touch()

    parts = [("long", after_all_others), ("short", lambda: short("short")), ("shorter", lambda: short("shorter"))]
    assert {what for what, *_ in build.compile_parallel(parts, lasts)} == {"long", "short", "shorter"}
    assert notices == ["patience"]


def test_a_compilation_that_fails_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def differs() -> str:
        raise RuntimeError("compiled f differs")

    with pytest.raises(RuntimeError, match="compiled f differs"):
        list(build.compile_parallel([("f", differs)]))
    with pytest.raises(CliError, match="f: its compiler was killed, most often for lack of memory"):
        list(build.compile_parallel([("f", lambda: str(os.kill(os.getpid(), signal.SIGKILL)))]))


def test_a_cause_that_stops_every_compilation_is_logged_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv(compiler.FAULT, "of another")
    monkeypatch.setenv("CC", "/nowhere/cc")
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path))
    source = tmp_path / "one.c"
    source.write_text("int one(void) { return 1; }")

    def part(name: str) -> tuple[str, Callable[[], str]]:
        return name, lambda: "python" if compiled.load_written(name, source) is None else "c"

    made = list(build.compile_parallel([part(name) for name in "abc"]))
    assert sorted((what, backend) for what, backend, _ in made) == [(name, "python") for name in "abc"]
    assert caplog.text.count("/nowhere/cc: No such file or directory") == 1
    assert compiler.known_fault(tmp_path), "so that processes started later do not log it again"
