"""A recording of each system that runs live has its row in `palmd runs`, its export and its report."""

import json
import math

import pytest
import recorded

from palmd.cli import main
from palmd.console.shipped import shipped
from palmd.model.icosphere import icosphere
from palmd.quantities import STATE
from palmd.record.metadata import preface
from palmd.systems import LIVE, TWO_PALMS
from palmd.topics import SYSTEM_TOPICS
from palmd.yamlfile import load_any_config

EMPTY = {"number": 0.0, "bool": True, "text": "", "texts": [], "numbers": [], "sds": {}}
DEGREES = [math.radians(degree) for degree in range(360)]
OTHERS = [name for name in LIVE if name != TWO_PALMS]


def fields_of(topic, **said):
    return {each.name: EMPTY[each.kind] for each in topic.quantities if not each.name.endswith("*")} | said


def shape_of(topic):
    """A circle or a ball of 20 mm, half of it touched."""
    names = {each.name for each in topic.quantities}
    count = len(icosphere(4)[0]) if "halvings" in names else 360
    touched = [1] * (count // 2) + [0] * (count - count // 2)
    lists = {"touched": touched, "theta_rad": DEGREES}
    lists |= {name: [0.02] * count for name in ("h_m", "hP_m")}
    lists |= {name: [1e-5] * count for name in ("h_sd_m", "hP_sd_m")}
    fields = {name: values for name, values in lists.items() if name in names}
    return fields_of(topic, **fields | ({"halvings": 4} if "halvings" in names else {}))


@pytest.fixture(params=OTHERS)
def run(request, tmp_path):
    config = load_any_config(shipped(LIVE[request.param].demo))
    topics = SYSTEM_TOPICS[request.param]
    path = tmp_path / "runs" / "run.mcap"
    path.parent.mkdir()
    messages = [
        recorded.message(topic.name, fields_of(topic, **({"state": "tracking"} if topic is STATE else {})), n, 0.1 * n)
        for n in range(30)
        for topic in (topics.estimate, topics.motion, topics.contact, STATE)
    ]
    messages.append(recorded.message(topics.shape.name, shape_of(topics.shape), 0, 3.0))
    return recorded.written(path, messages, preface(config, recorded.BEGIN.isoformat()), compressed=True)


def test_a_run_has_its_row_in_the_list(run, capsys):
    assert main(["runs", str(run.parent), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["problem"] == ""
    assert row["touched"] == pytest.approx(0.5, abs=0.01)
    assert row["sd_m"] == pytest.approx(1e-5)


def test_a_run_is_exported_as_scene_and_tables(run, tmp_path):
    assert main(["export", str(run), "-o", str(tmp_path / "x.svg")]) == 0
    assert "<svg" in (tmp_path / "x.svg").read_text()
    assert main(["export", str(run), "-o", str(tmp_path / "csv")]) == 0
    assert main(["export", str(run), "-o", str(tmp_path / "json.mcap"), "--as", "mcap-json"]) == 0


def test_a_run_has_its_report(run, tmp_path, capsys):
    assert main(["report", str(run), "-o", str(tmp_path / "x.html")]) == 0
    assert "valid 100% of the ticks" in capsys.readouterr().out
    page = (tmp_path / "x.html").read_text()
    assert all(f">{title}<" in page for title in ("State", "Motion", "Messages", "Configuration"))
