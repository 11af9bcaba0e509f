"""An outline as a DXF drawing in millimetres, one layer per kind of curve. The only module that needs ezdxf."""

from __future__ import annotations

import io
import logging

from ezdxf import units
from ezdxf.filemanagement import new

from palmd.record.outline_files import OutlineCurves

OUTLINE, BAND, UNTOUCHED, CENTRE, TEXT = "OUTLINE", "BAND", "UNTOUCHED", "CENTRE_OF_MASS", "TEXT"
_COLOURS = {OUTLINE: 7, BAND: 5, UNTOUCHED: 30, CENTRE: 7, TEXT: 8}  # AutoCAD's colour index
_TEXT_MM = 1.5


def as_dxf(curves: OutlineCurves) -> bytes:
    """DXF R2010: closed polylines on OUTLINE and BAND (outer, inner), untouched arcs, the centre of mass, comments."""
    logging.getLogger("ezdxf").setLevel(logging.WARNING)  # it logs every table that it creates
    drawing = new("R2010", setup=["linetypes"], units=units.MM)
    drawing.header["$MEASUREMENT"] = 1  # metric
    for name, colour in _COLOURS.items():
        drawing.layers.add(name, color=colour, linetype="DASHED" if name == UNTOUCHED else "CONTINUOUS")
    space = drawing.modelspace()
    for layer, points in ((OUTLINE, curves.outline), (BAND, curves.outer), (BAND, curves.inner)):
        space.add_lwpolyline(points.tolist(), close=True, dxfattribs={"layer": layer})
    for arc in curves.untouched:
        space.add_lwpolyline(arc.tolist(), dxfattribs={"layer": UNTOUCHED})
    space.add_point((0.0, 0.0), dxfattribs={"layer": CENTRE})
    left, below = float(curves.outer[:, 0].min()), float(curves.outer[:, 1].min()) - 2 * _TEXT_MM
    for number, line in enumerate(curves.comments):
        position = (left, below - 1.5 * _TEXT_MM * number)
        space.add_text(line, height=_TEXT_MM, dxfattribs={"layer": TEXT}).set_placement(position)
    stream = io.StringIO()
    drawing.write(stream)
    return drawing.encode(stream.getvalue())
