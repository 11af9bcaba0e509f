"""The report of a run: a complete page and PDF for any run, and a one-line error if that is impossible."""

import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import reported
import synthetic_runs
from matplotlib.figure import Figure

from palmd import report as room
from palmd.cli import main
from palmd.console.extras import install_line
from palmd.messages import rig_fields
from palmd.quantities import ESTIMATE, LOOP, RIG
from palmd.report.html import as_html
from palmd.report.pdf import as_pdf
from palmd.report.sections import CaptionedFigure, Report, rendered, report_of
from palmd.report.series import TopicSeries
from palmd.system.rig_constants import RIG_NAMES

VOID = {"meta", "br", "hr", "img", "link", "input"}


def report(folder, messages, **how):
    return report_of(synthetic_runs.series(folder, messages, **how))


def titles(made):
    return [section.title for section in made.sections]


def said(made):
    return dict(made.facts)


class Page(HTMLParser):
    """Collects tags, names and references."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.references, self.tags, self.text = [], [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.look(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.look(tag, attrs)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    def look(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value)
            if name in ("src", "href", "xlink:href", "data", "action"):
                self.references.append(value)
            self.references += re.findall(r"url\((.*?)\)", value or "")


def test_the_page_is_complete_and_loads_nothing_external():
    page = reported.page().read_text()
    read = Page(page)
    assert read.open == []
    assert read.tags.count("svg") == read.tags.count("figure") == 10
    assert not {"link", "img", "iframe", "object"} & set(read.tags)
    assert read.tags.count("script") == 2  # the run's data, and the player
    assert not re.search(
        r"fetch\(|XMLHttp|WebSocket|import\b", "".join(re.findall("<script>(.*?)</script>", page, re.S))
    )
    assert len(read.ids) == len(set(read.ids))
    assert {reference.lstrip("#") for reference in read.references} <= set(read.ids)
    assert all(reference.startswith("#") for reference in read.references)
    assert set(re.findall(r"https?://[^\"\s<]+", page)) == {
        "http://www.w3.org/2000/svg",
        "http://www.w3.org/1999/xlink",
    }
    assert "@import" not in page


def test_the_page_describes_the_run():
    text = " ".join(" ".join(Page(reported.page().read_text()).text).split())
    for words in (
        "2026-11-21 22:30:05 UTC", "2.5 s", "observer shape", "complete", "2; with a valid estimate: 1, 2",
        "20 of palm/contact, 20 of palm/estimate", "e_h 4 µm", "Hausdorff 4", "r₁ 75%, r₂ 100%",
        "mend <arm-late>", "mend <pad1-garbled>", "to the end", "bad header", "counts_per_mm: 7.874",
    ):  # fmt: skip
        assert words in text


def test_the_pdf_has_its_pages_and_embeds_its_fonts(tmp_path):
    target = tmp_path / "report.pdf"
    assert main(["report", str(reported.run()), "-o", str(target)]) == 0
    data = target.read_bytes()
    assert data.startswith(b"%PDF-")
    assert data.rstrip().endswith(b"%%EOF")
    pages = int(re.search(rb"/Type /Pages[^>]*?/Count (\d+)|/Count (\d+)", data).group(0).split()[-1])
    assert 8 <= pages <= 12
    assert b"/FontFile2" in data
    assert b"/Type3" not in data
    assert b"/Subtype /Image" not in data


def test_the_same_run_gives_the_same_page_and_pdf(tmp_path):
    whole = report(tmp_path, synthetic_runs.messages(1.0))
    made = Report(whole.title, whole.facts, (whole.sections[0], *whole.sections[-3:]))
    assert as_html(made) == as_html(made)
    assert as_pdf(made) == as_pdf(made)


def test_a_run_without_truth_and_outline(tmp_path):
    made = report(tmp_path, synthetic_runs.messages(1.5, observer="extended", shapes=False, truths=False))
    assert "Coverage" not in titles(made)
    assert "this observer estimates no outline" in said(made)["outcome"]
    sentences = [
        part.caption for section in made.sections for part in section.parts if isinstance(part, CaptionedFigure)
    ]
    assert not any("truth" in caption for caption in sentences)
    draw(made)


def test_a_run_without_valid_estimates(tmp_path):
    made = report(tmp_path, synthetic_runs.messages(0.9, valid=False))
    assert said(made)["outcome"] == "no estimate was valid"
    assert said(made)["objects"] == "one, never valid"
    assert "Reconstruction through time" not in titles(made)
    draw(made)


def test_a_run_of_a_single_tick(tmp_path):
    draw(report(tmp_path, synthetic_runs.messages(0.01)))


def test_a_run_of_estimates_only(tmp_path):
    made = report(tmp_path, [each for each in synthetic_runs.messages(1.0) if each[0] == ESTIMATE.name])
    assert titles(made)[-3:] == ["Faults", "Messages", "Configuration"]
    assert not {"Motion", "Loop"} & set(titles(made))
    draw(made)


def test_mis_calibrated_constants_at_the_end_are_listed(tmp_path):
    messages = [*synthetic_runs.messages(1.0)]
    sds, none = np.full(len(RIG_NAMES), 1.0), np.zeros(len(RIG_NAMES))
    off, not_off = (rig_fields(np.full(len(RIG_NAMES), value), sds, 2.0 * sds, none) for value in (9.0, 0.0))
    for said, count in (([off], len(RIG_NAMES)), ([off, not_off], 0)):
        made = report(tmp_path, [*messages, *((RIG.name, fields, 1.0, i) for i, fields in enumerate(said))])
        (section,) = [section for section in made.sections if section.title == "Rig"]
        assert len(section.parts[0].rows) == count


def test_unknown_numbers_are_shown_as_unknown(tmp_path):
    messages = list(synthetic_runs.messages(1.5))
    for topic, fields, t, _ in messages:
        for name in [name for name, value in fields.items() if isinstance(value, float)]:
            if topic not in (LOOP.name, "rig/object") and (t < 0.2 or name in ("mu", "nis", "observability")):
                fields[name] = float("nan")
    draw(report(tmp_path, messages))


def test_a_truncated_run_is_marked(tmp_path):
    made = report(tmp_path, synthetic_runs.messages(0.3), finish=False)
    assert "not finished" in said(made)["recording"]


def test_a_figure_of_a_long_run_stays_small(tmp_path):
    read = synthetic_runs.series(tmp_path, synthetic_runs.messages(2.0))
    state = next(section for section in report_of(read).sections if section.title == "State").parts[0]

    def points_of(figure):
        return sum(len(line.get_xdata()) for axes in figure.axes for line in axes.lines)

    short = points_of(rendered(state))
    random = np.random.default_rng(0)
    columns = {
        name: np.concatenate([column, column[-1] + random.normal(0, 1e-3, 20000)])
        for name, column in read.estimate.columns.items()
    }
    columns["valid"][:] = 1.0
    read = replace(read, estimate=TopicSeries(np.arange(20200) * 0.01, columns))
    long = next(section for section in report_of(read).sections if section.title == "State").parts[0]
    assert points_of(rendered(long)) < 12 * 3 * 3 * 300 + short


def draw(made):
    """Everything except writing, which takes most of the time."""
    for section in made.sections:
        for part in section.parts:
            if isinstance(part, CaptionedFigure):
                part.draw(Figure(figsize=(7.1, part.height_in), layout="constrained"))


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["nothing.mcap"], "nothing.mcap: no such file; `palmd runs FOLDER` lists the recordings in a folder"),
        (["prose.mcap"], "prose.mcap: is not an MCAP file"),
        (["RUN", "-o", "report.txt"], "report.txt: the suffix of a report must be .html or .pdf"),
        (["RUN", "-o", "nowhere/report.html"], "nowhere/report.html: cannot be written: there is no folder nowhere"),
        (["RUN", "-o", "folder.pdf"], "folder.pdf: cannot be written: Is a directory"),
    ],
)
def test_bad_input_is_a_one_line_error(tmp_path, monkeypatch, capsys, arguments, line):
    monkeypatch.chdir(tmp_path)
    Path("prose.mcap").write_text("not a run\n")
    Path("folder.pdf").mkdir()
    monkeypatch.setattr("palmd.cli.report._render", lambda _, as_pdf: b"%PDF" if as_pdf else b"")
    assert main(["report", *[str(reported.run()) if each == "RUN" else each for each in arguments]]) == 1
    assert capsys.readouterr().err == line + "\n"


def test_a_run_is_never_overwritten_by_its_report(tmp_path, capsys):
    run = tmp_path / "run.html"
    run.write_bytes(reported.run().read_bytes())
    assert main(["report", str(run), "-o", str(run)]) == 1
    assert "is the input file" in capsys.readouterr().err
    assert run.read_bytes() == reported.run().read_bytes()


def test_without_matplotlib_the_error_says_what_to_install(tmp_path, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("palmd.report.")]:
        if name.rpartition(".")[2] not in ("command", "series", "words"):
            monkeypatch.delitem(sys.modules, name)
            monkeypatch.delattr(room, name.rpartition(".")[2], raising=False)
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.setitem(sys.modules, name, None)
    assert main(["report", str(reported.run()), "-o", str(tmp_path / "report.html")]) == 1
    assert (
        capsys.readouterr().err
        == f"the report needs matplotlib, which is not installed: {install_line('matplotlib', 'report')}\n"
    )
    assert not (tmp_path / "report.html").exists()


def test_the_default_name_is_the_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("palmd.cli.report._render", lambda _, as_pdf: b"pdf" if as_pdf else b"html")
    assert main(["report", str(reported.run())]) == 0
    assert Path(f"{reported.run().stem}.html").read_bytes() == b"html"
    assert capsys.readouterr().out.startswith(f"{reported.run().stem}.html: valid ")
