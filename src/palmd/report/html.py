"""A run's report as one self-contained HTML file with figures as SVG. Needs matplotlib."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from html import escape
from importlib.resources import files
from io import StringIO

from palmd.report import texts
from palmd.report.axes import figure_style
from palmd.report.sections import CaptionedFigure, Player, Report, Section, rendered
from palmd.report.texts import Table

_CSS = """
:root { color-scheme: light; }
body { font: 15px/1.45 system-ui, sans-serif; color: #111; background: #fff; max-width: 180mm; margin: 2em auto;
  padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin: 2em 0 .4em; border-bottom: 1px solid #bbb; }
figure { margin: 1em 0 1.6em; break-inside: avoid; } figure svg { width: 100%; height: auto; display: block; }
figcaption { font-size: .92em; margin-top: .3em; }
table { border-collapse: collapse; font-size: .88em; margin: .8em 0; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .15em .9em .15em 0; border-bottom: 1px solid #e3e3e3;
  overflow-wrap: anywhere; }
.verdict { font-size: 1.15em; font-weight: 600; border-left: 5px solid #888; padding: .2em .7em; }
.verdict.good { border-color: #009e73; } .verdict.impaired { border-color: #e69f00; }
.verdict.failed { border-color: #c0392b; } td:not(:last-child), th:not(:last-child) { white-space: nowrap; }
.facts th { font-weight: 600; white-space: nowrap; }
pre { font-size: .78em; line-height: 1.3; white-space: pre-wrap; }
#player canvas { display: block; } #player p { font-size: .92em; }
#player .controls { display: flex; gap: .8em; margin: .5em 0; } #player input { flex: 1; }
#player button { font: inherit; min-width: 5em; padding: .3em .8em; }
#player dl { columns: 2; font-variant-numeric: tabular-nums; }
#player dt { color: #555; font-size: .85em; break-after: avoid; }
#player dd { margin: 0 0 .4em; overflow-wrap: anywhere; }
@page { margin: 15mm; }
@media print { #player { display: none; }
  body { margin: 0; padding: 0; max-width: none; font-size: 10pt; } h2 { break-after: avoid; }
  tr { break-inside: avoid; } }
"""
_PLAIN = {"Date": None, "Creator": None, "Format": None, "Type": None}  # no metadata, for reproducible files


def as_html(report: Report, at: Callable[[int], None] = lambda _: None) -> str:
    """The page; equal reports give equal text. `at` is called with the number of figures drawn."""
    number = 0
    body = [f"<h1>{escape(report.title)}</h1>", _verdict(report), _facts(report.facts)]
    for section in report.sections:
        body.append(f"<section>\n<h2>{escape(section.title)}</h2>")
        for part in section.parts:
            if isinstance(part, CaptionedFigure):
                number += 1
                body.append(_figure(part, section, number))
                at(number)
            elif isinstance(part, Player):
                body.append(_player(part))
            else:
                body.append(_table(part) if isinstance(part, Table) else f"<pre>{escape(part.text)}</pre>")
        body.append("</section>")
    title = escape(f"palmd: {report.title}")
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{title}</title>\n'
        f"<style>{_CSS}</style>\n</head>\n<body>\n" + "\n".join(body) + "\n</body>\n</html>\n"
    )


def _figure(figure: CaptionedFigure, section: Section, number: int) -> str:
    text = StringIO()
    with figure_style(str(number)):
        rendered(figure).savefig(text, format="svg", metadata=_PLAIN)
    return (
        f"<figure>\n{_embedded(text.getvalue(), f'f{number}-', section.title)}\n"
        f"<figcaption><b>Figure {number}.</b> {escape(figure.caption)}</figcaption>\n</figure>"
    )


def _embedded(svg: str, prefix: str, name: str) -> str:
    """The SVG element without its prologue, with ids made unique by `prefix` and a label for screen readers."""
    drawing = svg[svg.index("<svg") :]
    drawing = re.sub(r'\bid="', f'id="{prefix}', drawing)
    drawing = re.sub(r'href="#', f'href="#{prefix}', drawing)
    drawing = drawing.replace("url(#", f"url(#{prefix}")
    return drawing.replace("<svg", f'<svg role="img" aria-label="{escape(name)}"', 1)


def _player(player: Player) -> str:
    """Two canvases with their script and data. Hidden until the script runs, so pages without scripts stay complete."""
    data = json.dumps(player.data, allow_nan=False, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
    script = files("palmd.report").joinpath("player.js").read_text(encoding="utf-8")
    return (
        '<div id="player" hidden>\n<div><canvas role="img" aria-label="palms, object and contacts"></canvas></div>\n'
        '<p class="controls"><button type="button">Play</button>'
        '<input type="range" min="0" max="0" value="0" aria-label="time"></p>\n'
        '<div><canvas role="img" aria-label="touched share, states and faults over time"></canvas></div>\n<dl></dl>\n'
        f"<p>{escape(player.caption)}</p>\n</div>\n"
        f'<script type="application/json" id="player-data">{data}</script>\n<script>\n{script}</script>\n'
        "<noscript><p>Enable scripts to play the run back here.</p></noscript>"
    )


def _verdict(report: Report) -> str:
    if report.verdict is None:
        return ""
    return f'<p class="verdict {report.verdict.word}">{escape(texts.verdict(report.verdict))}</p>'


def _facts(facts: tuple[tuple[str, str], ...]) -> str:
    rows = "\n".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in facts)
    return f'<table class="facts">\n{rows}\n</table>'


def _table(table: Table) -> str:
    if not table.rows:
        return "<p>None.</p>"
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.head)
    rows = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows)
    return f"<table>\n<tr>{head}</tr>\n{rows}\n</table>"
