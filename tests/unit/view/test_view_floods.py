"""The live page's server under a flood: counts of accepted and rejected messages, independent of the clock."""

import asyncio
import contextlib
import json
import socket
from types import SimpleNamespace

import pytest
from served import PATIENCE_S, answer, answers, until_commandable

from palmd.view import daemon_link
from palmd.view import server as module


def knock(port):
    one = socket.socket()
    one.settimeout(PATIENCE_S)
    one.connect(("127.0.0.1", port))
    return one


def next_error(page):
    """The error of the next command that is answered."""
    return next(answers(page))["error"]


def is_shut(one):
    try:
        return one.recv(1) == b""
    except ConnectionResetError:
        return True


def test_unauthenticated_connections_keep_nobody_out(served):
    """Ten times as many as may wait: the oldest are closed, and a page that comes last is served."""
    with contextlib.ExitStack() as stack:
        strangers = [stack.enter_context(knock(served.port)) for _ in range(10 * module.MAX_PENDING)]
        with served.page() as (_, hello):
            assert hello["operator"]
        assert all(map(is_shut, strangers[: 9 * module.MAX_PENDING]))


def test_an_authenticated_page_is_not_counted_among_them(served):
    with served.page() as (page, _), contextlib.ExitStack() as stack:
        for _ in range(3 * module.MAX_PENDING):
            stack.enter_context(knock(served.port))
        assert answer(page, "hold")


def test_a_pages_flood_of_commands_is_not_queued_and_delays_no_stop(daemon, served, monkeypatch):
    monkeypatch.setattr(daemon_link, "TIMEOUT_S", 1e3)  # no timeout for slow machines
    daemon.take_commands()
    with served.page() as (flooding, _), served.page() as (other, _):
        until_commandable(flooding)
        for number in range(500):
            flooding.send(json.dumps({"id": number, "cmd": "start"}))
        for number in range(3):
            flooding.send(json.dumps({"id": 1000 + number, "cmd": "stop"}))
        said = [next_error(flooding) for _ in range(3)]
        assert all("too many at once" in each for each in said)
        other.send(json.dumps({"id": 1, "cmd": "stop"}))
        came = []
        while len(came) < module.MAX_ORDERS + 2:
            came.append(daemon.asked())
        assert [asked["cmd"] for _, asked in came] == ["start"] * module.MAX_ORDERS + ["stop", "stop"]
        assert daemon.asked(0.3) is None
        for route, asked in came[-2:]:  # in either order
            daemon.reply(route, id=asked["id"], ok=True)
        assert next_error(other) is None


def test_an_answer_makes_room_for_the_next_command(daemon, served):
    daemon.take_commands()
    with served.page() as (page, _):
        until_commandable(page)
        for number in range(3 * module.MAX_ORDERS):
            page.send(json.dumps({"id": number, "cmd": "hold"}))
            route, asked = daemon.asked()
            daemon.reply(route, id=asked["id"], ok=True)
            assert next_error(page) is None


def test_a_bounded_number_of_connections_is_accepted_at_once(monkeypatch):
    asked = {}

    def serve(*_, **how):
        asked.update(how)
        raise OSError(1, "enough")

    monkeypatch.setattr(module, "serve", serve)
    settings = SimpleNamespace(port=0, publish="", command="")
    monkeypatch.setattr(module, "page_files", dict)
    with pytest.raises(OSError, match="enough"):
        asyncio.run(module._Server(settings, None, None, None).run(print, asyncio.Event()))
    assert asked["backlog"] == module.ACCEPTED_AT_ONCE
