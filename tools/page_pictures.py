"""Screenshots of the live page during `palmd demo` with a fixed seed, by a headless browser; figures of its report."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

from palmd.record.run import read_run
from palmd.report.axes import figure_style
from palmd.report.sections import CaptionedFigure, rendered, report_of
from palmd.report.series import series_of

T = TypeVar("T")

SEED = 7
SIZES = {1440: 900, 1024: 625, 2560: 1300, 390: 844}
SCHEMES = ("light", "dark")
START_S, SETTLE_S, EXPLORED = 120.0, 1.0, 0.5
SECTIONS = {"report-outline.svg": "Outline", "report-frames.svg": "Reconstruction through time"}
NAMES = (
    *(f"page-{width}-{scheme}.png" for width in SIZES for scheme in SCHEMES),
    *("page-hold.png", "page-ended.png"),
    *SECTIONS,
)


def take(folder: Path) -> None:
    """Save all pictures into the folder; takes a minute. Raises RuntimeError if the demo does not come far enough."""
    with tempfile.TemporaryDirectory(prefix="palmd-pictures-") as name, _browser() as driver:
        command = [sys.executable, "-m", "palmd", "demo", "--no-browser", "--seed", str(SEED)]
        output = Path(name) / "said"
        with output.open("wb") as out, subprocess.Popen(command, cwd=name, stderr=out, stdout=out) as demo:
            try:
                driver.get(_until(lambda: _found(output, r"http://\S+"), "the page's address"))
                _until(lambda: _known(driver) > EXPLORED, "half of the outline")
                for width, height in SIZES.items():
                    for scheme in SCHEMES:
                        _picture(driver, width, height, scheme, folder / f"page-{width}-{scheme}.png")
                driver.find_element(By.CSS_SELECTOR, "[data-command=hold]").click()
                _picture(driver, 1440, SIZES[1440], "light", folder / "page-hold.png")
            finally:
                demo.send_signal(signal.SIGINT)
                demo.wait(START_S)
            _picture(driver, 1440, SIZES[1440], "light", folder / "page-ended.png")
        _report_figures(Path(_found(output, r"recorded in (\S+)")), folder)  # the run is read as it is needed


def _report_figures(path: Path, folder: Path) -> None:
    run = read_run(path)
    series = series_of(run, run.survey(), lambda _: None)
    for section in report_of(series).sections:
        for file, title in SECTIONS.items():
            if section.title == title:
                plate = next(part for part in section.parts if isinstance(part, CaptionedFigure))
                with figure_style(file):
                    rendered(plate).savefig(folder / file, metadata={"Date": None})


def _browser() -> webdriver.Chrome:
    chromium, chromedriver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and chromedriver):
        raise RuntimeError("pictures of the page need a browser: sudo apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars"):
        options.add_argument(argument)
    return webdriver.Chrome(options=options, service=Service(chromedriver))


def _picture(driver: webdriver.Chrome, width: int, height: int, scheme: str, path: Path) -> None:
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    time.sleep(SETTLE_S)
    driver.save_screenshot(str(path))


def _known(driver: webdriver.Chrome) -> float:
    return float(driver.execute_script("return document.getElementById('known-bar').value"))


def _found(output: Path, pattern: str) -> str:
    found = re.search(pattern, output.read_text(encoding="utf-8"))
    return found[found.lastindex or 0] if found else ""


def _until(look: Callable[[], T], what: str) -> T:
    deadline = time.monotonic() + START_S
    while not (found := look()):
        if time.monotonic() > deadline:
            raise RuntimeError(f"the demo with seed {SEED} did not reach {what} within {START_S:g} s")
        time.sleep(0.1)
    return found
