"""Draw docs/figures/pad.svg: a marble rolled over an emulated pad for twenty seconds."""

from __future__ import annotations

import sys
from pathlib import Path

from palmd.calibration.pad_characteristic import characterise
from palmd.calibration.pad_figure import save
from palmd.config.pads import VersaPadConfig

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))  # for `tools.studies`

from tools.rolled_marble import rolled

FIGURE = ROOT / "docs/figures/pad.svg"


def draw(path: Path) -> None:
    """Draw the figure; the file is the same each time."""
    config = VersaPadConfig(port="emulated")
    packets, counters = rolled(config, seed=1, seconds=20.0)
    save(packets, characterise(packets, counters.as_dict(), config), config, path)


if __name__ == "__main__":
    draw(FIGURE)
