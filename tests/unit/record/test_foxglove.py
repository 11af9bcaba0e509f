"""The layout for Foxglove and Lichtblick names only exported fields."""

import json
import re
from pathlib import Path

import rig_recording

from palmd.record.export import SCENE, schema
from palmd.record.run import read_run
from palmd.record.tables import field_examples

LAYOUT = json.loads((Path(__file__).parents[3] / "config/foxglove.json").read_text())
PANELS = LAYOUT["configById"]


def panels(part):
    """The names in a layout's tree."""
    if isinstance(part, str):
        return [part]
    assert part["direction"] in ("row", "column")
    assert 0 < part["splitPercentage"] < 100
    return [*panels(part["first"]), *panels(part["second"])]


def paths():
    for panel in PANELS.values():
        yield from (path["value"] for path in panel.get("paths", ()))
        if "xAxisPath" in panel:
            yield panel["xAxisPath"]["value"]


def test_every_panel_is_placed_in_the_layout():
    placed = panels(LAYOUT["layout"])
    assert sorted(placed) == sorted(PANELS)


def test_every_path_leads_to_a_field():
    known = {
        topic: schema(topic, fields)
        for topic, fields in field_examples(read_run(rig_recording.path()), lambda: None).items()
    }
    found = list(paths())
    assert len(found) > 20
    for path in found:
        topic, first, *rest = re.fullmatch(r"([a-z/]+)\.(\w+)(\[:\])?(?:\.(\w+))?", path).groups()
        if topic == SCENE:
            assert first in ("outline_x_m", "outline_y_m", "palms_x_m", "palms_y_m")
            assert rest[0] == "[:]"
            continue
        field = known[topic]["properties"][first]
        if rest[1] is not None:
            field = field["properties"][rest[1]]
        assert field["type"] in ("number", "boolean"), path

    topics = {panel["topicPath"] for panel in PANELS.values() if "topicPath" in panel}
    assert topics <= known.keys()
