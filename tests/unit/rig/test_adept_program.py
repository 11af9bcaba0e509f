"""The controller's V+ program, run against the codec, the emulated controller and the link's conformance test."""

import contextlib
import random
import re
from collections import Counter
from pathlib import Path

import pytest
from farend import BAUD, HOME, LIMITS, FarEnd
from vplus import Module, VPlusError

from palmd.devices.armlink import (
    CONTROLLER_NEWLINE,
    HOST_NEWLINE,
    Ack,
    ArmState,
    LineReader,
    LinkError,
    Pose,
    Refusal,
    SetPoint,
    crc8,
    encode_command,
    encode_reply,
    frame,
    parse_command,
    wrap_mdeg,
)
from palmd.rig.controller import CYCLE_S, Controller
from tools.conformance.arm_checks import MAX_EXCURSION_M

SOURCE = Path(__file__).parents[3] / "tools" / "adept" / "palmd.v2"
TEXT = SOURCE.read_text(encoding="ascii")
README = SOURCE.with_name("README.md")
UM = 1e6


def started(text=TEXT, **functions):
    """The program after pd.start, with the tests' limits and a tool that turns at any requested rate."""
    module = Module(text, functions, rim=lambda *_: None)
    for name in ("pd.const", "pd.crctab", "pd.init"):
        module.call(name)
    limits = zip(("xmin", "xmax", "ymin", "ymax", "vmax", "amax"), _limits_um(), strict=True)
    module.globals |= {f"pd.{name}": value for name, value in limits}
    module.globals |= {"pd.wmax": 2e7, "pd.hw": 0.0, "pd.dev": 1e9}
    return module


def _limits_um():
    return [round(each * UM) for each in (LIMITS.x_min, LIMITS.x_max, LIMITS.y_min, LIMITS.y_max)] + [
        round(LIMITS.v_max * UM), round(LIMITS.a_max * UM)
    ]  # fmt: skip


class VPlusController:
    """The program in place of the emulated controller: bytes in, one round each cycle, bytes out."""

    def __init__(self, _limits=None, start=HOME, _baud=BAUD, _heard=None, text=TEXT):
        self.module = started(text)
        self.globals = self.module.globals
        self._put(start)
        self.module.call("pd.cycle")

    def _put(self, actual):
        mdeg = wrap_mdeg(round(_degrees(actual.t_rad) * 1e3))
        self.globals |= {"pd.ax": round(actual.x_m * UM), "pd.ay": round(actual.y_m * UM), "pd.at": mdeg}

    def feed(self, data, _t, _actual):
        for byte in data:
            self.module.call("pd.char", [([byte], 0)])
        return b""

    def cycle(self, _t, actual):
        self._put(actual)
        self.module.call("pd.cycle")
        return b"".join(line.encode() + CONTROLLER_NEWLINE for line in said(self.module))

    @property
    def path(self):
        x, y, t = (self.globals[f"pd.p{axis}"] for axis in "xyt")
        return Pose(x / UM, y / UM, _radians(t / 1e3))

    @property
    def state(self):
        return ArmState(chr(int(self.globals["pd.st"])))


def _degrees(angle):
    return angle * 57.29577951308232


def _radians(angle):
    return angle / 57.29577951308232


def said(module):
    """The content of the ring of answers, which is emptied."""
    lines = []
    while (place := int(module.globals["pd.o.out"])) != module.globals["pd.o.in"]:
        lines.append(module.globals["$pd.o", place])
        module.globals["pd.o.out"] = (place + 1) % int(module.globals["pd.ring"])
    return lines


def queued(module):
    """The commands in the ring, as the codec represents them."""
    commands = []
    for place in range(int(module.globals["pd.q.in"])):
        letter, ss, x, y, t = (module.globals[f"pd.q.{what}", place] for what in ("let", "ss", "x", "y", "t"))
        body = f"{chr(int(letter))}{int(ss):02X}" if letter != ord("H") else "H"
        body += f"{int(x):+07d}{int(y):+07d}{int(t):+07d}" if letter == ord("S") else ""
        commands.append(parse_command(body))
    return commands


def put(module, data):
    for byte in data:
        module.call("pd.char", [([byte], 0)])


# -- its parts against the codec -------------------------------------------------------------------------------


def test_the_table_is_that_of_the_checksum():
    module = started()
    assert [module.globals["pd.tab", value] for value in range(256)] == [crc8(bytes([value])) for value in range(256)]


def test_commands_are_read_as_the_codec_writes_them():
    random_ = random.Random(1)
    commands = [parse_command(body) for body in ("H", "G00", "Q7f", "P80", "RFF")]
    for _ in range(20):
        x, y = (random_.randint(-999_999, 999_999) / UM for _ in range(2))
        angle = _radians(random_.randint(-179_999, 180_000) / 1e3)
        commands.append(SetPoint(random_.randrange(256), Pose(x, y, angle)))
    module = started()
    put(module, b"".join(map(encode_command, commands)))
    assert [encode_command(each) for each in queued(module)] == [encode_command(each) for each in commands]
    assert module.globals["pd.bad"] == 0


@pytest.mark.parametrize(
    "body",
    ["", "Z00", "H1", "Q", "Q0", "Q000", "QG0", "G-1", "S00+000001+000002+00003", "S00+000001+000002+0000034",
     "S00 000001+000002+000003", "S00+00000a+000002+000003", "S00+000001+000002+180001", "S00+000001+000002-180000"],
)  # fmt: skip
def test_invalid_commands_are_dropped(body):
    module = started()
    put(module, frame(body, HOST_NEWLINE) + encode_command(parse_command("Q11")))
    assert queued(module) == [parse_command("Q11")]
    assert module.globals["pd.bad"] == 1


def test_noise_is_dropped_as_the_line_reader_drops_it():
    random_ = random.Random(2)
    for _ in range(60):
        noise = bytearray(encode_command(SetPoint(7, HOME)) * 3)
        for _ in range(random_.randint(1, 4)):
            noise[random_.randrange(len(noise))] = random_.choice(b"\n\r*0S\x00\xff ")
        module, reader = started(), LineReader(BAUD)
        put(module, noise)
        wanted = []
        for line in reader.feed(bytes(noise), 0.0):
            with contextlib.suppress(LinkError):
                wanted.append(parse_command(line.body))
        assert queued(module) == wanted


def test_overlong_lines_are_dropped():
    module = started()
    put(module, b"Q" * 1000 + b"\n" + encode_command(parse_command("Q11")))
    assert queued(module) == [parse_command("Q11")]


def test_a_full_ring_drops_the_newest():
    module = started()
    put(module, b"".join(encode_command(parse_command(f"Q{ss:02X}")) for ss in range(64)))
    assert queued(module) == [parse_command(f"Q{ss:02X}") for ss in range(31)]
    module.call("pd.cycle")
    assert len(said(module)) == 31


@pytest.mark.parametrize("um", [0, -0.4, 0.5, -1, 999_999, -999_999, 123_456.4, 2e6])
def test_answers_are_written_as_the_codec_writes_them(um):
    module = started()
    module.call("pd.cycle")
    module.globals |= {"pd.ax": um, "pd.ay": -um, "pd.at": 0}
    module.call("pd.send.a", [([ord("Q")], 0), ([0xAB], 0)])
    metres = min(int(um + 0.5 if um > 0 else um - 0.5), 999_999) / UM
    [line] = said(module)
    assert line + "\r\n" == encode_reply(Ack(0xAB, ArmState.READY, Pose(metres, -metres, 0.0))).decode()


def test_hello_and_refusals():
    module = started()
    put(module, b"".join(encode_command(parse_command(body)) for body in ("H", "S05+100000+000000+000000")))
    module.call("pd.cycle")
    assert [line + "\r\n" for line in said(module)] == [
        encode_reply(LIMITS.hello()).decode(), encode_reply(Refusal(5, -620)).decode()
    ]  # fmt: skip


# -- the whole against the emulated controller, and against the contract ---------------------------------------


def _um(x_mm):
    return max(-999_999, min(999_999, round(x_mm * 1e3)))


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(n, marks=pytest.mark.nightly) for n in range(4, 12))])
def test_it_answers_and_moves_as_the_emulated_controller(seed):
    mine, theirs = VPlusController(), Controller(LIMITS, HOME, BAUD, lambda _pose, _t: None)
    heard = Counter()
    random_ = random.Random(seed)
    ss, body, t, quiet = 0, "Q00", 0.0, 0
    for _ in range(600):
        quiet = max(quiet - 1, random_.choice((0,) * 40 + (4, 12)))
        actual = _whole(theirs.path)
        mine_out = theirs_out = b""
        for _ in range(0 if quiet else random_.choice((0, 1, 1, 1, 1, 2))):
            ss = (ss + 1) % 256
            if random_.random() > 0.1:  # otherwise the last command again
                body = _random_body(random_, ss, actual)
            line = frame(body, HOST_NEWLINE)
            mine_out += mine.feed(line, t + CYCLE_S / 2, actual)
            theirs_out += theirs.feed(line, t + CYCLE_S / 2, actual)
        t += CYCLE_S
        mine_out += mine.cycle(t, actual)
        theirs_out += theirs.cycle(t, actual)
        assert mine_out == theirs_out
        assert (mine.path.x_m, mine.path.y_m) == pytest.approx((theirs.path.x_m, theirs.path.y_m), abs=2e-6)
        heard.update(line[3 if line[0] == "A" else 0] for line in theirs_out.decode().splitlines())
    assert heard.keys() >= set("TRE")


def _whole(pose):
    """A pose that the protocol represents exactly."""
    mdeg = wrap_mdeg(round(_degrees(pose.t_rad) * 1e3))
    return Pose(round(pose.x_m * UM) / UM, round(pose.y_m * UM) / UM, _radians(mdeg / 1e3))


def _random_body(random_, ss, actual):
    letter = random_.choices("SGQPR", (60, 6, 10, 1, 4))[0]
    body = f"{letter}{ss:02X}"
    if letter != "S":
        return body
    reach_mm = random_.choice((0.2, 0.2, 0.2, 3.0, 8.0, 40.0, 500.0))
    x, y = (1e3 * home + random_.uniform(-reach_mm, reach_mm) for home in (actual.x_m, actual.y_m))
    turn = random_.choice((0.0, 0.0, 1.0, 4.0)) + _degrees(actual.t_rad)
    return f"{body}{_um(x):+07d}{_um(y):+07d}{wrap_mdeg(round(turn * 1e3)):+07d}"


@pytest.mark.parametrize("phase_s", [0.0003, 0.0091])
def test_the_program_passes_the_conformance_test(phase_s):
    far_end = FarEnd(VPlusController, phase_s)
    assert [result for result in far_end.examine() if result.outcome != "passed"] == []
    assert far_end.far_m < MAX_EXCURSION_M


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("pd.hold = 3", "pd.hold = 6"),
        ("pd.give = 10", "pd.give = 13"),
        ("pd.near = 5000", "pd.near = 50000"),
        ("BXOR 7) BAND 255", "BXOR 9) BAND 255"),
        ("leap > ((3*pd.vmax)", "leap > ((30*pd.vmax)"),
        ("IF code == 0 THEN\n                pd.gx = pd.nx", "pd.sage = 0\nIF code == 0 THEN\npd.gx = pd.nx"),
        ("CALL pd.say($pd.d.ans)\n            RETURN", "CALL pd.say($pd.d.ans)"),
        ("pd.sage = -1\n                CALL", "pd.sage = 0\n                CALL"),
        ("CALL pd.send.e(0, pd.last, code)", "CALL pd.send.e(0, 0, code)"),
        ("code = -610", "code = -611"),
    ],
)
def test_an_error_in_the_program_is_detected(right, wrong):
    assert right in TEXT

    class Wrong(VPlusController):
        def __init__(self, *arguments):
            super().__init__(*arguments, text=TEXT.replace(right, wrong))

    assert any(result.outcome == "failed" for result in FarEnd(Wrong).results())


# -- the robot's condition, and the edge of the workspace ------------------------------------------------------


def condition(power=-1, **states):
    known = {"s1": 7, "s4": 0, "s5": 1} | states
    module = started(STATE=lambda select: known[f"s{int(select)}"], SWITCH=lambda _: power)
    module.call("pd.robot")
    return module.globals["pd.hw"] and chr(int(module.globals["pd.hw"]))


def test_the_robots_condition_is_reported():
    assert condition() == 0
    assert condition(s1=8) == "U"
    assert condition(s1=4) == "M"
    assert condition(s5=2) == "M"
    assert condition(power=0, s1=2) == "P"
    assert condition(s1=5) == "P"
    assert condition(power=0, s1=2, s4=4) == "X"


def test_an_emergency_stop_is_reported_once_and_only_the_operator_ends_it():
    controller = VPlusController()
    controller.feed(encode_command(parse_command("G09")), 0.0, HOME)
    controller.cycle(0.0, HOME)
    replies = []
    for condition_, letter in (("X", "X"), ("X", "X"), ("P", "X"), (None, "R")):
        controller.globals["pd.hw"] = float(ord(condition_)) if condition_ else 0.0
        controller.feed(encode_command(parse_command("R33")), 0.0, HOME)
        replies.append(controller.cycle(0.0, HOME).decode())
        assert controller.state == letter
    lines = [line[:8] for line in "".join(replies).splitlines()]
    assert lines == ["E09-0621", *["E33-0621"] * 4]


@pytest.mark.parametrize(("cause", "code"), [("pd.lerr", -504), ("pd.lost", -600)])
def test_a_break_and_a_stuck_motion_task_end_in_a_fault(cause, code):
    controller = VPlusController()
    controller.feed(encode_command(parse_command("G09")), 0.0, HOME)
    controller.cycle(0.0, HOME)
    controller.globals[cause] = code if cause == "pd.lerr" else -1
    assert controller.cycle(0.0, HOME) == encode_reply(Refusal(9, code))
    assert controller.state is ArmState.FAULT
    controller.globals[cause] = code if cause == "pd.lerr" else -1
    assert controller.cycle(0.0, HOME) == b""


@pytest.mark.parametrize(("held", "code"), [(True, -1006), (False, None)])
def test_an_arm_that_leaves_its_path_is_stopped_with_a_fault(held, code):
    controller = VPlusController()
    controller.globals["pd.dev"] = 15000.0
    controller.feed(encode_command(parse_command("G00")), 0.0, HOME)
    controller.cycle(0.0, HOME)
    step = 0.2 * LIMITS.v_max * CYCLE_S
    heard, errors, pose = LineReader(BAUD), [], HOME
    for n in range(1, 60):
        goal = Pose(HOME.x_m + min(n * step, 0.05), HOME.y_m, HOME.t_rad)
        controller.feed(encode_command(SetPoint(n % 256, goal)), 0.0, pose)
        said_now = controller.cycle(0.0, pose)
        pose = HOME if held else controller.path
        errors += [line.body for line in heard.feed(said_now, 0.01 * n) if line.body.startswith("E")]
    if code is None:
        assert not errors
    else:
        assert sum(body.endswith(f"{code:+05d}") for body in errors) == 1
        assert controller.state is ArmState.FAULT


def test_the_tools_rate_is_clamped_across_the_wrap():
    controller = VPlusController(start=Pose(0.1, 0.02, _radians(179.5)))
    controller.globals["pd.wmax"] = 60_000
    for ss, body in enumerate(["G00", *["S{:02X}+100000+020000-179500"] * 2]):
        controller.feed(frame(body.format(ss), HOST_NEWLINE), 0.0, HOME)
        controller.cycle(0.0, Pose(0.1, 0.02, _radians(179.5)))
    assert _degrees(controller.path.t_rad) == pytest.approx(-179.5, abs=1e-3)
    assert controller.globals["pd.sturn"] == pytest.approx(1000 - 960, abs=0.1)


def test_the_line_task_reads_all_input_and_writes_all_answers():
    line = encode_command(parse_command("Q21"))
    arriving = [*line[:3], -526, *line[3:], -522, *b"Q\n", -504, -526]
    written = []

    def rim(keyword, what):
        written.extend(what if keyword == "WRITE" else [])
        if keyword == "WAIT.EVENT" and not arriving:
            module.globals["pd.run"] = 0

    module = started(GETC=lambda *_: arriving.pop(0), IOSTAT=lambda _: 0)
    module._rim = rim
    module.globals |= {"pd.lun": 20, "pd.run": -1, "pd.o.in": 2, ("$pd.o", 0): "one", ("$pd.o", 1): "two"}
    module.call("pd.serial")
    assert written == ["one", "two"]
    assert queued(module) == [parse_command("Q21")]
    assert (module.globals["pd.bad"], module.globals["pd.lerr"]) == (1, -504)


def test_steps_are_passed_to_the_robot_in_millimetres_and_degrees_while_it_moves():
    done = []
    module = started()
    module._rim = lambda keyword, what: done.append((keyword, what if keyword == "ALTER" else None))
    module.call("pd.cycle")
    module.globals |= {"pd.sx": 250.0, "pd.sy": -500.0, "pd.sturn": 40.0}
    for state in "RTTR":
        module.globals["pd.st"] = float(ord(state))
        module.call("pd.drive")
    words = ["SET", "ALTON", "DURATION", "MOVES", "ALTER", "ALTER", "BRAKE", "ALTOFF"]
    assert [keyword for keyword, _ in done] == words
    assert done[4][1] == pytest.approx([0.25, -0.5, 0, 0, 0, 0.04])


# -- the text --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("CALL pd.anchor", "CALL pd.anker"),
        ("CALL pd.put.num(code, 4)", "CALL pd.put.num(code)"),
        ("pd.have = FALSE", "pd.hvae = pd.hvea"),
        ("        AUTO code\n", ""),
        ("        AUTO code\n", "        AUTO code, step\n"),
        ("(pd.st == 'T) OR (pd.st == 'H)", "pd.st == 'T OR pd.st == 'H"),
        ("        WHILE v > 180000 DO\n", ""),
        ("            v = v-360000\n        END\n", "            v = v-360000\n"),
        ("pd.crctab", "pd.crctab.and.more"),
        ("        RETURN\n.END\n.PROGRAM pd.rest()", "        RETURN\n.PROGRAM pd.rest()"),
        ("              ANY\n", "              OTHERWISE\n"),
        (";um, workspace in robot world", ";um, workspace in robot world, which is a long way of saying it"),
    ],
)
def test_a_typing_error_is_detected(right, wrong):
    assert right in TEXT
    with pytest.raises(VPlusError):
        Module(TEXT.replace(right, wrong, 1))


def test_untested_lines_are_listed_in_the_readme():
    """The first word of each marked line is in the README's table."""
    marked = [line.strip() for line in TEXT.splitlines() if ";?" in line and not line.startswith(";")]
    listed = set(re.findall(r"^\| `([^`]+)`", README.read_text(encoding="utf-8"), re.MULTILINE))
    missing = [line for line in marked if not any(line.startswith(each) for each in listed)]
    assert missing == []
    assert [each for each in listed if not any(line.startswith(each) for line in marked)] == []


def test_files_for_the_controller_are_plain_text():
    assert re.fullmatch(r"[ -~\n]*", TEXT)
