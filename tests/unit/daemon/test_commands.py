"""The command parser."""

import math

import msgpack
import pytest

from palmd.daemon.commands import CommandError, Reply, Request, parse


def packed(**message) -> bytes:
    return msgpack.packb(message)


def test_arguments_are_passed_on():
    assert parse(packed(id="a", cmd="plan", args={"path": "p.yaml"})).args == {"path": "p.yaml"}
    assert parse(packed(id="a", cmd="jog", args={"phi1_deg": -0.25})).args == {"phi1_deg": -0.25}
    assert parse(packed(id=1, cmd="arm", args=None)).args == {}
    arguments = {"bytes": 100, "messages": 3, "lost": 0, "path": "a.mcap"}
    assert parse(packed(id=1, cmd="recorder", args=arguments)).args == arguments


@pytest.mark.parametrize(
    ("payload", "id", "complaint"),
    [
        (b"", None, "not a msgpack map"),
        (b"\xc1", None, "not a msgpack map"),
        (b"arm", None, "not a msgpack map"),
        (b"\x07", None, "expected a map"),
        (msgpack.packb([1, "arm"]), None, "a list"),
        (msgpack.packb({1: 2}), None, "not a msgpack map"),
        (packed(id=3), 3, "unknown command None"),
        (packed(id=3, cmd="fly"), 3, "unknown command 'fly'; the commands are status, arm"),
        (packed(id=3, cmd=["arm"]), 3, "unknown command a list"),
        (packed(id=3, cmd="arm", force=True), 3, "unknown key 'force'"),
        (packed(id=3, cmd="arm", **{"from": 5}), 3, "from must be printable text"),
        (packed(id=3, cmd="arm", **{"from": "ann\n12:00 stop, by bob"}), 3, "from must be printable text"),
        (packed(id=3, cmd="arm", **{"from": "x" * 101}), 3, "100 characters at most"),
        (packed(id=3, cmd="arm", args=[1]), 3, "args must be a map"),
        (packed(id=3, cmd="arm", args={"now": 1}), 3, "unknown argument 'now'; the arguments are take"),
        (packed(id=3, cmd="jog", args={"phi1_deg": "1"}), 3, "phi1_deg must be a finite number, got '1'"),
        (packed(id=3, cmd="jog", args={"phi1_deg": True}), 3, "finite number"),
        (packed(id=3, cmd="jog", args={"phi2_deg": math.nan}), 3, "finite number"),
        (packed(id=3, cmd="jog", args={"phi2_deg": 0.6}), 3, "must be -0.5 to 0.5, got 0.6"),
        (packed(id=3, cmd="plan"), 3, "path is missing"),
        (packed(id=3, cmd="plan", args={"path": ""}), 3, "must be text"),
        (packed(id=3, cmd="plan", args={"path": "a\0b"}), 3, "must be text"),
        (packed(id=[1], cmd="fly"), None, "unknown command"),
        (packed(id="x" * 300, cmd="fly"), None, "unknown command"),
        (b"\x81\xa2id" * 40_000, None, "bytes at most"),
        (b"\x91" * 60_000, None, "not a msgpack map"),
    ],
)
def test_malformed_requests_are_refused(payload, id, complaint):
    with pytest.raises(CommandError, match=complaint.replace("(", r"\(")) as caught:
        parse(payload)
    assert caught.value.id == id
    assert len(str(caught.value)) < 300


def test_a_client_is_named_by_what_it_sends():
    assert parse(packed(id=3, cmd="arm", **{"from": "palmd ctl of ann"})).who == "palmd ctl of ann"
    assert parse(packed(id=3, cmd="arm")).who == ""


def test_a_reply_has_only_the_needed_fields():
    request = Request("arm", id=5)
    assert Reply(request, None, {"state": "tracking"}).fields() == {
        "id": 5,
        "ok": True,
        "result": {"state": "tracking"},
    }
    assert Reply(request, "arm refused: no").fields() == {"id": 5, "ok": False, "error": "arm refused: no"}
