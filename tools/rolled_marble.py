"""Simulation of a marble rolled over an emulated pad, without a link and faster than real time."""

from __future__ import annotations

import numpy as np

from palmd.config.pads import VersaPadConfig
from palmd.devices.arrival import byte_time
from palmd.devices.versapad import PACKET_BYTES, PadCounters, PadPacket, PressureFormat, VersaPadDecoder
from palmd.rig.marble import Marble
from palmd.rig.padkinds.versapad import VersaPadEmulator
from palmd.rig.pads import GOOD_PADS, PadOptions


def rolled(
    config: VersaPadConfig, seed: int, seconds: float, options: PadOptions = GOOD_PADS
) -> tuple[list[PadPacket], PadCounters]:
    """The packets that the host decodes, each read as its last byte arrives; deterministic for its arguments."""
    rng = np.random.default_rng(seed)
    marble = Marble(config.length_mm * 1e-3, rng)
    pad = VersaPadEmulator(config, options, lambda _s, _force: 0.0, rng, 0.0)
    decoder = VersaPadDecoder(config.baud, PressureFormat(**config.pressure.model_dump()))
    packets: list[PadPacket] = []
    while (t := pad.due) < seconds:
        packets += decoder.feed(pad.report(t, marble.presses(t)), t + (PACKET_BYTES - 1) * byte_time(config.baud))
    return packets, decoder.counters
