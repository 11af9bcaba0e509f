"""The live page in a headless browser: what it shows, and how a person presses its buttons."""

import shutil
import time

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

GENEROUS_S = 20.0  # for a slow machine
DOUBLE_CLICK_S = 0.5
ESCAPE = "\ue00c"
LAPTOP, SMALL, PHONE, WIDE = (1366, 768), (1024, 625), (375, 740), (2560, 1300)
SEVERE = "SEVERE"


class Page:
    """The page at an address, in a browser."""

    def __init__(self, driver, url):
        self.driver, self._url = driver, url

    def open(self, token=True):
        self.leave()
        self.errors()  # discards errors of an earlier page
        self.driver.get(self._url if token else self._url.partition("#")[0])

    def leave(self):
        self.driver.get("about:blank")

    def script(self, text, *arguments):
        return self.driver.execute_script(text, *arguments)

    def text(self, name):
        return self.script("return document.getElementById(arguments[0]).textContent", name)

    def shows(self, name):
        return self.script("return !document.getElementById(arguments[0]).hidden", name)

    def enabled(self):
        """The commands that can be given."""
        text = "return [...document.querySelectorAll('#commands button:enabled')].map((b) => b.dataset.command)"
        found = self.script(text)
        return set(found)

    def press(self, command):
        self.driver.find_element(By.CSS_SELECTOR, f"button[data-command={command}]").click()

    def double_click(self, command):
        """Two clicks within one script, faster than a driver can click."""
        text = "const button = document.querySelector(arguments[0]); button.click(); button.click()"
        self.script(text, f"button[data-command={command}]")

    def press_twice(self, command):
        """Two presses at a person's pace, too slow for a double click."""
        self.press(command)
        time.sleep(DOUBLE_CLICK_S)
        self.press(command)

    def key(self, key):
        self.driver.switch_to.active_element.send_keys(key)

    def drawn(self, hue):
        """Number of pixels of the scene in a hue: green (well-known outline), or blue, red (orange), purple (palms)."""
        return self.script(
            """
            const scene = document.getElementById("scene");
            const { data } = scene.getContext("2d").getImageData(0, 0, scene.width, scene.height);
            const orders = { green: [1, 0, 2], blue: [2, 0, 1], red: [0, 1, 2], purple: [2, 1, 0] };
            const [one, other, third] = orders[arguments[0]];
            let count = 0;
            for (let i = 0; i < data.length; i += 4) {
              const more = [data[i + one] - data[i + other], data[i + one] - data[i + third]];
              const violet = data[i] > data[i + 1] + 20; // which blue is not
              count += data[i + 3] > 100 && more[0] > 40 && more[1] > 10 && (one !== 2 || violet === (other === 1));
            }
            return count;
            """,
            hue,
        )

    def object_drawn(self):
        """Number of pixels filled with the object's translucent colour."""
        return self.script(
            """
            const scene = document.getElementById("scene");
            const mixed = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
            const style = getComputedStyle(document.documentElement);
            const fills = [1, 0.45].map((share) => { // valid or not
              for (const [name, alpha] of [["--panel", 1], ["--estimate-fill", share]]) {
                mixed.globalAlpha = alpha;
                mixed.fillStyle = style.getPropertyValue(name).trim();
                mixed.fillRect(0, 0, 1, 1);
              }
              return mixed.getImageData(0, 0, 1, 1).data;
            });
            const { data } = scene.getContext("2d").getImageData(0, 0, scene.width, scene.height);
            let count = 0;
            for (let i = 0; i < data.length; i += 4) {
              count += fills.some((fill) => [0, 1, 2].every((k) => Math.abs(data[i + k] - fill[k]) < 2));
            }
            return count;
            """
        )

    def until(self, condition, what, patience_s=GENEROUS_S):
        """Waits until `condition` returns something true; returns it."""
        t_end = time.monotonic() + patience_s
        while not (found := condition()):
            shown = "return document.body.innerText"
            assert time.monotonic() < t_end, f"in vain for {what}; it shows: {self.script(shown)}"
            time.sleep(0.05)
        return found

    def resize(self, width, height):
        shape = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", shape)

    def scheme(self, scheme):
        """Light or dark."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def axe(self, source):
        """Accessibility violations that axe-core (its source is given) finds."""
        self.script(source)
        return self.driver.execute_async_script(
            """
            const done = arguments[arguments.length - 1];
            axe.run(document).then(({ violations }) => done(violations.map(({ id, nodes }) =>
              [id, ...nodes.map(({ target, failureSummary }) => `${target}: ${failureSummary}`)])));
            """
        )

    def watch_shifts(self):
        """Starts to collect the browser's layout-shift entries, including those after an input."""
        self.script(
            """
            window.shifts = [];
            const begun = performance.now();
            new PerformanceObserver((list) => {
              for (const { value, startTime, sources } of list.getEntries()) {
                const when = (startTime - begun) / 1e3;
                window.shifts.push([value, when, ...sources.map(({ node, previousRect, currentRect }) => {
                  const one = node?.nodeType === 3 ? node.parentElement : node;
                  const [was, is] = [previousRect, currentRect];
                  return `${one?.tagName}#${one?.id}.${one?.className} ${was.x},${was.y} -> ${is.x},${is.y}`;
                })]);
              }
            }).observe({ type: "layout-shift" });
            """
        )

    def shifts(self):
        """Layout shifts since `watch_shifts`: [size, time (s), what moved…]."""
        return self.script("return window.shifts")

    def errors(self):
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == SEVERE]


def browser():
    """A browser as a context manager."""
    chromium, chromedriver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and chromedriver):
        pytest.fail("the live page's test needs a browser: sudo apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1366,768"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(options=options, service=Service(chromedriver))
