"""The live page's server under a flood: by what it takes on and lets go, not by the clock."""

import asyncio
import contextlib
import json
import socket
from types import SimpleNamespace

import pytest
from served import PATIENCE_S, answer, answers, until_commandable

from palmd.view import command_client
from palmd.view import server as module


def knock(port):
    one = socket.socket()
    one.settimeout(PATIENCE_S)
    one.connect(("127.0.0.1", port))
    return one


def told(page):
    """What is wrong with the next order that is answered."""
    return next(answers(page))["error"]


def is_shut(one):
    try:
        return one.recv(1) == b""
    except ConnectionResetError:
        return True


def test_strangers_keep_nobody_out(served):
    """Ten times as many as may wait: the oldest have to go, a page that comes last is served."""
    with contextlib.ExitStack() as stack:
        strangers = [stack.enter_context(knock(served.port)) for _ in range(10 * module.MAX_PENDING)]
        with served.page() as (_, hello):
            assert hello["operator"]
        assert all(map(is_shut, strangers[: 9 * module.MAX_PENDING]))


def test_a_page_is_no_stranger_any_more(served):
    with served.page() as (page, _), contextlib.ExitStack() as stack:
        for _ in range(3 * module.MAX_PENDING):
            stack.enter_context(knock(served.port))
        assert answer(page, "hold")


def test_a_pages_flood_of_orders_waits_in_no_queue_and_holds_up_no_stop(daemon, served, monkeypatch):
    monkeypatch.setattr(command_client, "TIMEOUT_S", 1e3)  # of whoever is slow
    daemon.take_commands()
    with served.page() as (flooding, _), served.page() as (other, _):
        until_commandable(flooding)
        for number in range(500):
            flooding.send(json.dumps({"id": number, "cmd": "start"}))
        for number in range(3):
            flooding.send(json.dumps({"id": 1000 + number, "cmd": "stop"}))
        said = [told(flooding) for _ in range(3)]
        assert all("too many at once" in each for each in said)
        other.send(json.dumps({"id": 1, "cmd": "stop"}))
        came = []
        while len(came) < module.MAX_ORDERS + 2:
            came.append(daemon.asked())
        assert [asked["cmd"] for _, asked in came] == ["start"] * module.MAX_ORDERS + ["stop", "stop"]
        assert daemon.asked(0.3) is None
        for route, asked in came[-2:]:  # whichever page's came first
            daemon.reply(route, id=asked["id"], ok=True)
        assert told(other) is None


def test_an_answer_makes_room_for_the_next_order(daemon, served):
    daemon.take_commands()
    with served.page() as (page, _):
        until_commandable(page)
        for number in range(3 * module.MAX_ORDERS):
            page.send(json.dumps({"id": number, "cmd": "hold"}))
            route, asked = daemon.asked()
            daemon.reply(route, id=asked["id"], ok=True)
            assert told(page) is None


def test_no_more_are_let_in_at_once_than_leave_time_for_the_frames(monkeypatch):
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
