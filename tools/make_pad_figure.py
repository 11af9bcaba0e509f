"""Draws docs/figures/pad.svg: a marble rolled over an emulated pad for twenty seconds."""

from __future__ import annotations

from pathlib import Path

from palmd.calibration.pad_characteristic import characterise
from palmd.calibration.pad_figure import save
from palmd.config.pads import VersaPadConfig
from palmd.lab.rolled_marble import rolled

FIGURE = Path(__file__).parent.parent / "docs/figures/pad.svg"

if __name__ == "__main__":
    config = VersaPadConfig(port="emulated")
    packets, counters = rolled(config, seed=1, seconds=20.0)
    save(packets, characterise(packets, counters, config), config, FIGURE)
