"""The live page in a real browser, without a rig: what it shows of published messages, and its buttons' commands."""

import itertools
import math
import os
import re
import threading
import time
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq
from browser_page import DOUBLE_CLICK_S, ESCAPE, LAPTOP, PHONE, SMALL, WIDE, Page, browser
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from served import Served

from palmd.model.icosphere import icosphere
from palmd.view.server import FRAME_S

IN_VIEW = """
    const { left, top, right, bottom } = document.querySelector(arguments[0]).getBoundingClientRect();
    const seen = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
    return seen?.closest(arguments[0]) && left >= 0 && right <= innerWidth && top >= 0 && bottom <= innerHeight;
"""
COLOURS_SETTLED = "return !document.getAnimations().some((each) => each instanceof CSSTransition)"
CLOCK_STOPPED = """
    if (!document.getElementById("stale").hidden) return false;
    const now = performance.now();
    performance.now = () => now;
    return true;
"""
LABEL = "return document.getElementById('scene').ariaLabel"
AXE = Path(__file__).parents[2] / "tools/axe-core/axe.min.js"


@pytest.fixture(scope="module")
def driver():
    with browser() as one:
        yield one


class Bus:
    """A publisher that repeats its messages, and a command socket that grants and records every command."""

    def __init__(self):
        self._context = zmq.Context()
        self._publisher, self._commands = self._context.socket(zmq.PUB), self._context.socket(zmq.ROUTER)
        self.publish, self.command = (
            f"tcp://127.0.0.1:{socket.bind_to_random_port('tcp://127.0.0.1')}"
            for socket in (self._publisher, self._commands)
        )
        self.messages, self.asked = {}, []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def _live(self):
        while not self._over.wait(0.02):
            for topic, fields in list(self.messages.items()):
                payload = msgpack.packb({"mono_ns": time.monotonic_ns(), **fields})
                self._publisher.send_multipart([topic.encode(), payload, b"1.0"])
            while self._commands.poll(0):
                *route, request = self._commands.recv_multipart()
                asked = msgpack.unpackb(request)
                if asked["cmd"] != "alive":  # the page renews its lease all the time
                    self.asked.append(asked)
                self._commands.send_multipart([*route, msgpack.packb({"id": asked["id"], "ok": True})])

    def close(self):
        self._over.set()
        self._thread.join()
        self._context.destroy(linger=0)


@pytest.fixture
def bus():
    one = Bus()
    yield one
    one.close()


@pytest.fixture
def still(driver, bus, caplog):
    """The page of `bus`: a rig with some number of palms, at rest, tracking."""
    server = Served(bus)
    page = Page(driver, server.url)
    page.resize(*LAPTOP)
    yield page
    page.leave()
    server.close()
    said = [each.getMessage() for each in caplog.get_records("call") if each.name.startswith(("palmd", "asyncio"))]
    assert said == []


def rig_of(palms, state="tracking", **more):
    """The messages of a daemon with `palms` palms: symmetric about the vertical, a circle of 20 mm on them."""
    angles = [0.3, *[(math.pi - 0.6) / max(palms - 1, 1)] * (palms - 1)]
    numbers = range(1, palms + 1)
    estimate = {"valid": True, "object": 1, "com_x_m": 0.0, "com_y_m": 0.02, "psi_rad": 0.1, "mass_kg": 0.15,
                "touched": 0.4, "nis": 1.0, "observability": 2.0, "sd": {"mass_kg": 0.002}}  # fmt: skip
    for number, angle in zip(numbers, angles, strict=True):
        estimate |= {f"phi{number}_rad": angle, f"r{number}_m": 0.02, f"s{number}_m": 0.03, f"f{number}_n": 0.5}
    count = 180
    said = {"state": state, "faults": [], "severities": [], "hints": [], "texts": [], "cause": "arm", "since_s": 4.0,
            "running": False, "exploring": False, "explored_s": math.nan, "coverage": math.nan,
            "reason": ""}  # fmt: skip
    return {
        "palm/info": {
            "version": "0", "observer": "shape", "palms": list(numbers), "joints": [f"phi{n}" for n in numbers],
            "sides": [1.0] * (palms - 1) + [-1.0] if palms > 1 else [1.0], "plans": ["rock.yaml", "swing.yaml"],
            **{f"palm{n}_length_m": 0.12 for n in numbers}, **{f"pad{n}_length_m": 0.0555 for n in numbers},
        },
        "palm/estimate": estimate,
        "palm/shape": {"theta_rad": [2 * math.pi * i / count for i in range(count)], "h_m": [0.02] * count,
                       "h_sd_m": [5e-6] * (count // 2) + [2e-4] * (count // 2),
                       "touched": [1] * (count // 2) + [0] * (count // 2)},
        "palm/contact": {f"touch{n}": True for n in numbers} | {f"age{n}_ms": 8.0 for n in numbers},
        "palm/motion": {"plan": "rock", "segment": -1, "progress": 0.0, "arm_state": "T"}
        | {f"phi{n}_rad": angle for n, angle in zip(numbers, angles, strict=True)},
        "palm/state": said | more,
    }  # fmt: skip


def body_in_space(off_m=0.0):
    """The messages of three palms: an ellipsoid rotated by half a radian; the true one is larger by `off_m`."""
    axes, directions = np.array([0.02, 0.016, 0.024]), icosphere(3)[0]
    h = np.linalg.norm(directions * axes, axis=1)
    quat, numbers = [0.0, 0.0, math.sin(0.25), math.cos(0.25)], (1, 2, 3)
    place = {"com_x_m": 0.0, "com_y_m": 0.024, "com_z_m": 0.034}
    joints = {"beta_rad": 0.9, "gamma2_rad": 0.8, "gamma3_rad": 0.8}
    contacts = {f"{side}{n}_m": 0.024 for n in numbers for side in "ab"}
    spin = dict.fromkeys(("omega_x_rad_s", "omega_y_rad_s", "omega_z_rad_s"), 0.1)
    radii = {f"h{n}_m": 0.02 for n in numbers} | {f"f{n}_n": 0.5 for n in numbers}
    return {
        "palm3/info": {"version": "0", "system": "three_palms", "observer": "space", "palms": list(numbers),
                       "joints": ["beta", "gamma2", "gamma3"], "pad_side_m": 0.075, "plans": [],
                       "pad1_centre_m": [0.0, 0.0375], "pad2_centre_m": [0.0375, 0.0375],
                       "pad3_centre_m": [0.0375, 0.0375]},
        "palm3/estimate": {"valid": True, "object": 1, "quat_xyzw": quat, "touched": 0.5, "nis": 1.0, "mass_kg": 0.15,
                           "sd": {"mass_kg": 0.002}} | place | joints | contacts | spin | radii,
        "palm3/shape": {"halvings": 3, "h_m": h.tolist(), "h_sd_m": np.where(directions[:, 2] > 0, 2e-4, 5e-6).tolist(),
                        "touched": (directions[:, 2] < 0).astype(int).tolist()},
        "palm3/contact": contacts | {f"touch{n}": True for n in numbers} | {f"age{n}_ms": 8.0 for n in numbers},
        "palm3/motion": {"plan": "sway", "segment": -1, "progress": 0.0, "arm_state": "T"} | joints,
        "palm/state": rig_of(2)["palm/state"],
        "rig/palm3": {"quat_xyzw": quat} | place | spin,
        "rig/palm3_object": {"halvings": 3, "h_m": (h + off_m).tolist(), "mass_kg": 0.15},
    }  # fmt: skip


def pivoting():
    """The messages of a gripper that holds a disc of 20 mm, 8 mm from its centre, on a pad of 50 mm."""
    theta = np.arange(360) * (2 * np.pi / 360)
    h = 0.02 + 0.008 * np.cos(theta)
    return {
        "palm/pivot": {"valid": True, "object": 1, "x_m": 0.02, "z_m": 0.02, "s1_m": 0.028, "e_m": 0.008,
                       "psi_rad": 0.0, "omega0_rad_s": 0.1, "f1_n": 0.5, "mu": 0.2, "touched": 0.6, "nis": 1.0,
                       "sd": {}},
        "palm/pivot_shape": {"theta_rad": theta.tolist(), "hP_m": h.tolist(), "hP_sd_m": [5e-6] * 360,
                             "touched": [1] * 360},
        "palm/pivot_contact": {"s1_m": 0.028, "touch1": True, "age1_ms": 8.0, "arm_age_ms": 8.0},
        "palm/pivot_motion": {"plan": "drag", "segment": -1, "progress": 0.0, "arm_state": "T"},
        "palm/pivot_info": {"system": "pivot", "version": "1", "observer": "pivot", "pad1_length_m": 0.05},
        "palm/state": rig_of(1)["palm/state"],
    }  # fmt: skip


def opened(page, bus, messages):
    bus.messages = messages
    page.open()
    page.until(lambda: not page.shows("stale"), "anything")
    return page


def described(page, words):
    """Waits until the picture's description, which is updated every few seconds, contains the words."""
    page.until(lambda: words in page.script(LABEL), "the description")


def test_fields_of_an_old_recording_are_read_under_their_former_names(still, bus):
    opened(still, bus, rig_of(2) | {"palm/rig": {"off": ["pad 1's zero seems off: calibrate"]}})
    still.until(lambda: still.text("notice-count") == "1: 1 rig", "the deviation")


def test_a_system_without_jogging_has_no_jog_pad(still, bus):
    messages = rig_of(2)
    opened(still, bus, messages)
    still.until(lambda: still.shows("jog") and still.shows("jog-line"), "the jog pad")
    messages["palm/info"]["system"] = "pivot"
    opened(still, bus, messages)
    still.until(lambda: not still.shows("jog") and not still.shows("jog-line"), "the jog pad to go")
    assert still.shows("plans")


@pytest.mark.parametrize("palms", [1, 3])  # two in the other tests
def test_a_system_of_any_number_of_palms_is_shown_by_its_description(still, bus, palms):
    opened(still, bus, rig_of(palms))
    still.until(lambda: still.script("return document.querySelectorAll('#jog button').length") == 2 * palms, "the pads")
    assert f"palm {palms}" in still.text("jog")
    still.until(lambda: still.drawn("blue") > 300, "palm 1")
    assert (still.drawn("red") > 300) == (palms > 1)
    assert (still.drawn("green") > 100) == (palms > 1)  # one palm does not determine the object's position
    assert (still.drawn("purple") > 300) == (palms > 2)
    described(still, f"Palm {palms} at ")
    assert still.errors() == []


def test_a_body_in_a_pivoting_grasp_is_drawn_and_described(still, bus):
    opened(still, bus, pivoting())
    for hue in ("blue", "green"):  # pad and contact, and the well-known parts of the body
        still.until(lambda hue=hue: still.drawn(hue) > 300, hue)
    described(still, "Touched over 60 % of the outline about the pivot.")
    assert "Pad touched at 28.00 mm, pressed with 0.50 N" in still.script(LABEL)
    assert still.errors() == []


def test_a_body_in_space_is_drawn_between_its_palms(still, bus):
    opened(still, bus, body_in_space(off_m=30e-6))
    for hue in ("blue", "red", "purple", "green"):  # three palms, and the well-known parts of the body
        still.until(lambda hue=hue: still.drawn(hue) > 300, hue)
    still.until(lambda: still.text("error-to-truth") == "error to truth: 30\u00a0µm, worst 30\u00a0µm", "the error")
    shown = "return [...document.querySelectorAll('.strip:not([hidden]) .name')].map((each) => each.textContent)"
    assert {"h1", "ωx", "β", "γ₂", "f3"} <= set(still.script(shown))
    assert not {"r₁", "φ₁", "ρ"} & set(still.script(shown))
    rows = "return [...document.querySelectorAll('#numbers tr:not([hidden]) .symbol')].map((each) => each.textContent)"
    assert "m" in still.script(rows)
    assert "ψ" not in still.script(rows)
    before = still.script("return document.getElementById('scene').toDataURL()")
    still.script("document.getElementById('scene').focus()")
    still.key(Keys.ARROW_LEFT)  # seen from another side
    still.until(lambda: still.script("return document.getElementById('scene').toDataURL()") != before, "another side")
    described(still, "Touched over 50 % of the surface")
    assert still.errors() == []
    opened(still, bus, rig_of(2))
    still.until(lambda: {"r₁", "φ₁"} <= set(still.script(shown)), "two palms again")


ACTIVITIES = """
    const [stores] = arguments;
    return Promise.all([import("/knowledge.js"), import("/settling.js")]).then(([{ activity }, { Settling }]) => {
      const settling = new Settling();
      for (let t = 0; t <= 12; t++) settling.take(5e-6, t);
      return stores.map((messages) => activity({ get: (topic) => messages[topic] ?? {} }, settling).words);
    });
"""


def test_the_current_activity_is_described(still, bus):
    opened(still, bus, rig_of(2))
    still.until(lambda: still.text("words") == "Armed, no plan is running", "the activity")
    cases = {
        "Held: pad 1 fell silent": {"state": "hold", "cause": "pad 1 fell silent"},
        "Stopped: arm power is off": {"state": "fault", "cause": "arm power is off"},
        "Disarmed: the arm is not commanded": {"state": "ready", "cause": "stop was requested"},
        "Done: 98 % in 28 s, ± 5 µm": {"explored_s": 28.2, "coverage": 0.98, "coverage_goal": 0.95},
        "Ended at 70 % in 60 s": {"explored_s": 60.0, "coverage": 0.7, "coverage_goal": 0.95},
    }
    unknown = {"explored_s": None, "coverage": None}
    shown = still.script(ACTIVITIES, [rig_of(2, **unknown | more) for more in cases.values()])
    assert [words.replace("\u00a0", " ") for words in shown] == list(cases)
    assert (still.text("known"), still.text("typical"), still.text("worst")) == ("40", "± 5", "worst ±\u00a05\u00a0µm")
    assert (still.text("mass"), still.text("mass-sd")) == ("150.0", "± 2.0 g")


def test_an_emulated_rig_without_processor_time_is_not_shown_as_a_pad_fault(still, bus):
    messages = rig_of(2, state="hold", cause="pad 1 fell silent")
    messages["rig/stall"] = {"t_s": 1.0, "lasted_s": 0.112, "count": 3}
    opened(still, bus, messages)
    words = "The emulated rig itself got no processor time for 112 ms (3 times so far): no data from pads and arm."
    still.until(lambda: still.text("reason").replace("\u00a0", " ").startswith(words), "whose fault it is")


def test_reasons_against_an_estimate_are_shown(still, bus):
    messages = rig_of(2, running=True, exploring=True, explored_s=8.0, reason="rocks the object")
    messages["palm/estimate"] |= {"valid": False, "invalid_reasons": ["unexplained", "not-sharp"]}
    opened(still, bus, messages)
    still.until(lambda: all(part in still.text("reason") for part in ("rocks", "unexplained", "not-sharp")), "why")
    messages["palm/estimate"] |= {"valid": True, "invalid_reasons": []}
    still.until(lambda: still.text("reason") == "rocks the object", "no doubt")


def test_plots_are_drawn_only_in_view_and_at_once_when_scrolled_to(still, bus):
    still.resize(*SMALL)
    opened(still, bus, rig_of(2))
    drawn = """
        const canvas = [...document.querySelectorAll(".strip:not([hidden]) canvas")].at(-1);
        const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        return data.filter((each) => each).length;
    """
    still.until(lambda: still.text("fps")[:1].isdigit() and float(still.text("fps").split()[0]) > 5, "some pictures")
    before = still.script(drawn)
    still.script("[...document.querySelectorAll('.strip:not([hidden])')].at(-1).scrollIntoView()")
    still.until(lambda: still.script(drawn) > before + 1000, "the last plot")


FRAMES_PER_S = """
    return new Promise((done) => {
      const [begun, request] = [performance.now(), window.requestAnimationFrame];
      let count = 0;
      window.requestAnimationFrame = (frame) => (count++, request(frame));
      setTimeout(() => {
        window.requestAnimationFrame = request;
        done(count / ((performance.now() - begun) / 1e3));
      }, 2000);
    });
"""


def test_the_browser_gets_no_more_frames_than_the_view_needs(still, bus):
    opened(still, bus, rig_of(2))
    assert 1 < still.script(FRAMES_PER_S) < 1.5 / FRAME_S
    still.script("document.getElementById('tab-log').click()")
    assert 1 < still.script(FRAMES_PER_S) < 10


def test_an_invalid_estimate_is_shown_without_numbers_and_lens(still, bus):
    messages = rig_of(2)
    opened(still, bus, messages)
    still.script("document.getElementById('magnify').click()")
    still.until(lambda: re.fullmatch(r"×\d+", still.text("magnification")), "the lens")
    messages["palm/estimate"]["valid"] = False
    still.until(lambda: still.text("magnification") == "", "no lens")
    assert (still.text("typical"), still.text("mass"), still.text("worst")) == ("–", "–", "")


def test_every_button_can_be_pressed_by_keyboard(still, bus):
    """By the space bar; jogging continues while the key is down, and no longer. Tab leads there: see the next test."""
    messages = rig_of(2)
    opened(still, bus, messages)

    def focus(selector):
        script = "document.querySelector(arguments[0]).focus(); return document.activeElement.matches(arguments[0])"
        assert still.script(script, selector), selector

    def press(selector, twice=False):
        still.until(lambda: still.script("return document.querySelector(arguments[0]).matches(':enabled')", selector),
                    f"{selector} to apply")  # fmt: skip
        focus(selector)
        for _ in range(1 + twice):
            ActionChains(still.driver).send_keys(Keys.SPACE).perform()
            time.sleep(DOUBLE_CLICK_S * twice)

    def jogged(joint):
        """The steps of this joint, once there are some."""
        steps = [asked["args"] for asked in bus.asked if asked["cmd"] == "jog" and f"{joint}_deg" in asked["args"]]
        return steps if len(steps) > 3 else []

    def asks(command):
        still.until(lambda: bus.asked and bus.asked[-1]["cmd"] == command, command)

    press("[aria-label='Load rock.yaml']")
    asks("plan")
    assert bus.asked[-1]["args"] == {"path": "rock.yaml"}
    press("#explore", twice=True)
    asks("start")  # tracking: there is no need to arm
    assert [each["cmd"] for each in bus.asked[-2:]] == ["plan", "start"]
    assert bus.asked[-2]["args"]["path"] == "explore.yaml"
    press("#new-object", twice=True)
    asks("new_object")
    focus("#note")
    ActionChains(still.driver).send_keys("as hold").perform()  # letters that are keys elsewhere
    press("#send-note")
    asks("note")
    assert bus.asked[-1]["args"] == {"text": "as hold"}
    assert still.text("answer") in ("note…", "note: done")
    for joint, label in (("phi1", "Turn palm 1 forward while held"), ("phi2", "Turn palm 2 back while held")):
        focus(f"[aria-label='{label}']")
        ActionChains(still.driver).key_down(Keys.SPACE).perform()
        steps = still.until(lambda joint=joint: jogged(joint), "some steps")
        ActionChains(still.driver).key_up(Keys.SPACE).perform()
        assert {abs(step[f"{joint}_deg"]) for step in steps} == {0.4}
        time.sleep(0.2)  # for commands in transit
        count = len(bus.asked)
        time.sleep(0.4)
        assert len(bus.asked) == count  # no key is held any more
    press("[data-command=hold]")
    asks("hold")
    press("[data-command=start]", twice=True)
    asks("start")
    press("[data-command=stop]")
    asks("stop")
    for state, arm, command in (("ready", "R", "arm"), ("fault", "F", "reset")):
        messages["palm/state"]["state"], messages["palm/motion"]["arm_state"] = state, arm
        press(f"[data-command={command}]", twice=command == "arm")
        asks(command)
        still.until(lambda: "stop" not in still.enabled(), "nothing to stop")
    still.key(ESCAPE)  # works nevertheless: the page may be wrong
    asks("stop")
    assert still.errors() == []


TO_BE_REACHED = """
    window.numbered = window.numbered ?? new Map();
    const all = [...document.querySelectorAll("button, a[href], input, select, summary, [tabindex]")];
    const seen = (one) => one.checkVisibility() && !one.disabled && one.tabIndex >= 0;
    return all.filter(seen).map((one) => {
      if (!numbered.has(one)) numbered.set(one, numbered.size);
      return [numbered.get(one), one.id || one.getAttribute("aria-label") || one.textContent.trim()];
    });
"""


def test_views_sliders_and_menus_work_by_keyboard(still, bus):
    """Tab reaches every control in each view; arrows choose views, move sliders and choose from menus."""
    opened(still, bus, rig_of(2))

    def keys(*which):
        ActionChains(still.driver).send_keys(*which).perform()

    def focused():
        return still.script("return window.numbered?.get(document.activeElement)")

    still.script("document.getElementById('tab-live').focus()")
    for view in ("live", "runs", "configuration", "log"):
        still.until(lambda view=view: still.shows(f"view-{view}"), view)
        wanted = dict(still.script(TO_BE_REACHED))
        reached = set()
        for _ in range(2 * len(wanted) + 10):
            keys(Keys.TAB)
            reached.add(focused())
        assert {name for number, name in wanted.items() if number not in reached} == set(), view
        still.script("document.getElementById(arguments[0]).focus()", f"tab-{view}")
        keys(Keys.ARROW_RIGHT)
    still.until(lambda: still.shows("view-live"), "the first view again")
    value = "return document.getElementById(arguments[0]).value"
    for slider in ("window-scrub", "window-cursor"):
        still.script("document.getElementById(arguments[0]).focus()", slider)
        before = float(still.script(value, slider))
        keys(Keys.ARROW_LEFT * 20)
        assert float(still.script(value, slider)) < before, slider
    still.script("document.getElementById('window-span').focus()")
    keys(Keys.ARROW_DOWN)
    assert still.script(value, "window-span") == "60"
    assert still.errors() == []


def test_state_and_stop_are_visible_in_every_view_and_size(still, bus):
    opened(still, bus, rig_of(2))
    for size in (LAPTOP, SMALL, PHONE, WIDE):
        still.resize(*size)
        still.until(lambda width=size[0]: still.script("return innerWidth") == width, "the size")
        for share in (0.0, 0.5, 1.0):
            still.script("scrollTo(0, arguments[0] * document.documentElement.scrollHeight)", share)
            for selector in ("#state", "[data-command=stop]"):
                assert still.script(IN_VIEW, selector), (size, selector, share)
        assert still.script("return document.documentElement.scrollWidth") <= size[0], size
        if size in (LAPTOP, SMALL):  # scene and figures are visible without scrolling
            still.script("scrollTo(0, 0)")
            assert still.script(IN_VIEW, "#mass-sd"), size
            assert still.script("return document.getElementById('scene').getBoundingClientRect().bottom") <= size[1]


def test_a_phone_may_watch_without_the_token(still, bus):
    still.resize(*PHONE)
    opened(still, bus, rig_of(2))
    still.script("sessionStorage.clear()")
    still.open(token=False)
    still.until(lambda: not still.shows("stale"), "anything")
    still.until(lambda: "Read-only" in still.text("authority"), "what it may do")
    assert still.enabled() == set()
    right = "return Math.max(...[...document.querySelectorAll('canvas')].map((c) => c.getBoundingClientRect().right))"
    assert still.script(right) <= PHONE[0]
    assert still.errors() == []


def test_longer_texts_do_not_move_other_elements(still, bus):
    opened(still, bus, rig_of(2))
    where = "return JSON.stringify(['#reason', '#validity', '#take', '.tabs', '#control'].map((name) => {"
    where += " const { x, y } = document.querySelector(name).getBoundingClientRect(); return [x, y]; }))"
    script = "for (const id of ['words', 'control']) document.getElementById(id).textContent = arguments[0]; " + where
    for size in (LAPTOP, PHONE):
        still.resize(*size)
        long = "at length, in more words than fit into one line " * 3
        assert still.script(script, "brief") == still.script(script, long), size


HINTS = [
    "loop-overrun", "estimate-inconsistent", "pad1-batched", "pad2-batched", "rig-contradicted", "samples-too-late",
    "recorder-silent", "pad1-silent",
]  # fmt: skip


@pytest.mark.parametrize("size", [LAPTOP, PHONE], ids=str)
def test_nothing_moves_while_hints_arrive_and_a_jog_is_held(still, bus, size):
    """By the browser's own metric, after inputs too; for `PALMD_SHIFT_S` seconds."""
    still.resize(*size)
    messages = rig_of(2)
    following = {"following_error_rad": [0.01, 0.02], "following_limit_rad": [0.05, 0.05]}
    messages["palm/motion"] |= following
    opened(still, bus, messages)
    still.until(lambda: still.shows("jog"), "the jog pad")
    handle = still.driver.find_element("css selector", "[aria-label='Turn palm 1 forward while held']")
    still.until(handle.is_enabled, "the handle to apply")
    still.script("arguments[0].scrollIntoView({ block: 'center' })", handle)
    where = "return JSON.stringify(['[data-command=stop]', '.handle', '#explore', '#plans'].map((name) =>"
    where += " document.querySelector(name).getBoundingClientRect()))"
    before = still.script(where)
    time.sleep(0.7)
    still.watch_shifts()
    ActionChains(still.driver).click_and_hold(handle).perform()
    begun = time.monotonic()
    log = {name: [] for name in ("number", "t_s", "kind", "name", "severity", "who", "text")}
    jogs = -1
    for step in itertools.count():
        now = time.monotonic()
        if step % 8 == 7:  # on a machine that delays page or bus for long the jog ends
            held, jogs = jogs, sum(asked["cmd"] == "jog" for asked in bus.asked)
            if jogs == held:
                ActionChains(still.driver).release().click_and_hold(handle).perform()
        if now > begun + float(os.environ.get("PALMD_SHIFT_S", "3.5")):
            break
        codes = HINTS[: step % (1 + len(HINTS))]
        messages["palm/state"] |= {
            "faults": codes, "severities": ["note"] * len(codes), "texts": codes, "since_s": now - begun,
            "hints": ["what to do about it, in some more words " * (1 + i % 3) for i in range(len(codes))],
            "exploring": bool(step // 8 % 2), "explored_s": float(step), "coverage": step % 100 / 100,
            "coverage_goal": 0.95, "reachable": 0.9, "reason": "the reason for all that " * (step % 5),
            "unattended": bool(step // 3 % 2),
        }  # fmt: skip
        messages["palm/rig"] = {"contradictions": [f"pad {i}'s zero seems off: do something" for i in range(step % 4)]}
        entry = (step, now, "fault", "loop-overrun", "note", "", "the control loop missed a deadline " * (1 + step % 4))
        for name, value in zip(log, entry, strict=True):
            log[name] = [*log[name], value][-50:]
        messages["palm/log"] = log
        estimate = messages["palm/estimate"]
        estimate |= {
            "valid": step % 10 < 8,
            "nis": 10.0 ** (step % 3),
            "mass_kg": 0.001 * 10 ** (step % 4),
            "object": step,
        }
        estimate |= {
            name: value * -1.7 % 11.0 for name, value in estimate.items() if name.endswith(("_rad", "_m", "_n"))
        }
        following["following_error_rad"] = [0.01 * (step % 9), -0.02]
        messages["palm/motion"] |= following
        time.sleep(0.15)
    ActionChains(still.driver).release().perform()
    assert sum(asked["cmd"] == "jog" for asked in bus.asked) > 12
    assert still.shifts() == []
    assert still.script(where) == before


def test_axe_finds_no_accessibility_problem(still, bus):
    opened(still, bus, rig_of(2, state="hold", faults=["pad1-silent"], severities=["hold"], hints=["see"], texts=["x"]))
    still.until(lambda: still.script(CLOCK_STOPPED), "data that will not be dimmed as old while axe takes its time")
    found = {}
    for size, scheme in itertools.product((LAPTOP, PHONE), ("dark", "light")):
        still.resize(*size)
        still.scheme(scheme)
        still.until(lambda: still.script(COLOURS_SETTLED), "colours that no transition changes any more")
        found[size, scheme] = still.axe(AXE.read_text())
    assert {what: problems for what, problems in found.items() if problems} == {}


def test_a_replay_is_marked_and_cannot_be_commanded(still, bus):
    opened(still, bus, rig_of(2) | {"replay/run": {"path": "a.mcap", "speed": 1.0}})
    still.until(lambda: still.shows("replay"), "the badge")
    still.until(lambda: still.enabled() == set(), "no commands")
    assert "recorded run" in still.text("authority")


def test_past_events_are_listed_newest_first(still, bus):
    now = time.monotonic()
    log = {"number": [0, 1], "t_s": [now - 100.0, now], "kind": ["state", "command"], "name": ["hold", "start"],
           "severity": ["", ""], "who": ["", "page"],
           "text": ["tracking -> hold: fault pad1-silent", "done"]}  # fmt: skip
    bus.messages = rig_of(2)
    opened(still, bus, bus.messages)
    rows = still.script(
        "const done = arguments; return import('/events.js').then(({ lately }) => lately(done[0], done[1]))", log, now
    )
    assert [row["text"] for row in rows] == ["start, by page: done", "tracking -> hold: fault pad1-silent"]
    assert [row["ago"] for row in rows] == ["0 s ago", "100 s ago"]


def test_a_body_in_the_hand_is_not_drawn_through_the_pad(still, bus):
    """A disc of 20 mm held 12 mm beside its centre: the pivot is 32 mm above its lowest point, or 8 mm."""
    opened(still, bus, rig_of(2))
    theta = np.arange(360) * (2 * np.pi / 360)
    disc = {"theta_rad": theta.tolist(), "h_m": (0.02 + 0.012 * np.cos(theta)).tolist()}
    off, high = {"z_m": 0.02, "touch1": False}, {"z_m": 0.033, "touch1": False}
    down = {"psi_rad": -np.pi / 2}, {"psi_rad": np.pi / 2 + 6 * np.pi}
    truths = [off | down[0], off | down[1], high | down[0], off | down[0] | {"touch1": True}]
    clear = still.script(
        "const [disc, truths] = arguments;"
        "return import('/pivotscene.js').then(({ clear }) => truths.map((truth) => clear(disc, truth)))",
        disc, truths,
    )  # fmt: skip
    assert clear == [False, True, True, True]


def test_the_drawn_outline_is_the_supports_envelope(still):
    """x = h n + h′ n′ of an ellipse whose first harmonic is not zero, against the ellipse itself."""
    a, b, x0, y0 = 0.024, 0.017, 0.002, -0.001
    theta = np.arange(360) * (2 * np.pi / 360)
    n = np.array([np.cos(theta), np.sin(theta)])
    support = np.hypot(a * n[0], b * n[1])
    h = support + x0 * n[0] + y0 * n[1]
    still.open()
    points = still.script(
        "const [theta, h] = arguments; return import('/geometry.js').then(({ outline }) => {"
        "const { x, y } = outline(theta, h); return [[...x], [...y]]; })",
        theta.tolist(), h.tolist(),
    )  # fmt: skip
    truth = np.array([x0 + a**2 * n[0] / support, y0 + b**2 * n[1] / support])
    third = np.fft.ifft((1j * np.fft.fftfreq(360, 1 / 360)) ** 3 * np.fft.fft(h)).real
    most = 1.1 * np.abs(third).max() * (2 * np.pi / 360) ** 2 / 6  # error of a central difference
    assert np.abs(np.array(points) - truth).max() < most
