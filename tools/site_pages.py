"""Generated pages of the site: README, changelog, decisions, the API, the executed notebook.

A hook of MkDocs (mkdocs.yml). The notebook is executed for each build, so that its output is that of the present code.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

import palmd

ROOT = Path(__file__).parent.parent
NOTEBOOK = "start/first-notebook.ipynb"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages to those of docs/."""
    pages = {
        "index.md": front_page(),
        "changelog.md": (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").replace("](docs/", "]("),
        "decisions/index.md": decisions(),
        "reference/api.md": api(),
        "assets/iframe-worker.js": (ROOT / "tools/iframe-worker.js").read_text(encoding="utf-8"),
        **notebook(ROOT / "docs" / NOTEBOOK),
    }
    for path, content in pages.items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace links to the notebook by links to its page."""
    return markdown.replace("(first-notebook.ipynb)", "(first-notebook.md)")


def front_page() -> str:
    """The README with its links relative to docs/."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    moved = {"(docs/decisions/)": "(decisions/index.md)", "(CHANGELOG.md)": "(changelog.md)", "](docs/": "]("}
    for before, now in moved.items():
        text = text.replace(before, now)
    return text


def decisions() -> str:
    """The list of all decisions by title."""
    rows = []
    for path in sorted((ROOT / "docs/decisions").glob("0*.md")):
        title = path.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")
        rows.append(f"- [{title}]({path.name})")
    return "# Decisions\n\n" + "\n".join(rows) + "\n"


def api() -> str:
    """The reference of every public name of `palmd`, from its docstring."""
    parts = [f"::: palmd.api.{name}\n" for name in palmd.__all__]
    return (
        "# The library\n\nWhat `import palmd` offers; [palmd in a notebook](../start/library.md) shows it at work.\n\n"
        + "\n".join(parts)
    )


def notebook(path: Path) -> dict[str, str]:
    """The notebook as a page with the output of its cells, and its figures, by their paths in docs/."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    page = path.relative_to(ROOT / "docs").with_suffix(".md")
    parts, figures = [], {}
    with _folder_of_its_own(), _drawing():
        names: dict[str, Any] = {}
        for number, cell in enumerate(cells):
            source = "".join(cell["source"])
            if cell["cell_type"] != "code":
                parts.append(source)
                continue
            output = executed(source, f"{path.name}[{number}]", names)
            parts.append(f"```python\n{source}\n```")
            if output:
                parts.append(f"```text\n{output.rstrip()}\n```")
            for figure in drawn():
                name = f"first-notebook-{number}.svg"
                figures[str(page.parent / name)] = figure
                parts.append(f"![what the cell draws]({name})")
    return {str(page): "\n\n".join(parts) + "\n", **figures}


def executed(source: str, name: str, names: dict[str, Any]) -> str:
    """The output of a cell: what it prints, and the value of a last expression without a semicolon."""
    tree = ast.parse(source, name)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as output:
        exec(compile(tree, name, "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), name, "eval"), names)
            if value is not None and not source.rstrip().endswith(";"):
                print(repr(value))
    return output.getvalue()


def drawn() -> Iterator[str]:
    """The open figures as SVG; closes them."""
    import matplotlib.pyplot as plt

    for number in plt.get_fignums():
        text = io.StringIO()
        plt.figure(number).savefig(text, format="svg", metadata={"Date": None})
        plt.close(number)
        yield text.getvalue()


@contextlib.contextmanager
def _folder_of_its_own() -> Iterator[None]:
    before = Path.cwd()
    with tempfile.TemporaryDirectory(prefix="palmd-site-") as folder:
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)


@contextlib.contextmanager
def _drawing() -> Iterator[None]:
    """Matplotlib settings for drawing without a window and with reproducible SVG."""
    import matplotlib

    with matplotlib.rc_context({"backend": "agg", "svg.hashsalt": "palmd", "figure.figsize": (7.0, 3.6)}):
        yield
