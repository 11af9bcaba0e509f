"""The first notebook runs from top to bottom, and the results that it prints are close to the truth."""

import json
import re
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest

NOTEBOOK = Path(__file__).parents[3] / "docs/start/first-notebook.ipynb"


@pytest.fixture
def no_windows(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    before = matplotlib.get_backend()
    matplotlib.use("agg")
    yield
    plt.close("all")
    matplotlib.use(before)


@pytest.mark.usefixtures("no_windows")
def test_the_first_notebook_runs(capsys):
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    names = {}
    for number, cell in enumerate(cells):
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "stored with outputs, which go stale"
            exec(compile("".join(cell["source"]), f"{NOTEBOOK.name}[{number}]", "exec"), names)
            plt.close("all")
    output = capsys.readouterr().out
    assert float(re.search(r"(\d+)% of all ticks", output)[1]) > 50
    assert float(re.search(r"it is (\d+) µm off", output)[1]) < 300
