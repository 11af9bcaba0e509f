"""The documentation as a site: built without a warning, loads nothing external, and is searchable from the disk."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from browser_page import browser
from selenium.webdriver.common.by import By
from selenium.webdriver.support.wait import WebDriverWait

ROOT = Path(__file__).parents[2]
FETCHED = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src", "object": "data"}
ELSEWHERE = ("http:", "https:", "//")


class Page(HTMLParser):
    """The addresses that a browser loads for a page."""

    def __init__(self, text):
        super().__init__()
        self.fetched = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag in FETCHED and attributes.get(FETCHED[tag]) and attributes.get("rel") != "canonical":
            self.fetched.append(attributes[FETCHED[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_no_page_loads_anything_external(site):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 60
    for page in pages:
        fetched = Page(page.read_text()).fetched
        assert fetched
        assert [each for each in fetched if each.startswith(ELSEWHERE)] == [], page
        for each in fetched:
            assert page.name == "404.html" or (page.parent / each.partition("?")[0]).exists(), f"{page}: {each}"
    for sheet in site.rglob("*.css"):
        assert re.findall(r"(?:@import|url\()\s*[\"']?(?:https?:)?//", sheet.read_text()) == [], sheet


def test_the_notebook_is_shown_as_it_runs(site):
    page = (site / "start/first-notebook.html").read_text()
    assert re.search(r"valid from .* on, .*% of all ticks", re.sub("<[^>]*>", "", page))
    assert len(re.findall(r'<img [^>]*src="first-notebook-\d+\.svg"', page)) >= 3


def test_the_library_is_documented_from_its_docstrings(site):
    page = re.sub("<[^>]*>", "", (site / "reference/api.html").read_text())
    for words in ("reconstruct", "Raises", "OutlineData", "DataTable"):
        assert words in page


def test_the_site_can_be_searched_from_the_disk(site):
    with browser() as driver:
        driver.get((site / "index.html").as_uri())
        WebDriverWait(driver, 60).until(lambda b: b.find_elements(By.CSS_SELECTOR, "input.md-search__input"))
        field = driver.find_element(By.CSS_SELECTOR, "input.md-search__input")
        driver.execute_script("arguments[0].focus()", field)
        field.send_keys("dead man")
        results = ".md-search-result__item a"
        WebDriverWait(driver, 120).until(lambda b: b.find_elements(By.CSS_SELECTOR, results))
        loud = [line["message"] for line in driver.get_log("browser") if line["level"] == "SEVERE"]
        assert loud == []
