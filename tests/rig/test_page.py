"""The live page in a real browser, on `palmd demo`: what it shows, what its buttons do, and when it calls data old."""

import os
import re
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from harness import GENEROUS_S, Process, wait
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

pytestmark = pytest.mark.rig

STALE_S = 1.0
SETTLING_S = 60.0
DOUBLE_CLICK_S = 0.5
ATTEMPTS = 8
ESCAPE = "\ue00c"
LAPTOP, PHONE = (1366, 768), (375, 740)
SEVERE = "SEVERE"


class DisturbedError(Exception):
    """A fault, or a daemon that was kept from its work."""


class Page:
    """The demo's page in a headless browser."""

    def __init__(self, driver, url):
        self._driver, self._url = driver, url

    def open(self, token=True):
        self.leave()
        self.errors()  # are those of a page before
        self._driver.get(self._url if token else self._url.partition("#")[0])

    def leave(self):
        self._driver.get("about:blank")

    def script(self, text, *arguments):
        return self._driver.execute_script(text, *arguments)

    def text(self, name):
        return self.script("return document.getElementById(arguments[0]).textContent", name)

    def shows(self, name):
        return self.script("return !document.getElementById(arguments[0]).hidden", name)

    def enabled(self):
        """The commands that can be given."""
        found = self.script("return [...document.querySelectorAll('button:enabled')].map((b) => b.dataset.command)")
        return set(found)

    def press(self, command):
        self._driver.find_element(By.CSS_SELECTOR, f"button[data-command={command}]").click()

    def double_click(self, command):
        """Two clicks at once, which no driver is quick enough for."""
        text = "const button = document.querySelector(arguments[0]); button.click(); button.click()"
        self.script(text, f"button[data-command={command}]")

    def press_twice(self, command):
        """As a person does: not so fast that it might be a double click."""
        self.press(command)
        time.sleep(DOUBLE_CLICK_S)
        self.press(command)

    def set_going(self):
        """Until the palms move, whatever state they are in."""

        def look():
            for command in sorted(self.enabled() & {"reset", "arm", "start"}):
                self.press_twice(command) if command != "reset" else self.press(command)
            return self.text("state") == "tracking" and "not running" not in self.text("plan")

        self.until(look, "the palms to move")

    def key(self, key):
        self._driver.switch_to.active_element.send_keys(key)

    def drawn(self, hue):
        """How many of the scene's pixels are green as the estimate, blue as palm 1, or red as palm 2's orange."""
        return self.script(
            """
            const scene = document.getElementById("scene");
            const { data } = scene.getContext("2d").getImageData(0, 0, scene.width, scene.height);
            const [one, other, third] = { green: [1, 0, 2], blue: [2, 0, 1], red: [0, 1, 2] }[arguments[0]];
            let count = 0;
            for (let i = 0; i < data.length; i += 4) {
              const more = [data[i + one] - data[i + other], data[i + one] - data[i + third]];
              count += data[i + 3] > 100 && more[0] > 40 && more[1] > 10;
            }
            return count;
            """,
            hue,
        )

    def until(self, condition, what, patience_s=GENEROUS_S):
        shown = "return document.body.innerText"
        return wait(condition, lambda: f"{what}; it shows: {self.script(shown)}", patience_s=patience_s)

    def calmly(self, condition, what):
        """As `until`, but raises DisturbedError as soon as something else than the test stops the palms."""

        def look():
            if self.text("grave") or self.text("state") == "fault" or self.shows("stale"):
                raise DisturbedError
            return condition()

        self.until(look, what)

    def resize(self, width, height):
        shape = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self._driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", shape)

    def errors(self):
        return [entry["message"] for entry in self._driver.get_log("browser") if entry["level"] == SEVERE]


@pytest.fixture(scope="module")
def driver():
    chromium, chromedriver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and chromedriver):
        pytest.fail("the live page's test needs a browser: sudo apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1366,768"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with webdriver.Chrome(options=options, service=Service(chromedriver)) as browser:
        yield browser


@pytest.fixture
def demo(tmp_path):
    process = Process(["demo", "--no-browser", "--no-record", "--seed", "3"], tmp_path)
    yield process
    process.stop()


@pytest.fixture
def page(driver, demo):
    def url():
        assert demo.alive, demo.all_said
        return re.search(r"http://127\.0\.0\.1:\d+/#token=\S+", demo.all_said)

    page = Page(driver, wait(url, lambda: demo.all_said)[0])
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


def test_it_shows_the_object_and_does_what_is_pressed(page):
    page.until(lambda: page.drawn("green") > 300, "the outline", SETTLING_S)
    assert page.shows("key-truth")
    assert min(page.drawn("blue"), page.drawn("red")) > 300
    page.until(lambda: float(page.text("fps").split()[0]) > 10, "a moving picture")
    unless_disturbed(page, hold_and_start)
    unless_disturbed(page, stop_and_arm)
    assert page.errors() == []


def hold_and_start(page):
    page.calmly(lambda: page.enabled() == {"hold", "stop"}, "the commands while running")
    page.press("hold")
    page.calmly(lambda: page.text("answer") == "hold: done", "the answer")
    page.calmly(lambda: page.text("state") == "hold", "the hold")
    page.calmly(lambda: page.enabled() == {"start", "hold", "stop"}, "the commands while held")
    page.double_click("start")  # is one press
    page.calmly(lambda: "press again" in page.text("answer"), "the guard")
    page.calmly(lambda: page.text("answer") == "", "the first press to be forgotten")
    page.calmly(lambda: page.text("state") == "hold", "the hold, still")
    page.press_twice("start")
    page.calmly(lambda: page.text("answer") == "start: done", "the answer")
    page.calmly(lambda: page.text("state") == "tracking", "the motion")


def stop_and_arm(page):
    page.key(ESCAPE)
    page.calmly(lambda: page.text("state") == "ready", "the stop")
    page.calmly(lambda: page.enabled() == {"arm", "stop"}, "the commands while ready")
    page.key("a")
    time.sleep(DOUBLE_CLICK_S)
    page.key("a")
    page.calmly(lambda: page.text("state") == "tracking", "the arm to follow")


def unless_disturbed(page, story):
    """The story, told again when a fault or a stall came in between, as they do on a machine with much else to do."""
    for _ in range(ATTEMPTS):
        page.set_going()
        try:
            return story(page)
        except DisturbedError:
            continue
    raise AssertionError(f"disturbed {ATTEMPTS} times: {page.text('grave')}")


def test_a_phone_sees_it_all_and_may_watch_without_the_token(page):
    page.resize(*PHONE)
    page.script("sessionStorage.clear()")
    page.open(token=False)
    page.until(lambda: not page.shows("stale"), "anything")
    page.until(lambda: "Watching only" in page.text("authority"), "what it may do")
    assert page.enabled() == set()
    assert page.script("return document.documentElement.scrollWidth") == PHONE[0]
    assert page.script(
        "return [...document.querySelectorAll('canvas')].every((c) => c.getBoundingClientRect().right <= 375)"
    )
    assert page.errors() == []


def test_it_says_so_within_a_second_when_the_daemon_is_gone(page, demo):
    number = child(demo, "run")

    def seconds_to_tell(signal_number):
        t_begin = time.monotonic()
        os.kill(number, signal_number)
        page.until(lambda: page.shows("stale"), "stale")
        return time.monotonic() - t_begin

    def paused():
        """Stands still for a while, as if the machine did; a slow browser's first time is not counted."""
        took = seconds_to_tell(signal.SIGSTOP)
        assert page.text("stale-why") == "Stale: palmd says nothing."
        assert page.enabled() == {"stop"}
        os.kill(number, signal.SIGCONT)
        page.until(lambda: not page.shows("stale"), "fresh data")
        return took

    assert min(paused() for _ in range(3)) < STALE_S
    assert seconds_to_tell(signal.SIGKILL) < STALE_S
    page.until(lambda: "Stale: no connection" in page.text("stale-why"), "the end of the demo")
    page.until(lambda: page.enabled() == set(), "no commands without a connection")


def test_its_outline_is_the_supports_envelope(driver, tmp_path):
    """x = h n + h′ n′ of an ellipse whose first harmonic is not zero, against the ellipse itself."""
    a, b, x0, y0 = 0.024, 0.017, 0.002, -0.001
    theta = np.arange(360) * (2 * np.pi / 360)
    n = np.array([np.cos(theta), np.sin(theta)])
    support = np.hypot(a * n[0], b * n[1])
    h = support + x0 * n[0] + y0 * n[1]
    text = """
        const done = arguments[arguments.length - 1];
        import("/geometry.js").then(({ outline }) => {
          const { x, y } = outline(arguments[0], arguments[1]);
          done([[...x], [...y]]);
        });
    """
    server = Process(["view", "--no-browser", "--port", "0"], tmp_path)
    try:
        driver.get(server.first_line())
        points = np.array(driver.execute_async_script(text, theta.tolist(), h.tolist()))
    finally:
        driver.get("about:blank")
        assert server.end() == 0
    truth = np.array([x0 + a**2 * n[0] / support, y0 + b**2 * n[1] / support])
    third = np.fft.ifft((1j * np.fft.fftfreq(360, 1 / 360)) ** 3 * np.fft.fft(h)).real
    assert (
        np.abs(points - truth).max() < 1.1 * np.abs(third).max() * (2 * np.pi / 360) ** 2 / 6
    )  # of a central difference
