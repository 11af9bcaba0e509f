"""Dimensions of the tabletop rig that a configuration needs (mm); `tools/tabletop/geometry.py` has all others."""

from __future__ import annotations

STRIP_COUNTS = 16383
"""Counts over a strip's active length: 14 bits in the firmware's report."""

PALM_LENGTH_MM = 75.0
"""From the axis to the palm's end."""
STRIP_START_MM = 2.5
"""From the axis to where the strip begins to sense."""
STRIP_LENGTH_MM = 60.0
"""Active length of the strip."""
STRIP_COUNTS_PER_MM = round(STRIP_COUNTS / STRIP_LENGTH_MM, 2)
"""The strip's scale."""
