"""The live page's server: access, messages, and commands that never wait for an absent daemon."""

import asyncio
import contextlib
import hashlib
import json
import math
import re
import socket
import threading
import time

import msgpack
import pytest
from served import PATIENCE_S, TOKEN, answer, batches, heard, said, until_commandable
from websockets.exceptions import ConnectionClosed, InvalidStatus

from palmd.cli import main
from palmd.cli.view import allowed
from palmd.daemon.commands import COMMANDS
from palmd.view import daemon_link, http_guard, naming, wire
from palmd.view.client import PageClient
from palmd.view.http_guard import STATIC, page_files, without_comments

# --------------------------------------------------------------------------------------------------- the files


def test_the_page_and_all_its_references_are_served_here(served):
    status, headers, body = served.get("/")
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    names = re.findall(r'(?:src|href)="([^"#]+)"', body.decode())
    assert len(names) >= 4
    for name in names:
        assert served.get(f"/{name}")[0] == 200
    for path in STATIC.glob("*.js"):
        status, headers, body = served.get(f"/{path.name}")
        assert (status, headers["Content-Type"], body) == (
            200,
            "text/javascript; charset=utf-8",
            without_comments(path.read_text(), ".js").encode(),
        )
        for name in re.findall(r'from "\./([^"]+)"', body.decode()):
            assert (STATIC / name).is_file()
        assert "https://" not in body.decode()


def test_the_first_view_is_small_even_uncompressed():
    """The files loaded when the page opens: all but those of a view or a system that is shown later."""
    files = page_files()
    first = {"/", "/quantities.json", "/icon.svg"}
    waiting = set(re.findall(r'(?:src|href)="([^"#]+)"', files["/"].body.decode()))
    while waiting:
        path = f"/{waiting.pop()}"
        if path not in first:
            first.add(path)
            waiting |= set(re.findall(r'from "\./([^"]+)"', files[path].body.decode()))
    assert {"/app.js", "/strips.js", "/vendor/uPlot.iife.min.js"} <= first
    assert not {"/runs.js", "/space.js"} & first
    assert sum(len(files[path].body) for path in first) < 200_000
    assert sum(len(files[path].packed) for path in first) < 80_000


def test_minified_sources_lose_comments_and_indentation_and_no_line():
    source = 'a("//x");\n  /** Says\n   * more. */\n  // why\n\tb(`/** */`); // here\n'
    assert without_comments(source, ".js") == 'a("//x");\n\n\n\nb(`/** */`); // here\n'
    assert without_comments("/* a\nb */\np { color: red; /* c */ }\n", ".css") == "\n\np { color: red;  }\n"


@pytest.mark.parametrize(
    "path",
    ["/../server.py", "/%2e%2e/server.py", "/vendor/../../server.py", "//etc/passwd", "/etc/passwd", "/vendor/",
     "/vendor/README.md", "http://127.0.0.1/", "/..\\server.py"],
)  # fmt: skip
def test_no_path_leads_out_of_the_page(served, path):
    assert served.get(path)[0] == 404


def test_third_party_code_has_the_hash_of_its_note():
    note = (STATIC / "vendor/README.md").read_text()
    for path in (STATIC / "vendor").glob("uPlot.*"):
        assert hashlib.sha256(path.read_bytes()).hexdigest() in note
    assert "Permission is hereby granted" in (STATIC / "vendor/uPlot-LICENSE.txt").read_text()
    assert {"/", "/index.html", "/vendor/uPlot.iife.min.js"} <= page_files().keys()


# ------------------------------------------------------------------------------------------------------ access


@pytest.mark.parametrize(
    "host", ["palmd.example", "palmd.example:8787", "127.0.0.1.palmd.example", "", "10.0.0.1", "["]
)
def test_only_names_of_this_machine_are_served(served, host):
    assert served.get("/", Host=host)[0] == 403
    assert served.get("/", Host=f"localhost:{served.port}")[0] == 200


@pytest.mark.parametrize("origin", ["http://palmd.example", "http://127.0.0.1:1", "null", "https://127.0.0.1"])
def test_another_sites_page_gets_no_socket(served, origin):
    with pytest.raises(InvalidStatus) as refused, served.socket(origin):
        pass
    assert refused.value.response.status_code == 403


def test_a_socket_needs_an_origin(served):
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "A" * 22 + "==",
    }
    assert served.get("/socket", **upgrade)[0] == 403
    assert served.get("/socket", Origin=f"http://127.0.0.1:{served.port}", **upgrade)[0] == 101


@pytest.mark.parametrize(
    "first",
    [
        "",
        "hello",
        "[]",
        "{}",
        '{"token": 1}',
        '{"token": "", "page": "a b"}',
        '{"id": 1, "cmd": "arm"}',
        b"\xff",
        "[" * 4000,
    ],
)
def test_the_first_message_must_be_a_token_or_none(served, first):
    with served.socket() as page:
        page.send(first)
        with pytest.raises(ConnectionClosed) as closed:
            page.recv(PATIENCE_S)
    assert closed.value.rcvd.code == 1008


@pytest.mark.parametrize("token", [None, "", "open sesam", "Open sesame", "ö"])
def test_without_the_token_a_page_is_read_only(daemon, served, token):
    daemon.take_commands()
    with served.page(token) as (page, hello):
        assert hello["operator"] is False
        until_commandable(page)
        assert "read-only" in answer(page, "stop")
    assert daemon.asked(0.2) is None


def test_a_token_that_is_no_text_is_rejected():
    assert not http_guard.may_operate((wire.token_in('{"token": "\\ud800"}') or ("",))[0], TOKEN)


# ----------------------------------------------------------------------------------------------------- commands


def test_a_command_reaches_the_daemon_and_its_answer_the_page(daemon, served):
    daemon.take_commands()
    with served.page() as (page, hello):
        assert (hello["operator"], hello["command"], hello["allowed"]) == (True, daemon.command, allowed())
        until_commandable(page)
        for reply, error in (({"ok": True}, None), ({"ok": False, "error": "arm first"}, "arm first")):
            page.send(json.dumps({"id": 1, "cmd": "jog", "args": {"phi1_deg": 0.4}}))
            route, asked = daemon.asked()
            assert (asked["cmd"], asked["args"]) == ("jog", {"phi1_deg": 0.4})
            daemon.reply(route, id=asked["id"] + 1000, ok=True)  # to another request
            daemon.reply(route, id=asked["id"], **reply)
            answer_text = next(said(page, str, "an answer"))
            assert json.loads(answer_text) == {"answer": {"id": 1, "cmd": "jog", "error": error}}


@pytest.mark.parametrize("command", ["recorder", "status", "", "arm "])
def test_unknown_commands_are_refused(daemon, served, command):
    daemon.take_commands()
    with served.page() as (page, _):
        until_commandable(page)
        assert answer(page, command) == "unknown command"
    assert daemon.asked(0.2) is None


def test_a_command_never_waits_for_an_absent_daemon(daemon, served):
    with served.page() as (page, _):
        for command in allowed():
            assert answer(page, command) == f"no daemon accepts commands at {daemon.command}"
        daemon.take_commands()
        until_commandable(page)
    assert daemon.asked(0.3) is None


def test_a_missing_answer_is_reported_after_a_timeout(daemon, served, monkeypatch):
    monkeypatch.setattr(daemon_link, "TIMEOUT_S", 0.1)
    daemon.take_commands()
    with served.page() as (page, _):
        until_commandable(page)
        assert answer(page, "stop") == f"no answer from {daemon.command} within 0.1 s"
        route, asked = daemon.asked()
        daemon.reply(route, id=asked["id"], ok=True)  # too late: ignored
        page.send(json.dumps({"id": 8, "cmd": "none"}))
        answer_text = next(said(page, str, "an answer"))
        assert json.loads(answer_text)["answer"]["id"] == 8


@pytest.mark.parametrize(
    "rubbish",
    [
        "",
        "x",
        "[]",
        '{"cmd": "stop"}',
        '{"id": true, "cmd": "stop"}',
        '{"id": 1, "cmd": 2}',
        b"\x00",
        '{"id": 1, "cmd": "stop", "args": 1}',
        '{"id": 1, "cmd": "stop", "args": {"a": null}}',
        '{"id": 1, "cmd": "stop", "args": {"a": "\\ud800"}}',
        '{"id": 1, "cmd": "stop", "args": {"\\ud800": 1}}',
        '{"id": 1, "cmd": "stop", "args": {"a": 36893488147419103232}}',
    ],
)
def test_invalid_messages_are_no_commands_and_do_no_harm(daemon, served, rubbish):
    daemon.take_commands()
    with served.page() as (page, _):
        until_commandable(page)
        page.send(rubbish)
        assert answer(page, "none") == "unknown command"
    assert daemon.asked(0.1) is None


def test_the_available_commands_are_those_of_the_daemons_table():
    table = allowed()
    assert table.keys() < COMMANDS.keys()
    assert table["arm"] == ["ready"]
    assert table["reset"] == ["fault"]
    assert set(table["start"]) == set(table["hold"]) == {"tracking", "hold"}
    assert {command for command, states in table.items() if "idle" in states} == {"note", "alive"}


# ------------------------------------------------------------------------------------------------------ batches


def speak_until_heard(daemon, page):
    """Repeats until the subscription is established: a publisher's first messages are lost."""
    page.socket.settimeout(PATIENCE_S)
    found = []
    stop = threading.Event()

    def speak():
        while not stop.wait(0.01):
            daemon.say("palm/info", {"version": "0"})

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        found = heard(page, "palm/info")
    finally:
        stop.set()
        thread.join()
    return found


def test_messages_pass_in_order_and_unchanged(daemon, served):
    with served.page() as (page, _):
        speak_until_heard(daemon, page)
        sent = [{"seq": seq, "nis": math.nan, "names": ["ö"]} for seq in range(300)]
        for fields in sent:
            daemon.say("palm/estimate", fields)
        daemon.say("palm/state", {"state": "ready"})
        came = [payload for topic, payload in heard(page, "palm/state") if topic == "palm/estimate"]
    assert came == [msgpack.packb(fields) for fields in sent]


def test_foreign_messages_are_left_out(daemon, served):
    with served.page() as (page, _):
        speak_until_heard(daemon, page)
        daemon.send(b"palm/state")
        daemon.send(b"palm/state", b"x", b"1.0", b"more")
        daemon.send(b"palm/stateless", b"x", b"1.0")
        daemon.send(b"palm/events", b"x", b"1.0")
        daemon.send(b"palm/state", b"\xc1 no msgpack", b"1.0")  # the page must ignore it
        daemon.say("palm/loop", {})
        came = heard(page, "palm/loop")
    assert [payload for topic, payload in came if topic != "palm/info"] == [b"\xc1 no msgpack", msgpack.packb({})]


def test_a_new_page_gets_the_last_message_of_every_topic_at_once(daemon, served):
    with served.page() as (page, _):
        speak_until_heard(daemon, page)
        for seq in range(3):
            daemon.say("rig/object", {"seq": seq})
        daemon.say("palm/loop", {})
        heard(page, "palm/loop")
    with served.page(token="") as (page, _):
        _, _, messages = next(batches(page))
    assert {topic: msgpack.unpackb(payload) for topic, payload in messages}.items() >= {
        "rig/object": {"seq": 2}, "palm/loop": {},
    }.items()  # fmt: skip


class Stuck:
    """A connection that accepts nothing until it is released."""

    def __init__(self):
        self.sent = []
        self.free = asyncio.Event()

    async def send(self, message):
        await self.free.wait()
        self.sent.append(message)


async def pause():
    for _ in range(5):
        await asyncio.sleep(0)


def test_a_slow_page_loses_frames_and_its_queue_is_bounded():
    async def story():
        connection = Stuck()
        client = PageClient(connection, operator=False, name="page 1")
        sending = asyncio.create_task(client.serve())
        latest = {"palm/loop": b"old"}
        for frame in range(1000):
            client.offer(frame, True, [("palm/estimate", bytes(1000))], latest.items())
            client.send_answer(f"answer {frame}")
            await pause()
        held = [value for slot in vars(client).values() for value in (slot if hasattr(slot, "__len__") else [slot])]
        assert sum(len(value) for value in held if isinstance(value, bytes | str)) < 2500
        assert client.lost == 999
        connection.free.set()
        await pause()
        latest["palm/loop"] = b"new"
        client.offer(1000, True, [("palm/estimate", b"1")], latest.items())
        client.offer(1001, True, [("palm/estimate", b"2")], latest.items())
        await pause()
        client.offer(1002, True, [("palm/estimate", b"3")], latest.items())
        await pause()
        sending.cancel()
        return [msgpack.unpackb(m) for m in connection.sent if isinstance(m, bytes)]

    first, caught_up, again = asyncio.run(story())
    assert first == [0, 0, True, [["palm/loop", b"old"]]]
    assert caught_up == [1000, 999, True, [["palm/loop", b"new"]]]
    assert again == [1002, 1000, True, [["palm/loop", b"new"]]]


def test_a_page_that_does_not_read_delays_no_other(daemon, served):
    with served.page() as (stuck, _), served.page() as (page, _):
        speak_until_heard(daemon, page)
        big = {"h_m": [0.0] * 90_000}
        for _ in range(7):  # more than all buffers on the way to the page that does not read
            daemon.say("palm/shape", big)
            heard(page, "palm/shape")
        assert stuck.protocol.state.name == "OPEN"
        assert not any(lost for lost, _, _ in [next(batches(page))])


# ---------------------------------------------------------------------------------------------------- bad input


def test_bad_input_is_a_one_line_error(capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert main(["view", "--no-browser", "--port", port]) == 1
    captured = capsys.readouterr()
    assert (captured.out, captured.err.count("\n")) == ("", 1)
    assert captured.err.startswith(f"127.0.0.1:{port}: cannot be bound")
    for option in ("--address", "--command", "--truth"):
        assert main(["view", "--no-browser", "--port", "0", option, "nonsense"]) == 1
        captured = capsys.readouterr()
        assert captured.err.startswith("nonsense: not an address")
        assert captured.err.count("\n") == 1
    with pytest.raises(SystemExit) as usage:
        main(["view", "--port", "70000"])
    assert usage.value.code == 2


def test_an_invalid_outline_does_not_end_the_classification(daemon, served, monkeypatch, caplog):
    monkeypatch.setattr(naming, "PERIOD_S", 0.02)
    with served.page() as (page, _):
        t_end = time.monotonic() + PATIENCE_S
        while "has no list h_sd_m" not in caplog.text and time.monotonic() < t_end:
            daemon.say("palm/estimate", {"valid": True, "object": 2})
            daemon.say("palm/shape", {"theta_rad": [0.0], "h_m": [0.02], "touched": [1]})
            time.sleep(0.02)
        while time.monotonic() < t_end:
            daemon.say("palm/shape", {"theta_rad": [0.0], "h_m": [0.02], "h_sd_m": [1e-4], "touched": [0]})
            with contextlib.suppress(TimeoutError):
                if naming.TOPIC.encode() in msgpack.packb(page.recv(0.1)):
                    break
        else:
            pytest.fail("it named nothing any more")
    logged = [record.message for record in caplog.records if record.name == "palmd.view.server"]
    assert logged == ["the outline cannot be classified: palm/shape has no list h_sd_m"]
