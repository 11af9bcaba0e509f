"""The run played back on the report's page: the data given to the page, and playback in a browser."""

import json
import math
import re

import numpy as np
import pytest
import reported
import synthetic_runs
from browser_page import browser
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.wait import WebDriverWait

from palmd.report import player_data as player
from palmd.report.body import pose_at


def series(folder, **how):
    return synthetic_runs.series(folder, synthetic_runs.messages(2.5, **how))


def column(data, name):
    return [row[data["columns"].index(name)] for row in data["frames"]]


def test_frames_are_the_estimates_at_their_times(tmp_path):
    read = series(tmp_path, second_from=1.5)
    data = player.player_data(read)
    t = column(data, "t")
    assert t == sorted(set(t))
    assert max(np.diff(t)) <= 60
    for number in (0, len(t) // 2, len(t) - 1):
        estimate = int(np.argmin(np.abs(read.estimate.t - t[number] * 1e-3)))
        pose = pose_at(read, estimate)
        assert column(data, "way2")[number] == pytest.approx(1e3 * pose.directions[-1], abs=1)
        assert [column(data, "x")[number], column(data, "y")[number]] == pytest.approx(1e6 * pose.centre, abs=1)
        assert column(data, "valid")[number] == read.valid[estimate]
    assert data["truth"].keys() == {"1", "2"}
    json.dumps(data, allow_nan=False)


def test_an_outline_is_never_shown_before_it_was_known_nor_for_another_object(tmp_path):
    read = series(tmp_path, second_from=1.5)
    data = player.player_data(read)
    times = {i: outline.t for i, outline in enumerate(read.outlines)}
    for t, number in zip(column(data, "t"), column(data, "outline"), strict=True):
        if number >= 0:
            assert times[number] * 1e3 <= t + 1
            assert data["outlines"][number]["object"] == (1 if t < 1500 else 2)
    assert len({number for number in column(data, "outline") if number >= 0}) > 5


def test_long_runs_are_thinned(tmp_path, monkeypatch):
    monkeypatch.setattr(player, "MAX_FRAMES", 20)
    monkeypatch.setattr(player, "MAX_OUTLINES", 3)
    data = player.player_data(series(tmp_path))
    assert len(data["frames"]) <= 20
    assert len(data["outlines"]) == 3


def test_a_run_without_outlines_or_truth_can_be_played(tmp_path):
    data = player.player_data(series(tmp_path, observer="extended", shapes=False, truths=False))
    assert data["outlines"] == []
    assert data["truth"] == {}
    assert set(column(data, "outline")) == {-1}


def test_hints_are_escaped_in_the_page():
    data = re.search(r'id="player-data">(.*?)</script>', reported.page().read_text(), re.DOTALL)[1]
    assert "<" not in data
    assert any("<" in hint for _, _, hint in json.loads(data)["faults"])


def words(driver):
    cells = driver.find_elements(By.CSS_SELECTOR, "#player dt, #player dd")
    return dict(zip((c.text for c in cells[::2]), (c.text for c in cells[1::2]), strict=True))


@pytest.fixture
def driver():
    with browser() as started:
        yield started


def test_the_page_is_opened_from_a_file_and_scrubbed_by_keyboard(driver):
    driver.get(reported.page().as_uri())
    slider = driver.find_element(By.CSS_SELECTOR, "#player input")
    picture = "return document.querySelector('#player canvas').toDataURL()"
    slider.send_keys(Keys.HOME)
    first, seen = words(driver), driver.execute_script(picture)
    slider.send_keys(Keys.END)
    last = words(driver)
    assert float(first["time"].split()[0]) < 0.1
    assert float(last["time"].split()[0]) == pytest.approx(2.5, abs=0.1)
    assert driver.execute_script(picture) != seen
    slider.send_keys(Keys.ARROW_LEFT)
    assert words(driver)["time"] != last["time"]
    assert math.isfinite(float(last["touched"].split()[0]))
    slider.send_keys(Keys.HOME)
    button = driver.find_element(By.CSS_SELECTOR, "#player button")
    button.send_keys(Keys.SPACE)
    WebDriverWait(driver, 60).until(lambda b: words(b)["time"] != first["time"])
    assert [line for line in driver.get_log("browser") if line["level"] == "SEVERE"] == []
