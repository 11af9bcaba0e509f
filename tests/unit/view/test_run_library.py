"""The page's runs and configuration: who may read them, what is sent, and that no name leads to other files."""

import contextlib
import json
import os
import time

import pytest
from served import Served, answers

CONFIG = """pads: {palm1: {port: /dev/a, zero_mm: 280}, palm2: {port: /dev/b}}
arm: {port: /dev/c}
# password: sesame
"""


@pytest.fixture
def library(daemon, tmp_path):
    """A server with a folder of runs and a configuration; (server, runs, config)."""
    runs, config = tmp_path / "runs", tmp_path / "palmd.yaml"
    runs.mkdir()
    for name in ("old.mcap", "new.mcap"):
        (runs / name).write_bytes(b"no recording")
        os.utime(runs / name, (1e9, 1e9))
    (runs / "old.note").write_text("a note", encoding="utf-8")
    (tmp_path / "secret.mcap").write_bytes(b"elsewhere")
    config.write_text(CONFIG, encoding="utf-8")
    with contextlib.closing(Served(daemon, runs=runs, config=config)) as server:
        yield server, runs, config


def asks(page, command, **args):
    page.send(json.dumps({"id": 3, "cmd": command, "args": args}))
    answer = next(answers(page))
    return answer["error"], answer.get("result")


def test_an_operator_lists_downloads_and_deletes_runs(library):
    server, runs, _ = library
    with server.page() as (page, hello):
        error, result = asks(page, "runs")
        assert error is None
        assert [run["run"] for run in result["runs"]] == ["old.mcap", "new.mcap"]
        path = f"/files/{hello['library']}/old.mcap"
        status, headers, body = server.get(path)
        assert (status, body) == (200, b"no recording")
        assert "sandbox" in headers["Content-Security-Policy"]
        assert asks(page, "delete", run="old.mcap")[0] is None
        assert sorted(each.name for each in runs.glob("[on]*")) == ["new.mcap"]
        assert server.get(path)[0] == 404


@pytest.mark.parametrize("name", ["../secret.mcap", "secret.mcap", "", ".palmd-runs.json", "old.note", "a/b.mcap"])
def test_no_other_file_can_be_named(library, name):
    server, runs, _ = library
    with server.page() as (page, hello):
        for command in ("delete", "report"):
            assert "there is no run" in asks(page, command, run=name)[0]
        assert server.get(f"/files/{hello['library']}/{name}")[0] == 404
    assert (runs / "old.note").exists()
    assert (runs.parent / "secret.mcap").exists()


def test_without_the_token_there_are_no_files(library):
    server, _, _ = library
    with server.page(token="guessed") as (page, hello):
        assert hello["library"] == ""
        for command in ("runs", "report", "delete", "configuration"):
            assert "read-only" in asks(page, command, run="old.mcap")[0]
    for key in ("", "x", "../files"):
        assert server.get(f"/files/{key}/old.mcap")[0] == 404


def test_a_recording_in_progress_is_not_deleted(library):
    server, runs, _ = library
    os.utime(runs / "new.mcap", (time.time(), time.time()))
    with server.page() as (page, _):
        assert "is being recorded" in asks(page, "delete", run="new.mcap")[0]
    assert (runs / "new.mcap").exists()


def test_a_failed_report_gives_its_reason(library):
    server, _, _ = library
    with server.page() as (page, _):
        error, _ = asks(page, "report", run="old.mcap")
    assert error.startswith("palmd report: ")
    assert "old.mcap" in error


def test_the_configuration_is_shown_with_checks_and_without_secrets(library):
    server, _, config = library
    with server.page() as (page, _):
        error, result = asks(page, "configuration")
    assert error is None
    assert result["path"] == str(config)
    assert "zero_mm: 280" in result["text"]
    assert "sesame" not in result["text"]
    assert any("zero_mm" in finding["text"] and finding["line"] == 1 for finding in result["findings"])


def test_files_are_sent_compressed_if_the_client_accepts_that(library):
    server, _, _ = library
    status, headers, body = server.get("/page.css", **{"Accept-Encoding": "gzip, br"})
    assert (status, headers["Content-Encoding"]) == (200, "gzip")
    assert len(body) < 10_000
