"""The live page in a real browser on `palmd demo`: its contents, its buttons, and when it marks data as stale."""

import os
import re
import signal
import time
from pathlib import Path

import pytest
from browser_page import DOUBLE_CLICK_S, ESCAPE, LAPTOP, Page, browser
from harness import Process, wait

pytestmark = pytest.mark.rig

STALE_S = 1.0
SETTLING_S = 60.0
ATTEMPTS = 8


class DisturbedError(Exception):
    """A fault, or a delay of the daemon."""


class DemoPage(Page):
    """The demo's page."""

    def set_going(self):
        """Brings the palms to move from any state."""

        def look():
            for command in sorted(self.enabled() & {"reset", "arm", "start"}):
                self.press_twice(command) if command != "reset" else self.press(command)
            return self.text("state") == "tracking" and "not running" not in self.text("plan")

        self.until(look, "the palms to move")

    def calmly(self, condition, what):
        """As `until`, but raises DisturbedError as soon as a fault stops the palms."""

        def look():
            if self.text("grave") or self.text("state") == "fault" or self.shows("stale"):
                raise DisturbedError
            return condition()

        self.until(look, what)


@pytest.fixture(scope="module")
def driver():
    with browser() as one:
        yield one


@pytest.fixture(scope="module")
def started():
    """All demos so far."""
    demos = []
    yield demos
    for each in demos:
        each.stop()


@pytest.fixture
def demo(started, tmp_path):
    """The demo of the test before, if that has not ended it."""
    if not (started and started[-1].alive):
        started.append(Process(["demo", "--no-browser", "--no-record", "--seed", "3"], tmp_path))
    return started[-1]


@pytest.fixture
def page(driver, demo):
    def url():
        assert demo.alive, demo.all_said
        return re.search(r"http://127\.0\.0\.1:\d+/#token=\S+", demo.all_said)

    page = DemoPage(driver, wait(url, lambda: demo.all_said)[0])
    page.resize(*LAPTOP)
    page.open()
    page.until(lambda: not page.shows("stale"), "anything")
    yield page
    page.leave()


def child(demo, command):
    """The number of the demo's process that runs this command."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            line = (entry / "cmdline").read_bytes().split(b"\0") if (entry / "cmdline").exists() else []
            if command.encode() in line and parent(entry) == demo.number:
                return int(entry.name)
    raise AssertionError(f"no {command} among the demo's processes: {demo.all_said}")


def parent(entry):
    return int((entry / "stat").read_text().rpartition(")")[2].split()[1])


def test_it_shows_the_object_and_executes_commands(page):
    page.until(lambda: page.object_drawn() > 3000, "the object", SETTLING_S)
    page.until(lambda: page.shows("key-truth"), "the rig's truth")
    page.until(lambda: min(page.drawn("blue"), page.drawn("red")) > 300, "both palms")
    page.until(lambda: float(page.text("fps").split()[0]) > 10, "a moving picture")
    unless_disturbed(page, hold_and_start)
    unless_disturbed(page, stop_and_arm)
    assert page.errors() == []


def hold_and_start(page):
    page.calmly(lambda: page.enabled() == {"hold", "stop"}, "the commands while running")
    page.press("hold")
    page.calmly(lambda: page.text("answer") == "hold: done", "the answer")
    page.calmly(lambda: page.text("state") == "hold", "the hold")
    page.calmly(lambda: page.enabled() == {"start", "stop"}, "the commands while held")
    page.double_click("start")  # counts as one press
    page.calmly(lambda: "press again" in page.text("answer"), "the guard")
    page.calmly(lambda: page.text("answer") == "", "the first press to expire")
    page.calmly(lambda: page.text("state") == "hold", "the hold, still")
    page.press_twice("start")
    page.calmly(lambda: page.text("answer") == "start: done", "the answer")
    page.calmly(lambda: page.text("state") == "tracking", "the motion")


def stop_and_arm(page):
    page.key(ESCAPE)
    page.calmly(lambda: page.text("state") == "ready", "the stop")
    page.calmly(lambda: page.enabled() == {"arm"}, "the commands while ready")
    page.key("a")
    time.sleep(DOUBLE_CLICK_S)
    page.key("a")
    page.calmly(lambda: page.text("state") == "tracking", "the arm to follow")


def unless_disturbed(page, story):
    """Runs the scenario, and repeats it after a fault or a delay, as they occur on a busy machine."""
    for _ in range(ATTEMPTS):
        page.set_going()
        try:
            return story(page)
        except DisturbedError:
            continue
    raise AssertionError(f"disturbed {ATTEMPTS} times: {page.text('grave')}")


def test_it_reports_a_lost_daemon_within_a_second(page, demo):
    number = child(demo, "run")

    def seconds_until_stale(signal_number):
        t_begin = time.monotonic()
        os.kill(number, signal_number)
        page.until(lambda: page.shows("stale"), "stale")
        return time.monotonic() - t_begin

    def paused():
        """Pauses the daemon for a while; the minimum of several excludes the browser's first, slow reaction."""
        took = seconds_until_stale(signal.SIGSTOP)
        assert page.text("stale-why") == "Stale: no data from palmd."
        assert page.enabled() == {"stop"}
        os.kill(number, signal.SIGCONT)
        page.until(lambda: not page.shows("stale"), "fresh data")
        return took

    assert min(paused() for _ in range(3)) < STALE_S
    assert seconds_until_stale(signal.SIGKILL) < STALE_S
    page.until(lambda: page.shows("ended"), "the end of the demo")
    assert page.text("ended-title") == "The demo has ended"
    assert "Disconnected" in page.text("stale-why")
    assert re.search(r"outline known\d+\s%", page.text("summary"))
    page.until(lambda: page.enabled() == set(), "no commands without a connection")
