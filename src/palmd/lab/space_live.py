"""Bodies between three palms estimated live, closed loop without wires, and judged by the emulated truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from palmd.blas import one_thread
from palmd.console.shipped import shipped
from palmd.harness.three_palms_comparison import matrix, surface_error
from palmd.harness.three_palms_wireless import ThreePalmsWireless
from palmd.jsonvalues import or_none
from palmd.system.three_palms import PALMS
from palmd.three_palms_config import ThreePalmsConfig, TiltPlanSpec
from palmd.three_palms_quantities import PALM3, PALM3_SHAPE, WORLD_AXES
from palmd.yamlfile import load_any_config, parse, read_document

RIGHT_M = 1.5e-4
COMPARED = (
    *(f"omega_{axis}_rad_s" for axis in WORLD_AXES),
    *(f"com_{axis}_m" for axis in WORLD_AXES),
    *(f"{side}{palm}_m" for palm in PALMS for side in "ab"),
)


@dataclass(frozen=True, slots=True)
class SpaceLiveRow:
    """One body, live: when it was first valid, and right for good (s from the first motion; NaN: never).

    valid: share of the ticks since then. error: RMS of the last claimed surface where touched (m), NaN without one;
    wrong: how many claimed surfaces were not within `RIGHT_M`. ratio: mean (error/sd)² of spin, centre and contacts in
    valid ticks. losses: how often the body fell off the palms.
    """

    seed: int
    settled: float
    for_good: float
    valid: float
    error: float
    wrong: int
    ratio: float
    losses: int
    reason: str

    def line(self) -> dict[str, Any]:
        """As JSON, None for what is not a number."""
        line: dict[str, Any] = or_none(asdict(self))
        return line


@one_thread()
def lived(seed: int, seconds: float) -> SpaceLiveRow:
    """The shipped configuration and plan, with the body and the noise of this seed."""
    config = load_any_config(shipped("three_palms.yaml"))
    if not isinstance(config, ThreePalmsConfig) or config.plan is None:
        raise TypeError("the shipped configuration is not of three palms in space")
    rig = ThreePalmsWireless(config, parse(read_document(config.plan), TiltPlanSpec), seed)
    rig.start()
    begun, settled = rig.t, math.nan
    ticks, valid, squares = 0, 0, []
    surfaces: list[tuple[float, float]] = []
    estimate: dict[str, Any] = {}
    while rig.t < begun + seconds:
        now = rig.tick()
        estimate, truth = now.messages[PALM3.name], now.truth
        if estimate["valid"]:
            settled = rig.t - begun if math.isnan(settled) else settled
            valid += 1
            if math.isfinite(truth["a1_m"]):
                off = [(estimate[name] - truth[name]) / estimate["sd"][name] for name in COMPARED]
                squares.append(float(np.mean(np.square(off))))
        ticks += math.isfinite(settled)
        shape = now.messages.get(PALM3_SHAPE.name)
        if shape is not None and shape["valid"]:
            turn = matrix(truth["quat_xyzw"]).T @ matrix(estimate["quat_xyzw"])
            true = np.array(rig.world.object_truth()["h_m"])
            surfaces.append((rig.t - begun, surface_error(shape, true, turn)[0]))
    wrong = [t for t, error in surfaces if not error < RIGHT_M]
    right = [t for t, _ in surfaces if t > max(wrong, default=-math.inf)]
    return SpaceLiveRow(
        seed, settled, right[0] if right else math.nan, valid / ticks if ticks else 0.0,
        surfaces[-1][1] if surfaces else math.nan, len(wrong), float(np.mean(squares)) if squares else math.nan,
        rig.world.contact_losses, str(estimate["reason"]),
    )  # fmt: skip


def told(rows: list[SpaceLiveRow]) -> Iterator[str]:
    """A line for each, and what they come to."""
    for row in rows:
        yield (
            f"{row.seed:8}: valid after {row.settled:.1f} s, right for good after {row.for_good:.1f} s, valid"
            f" {row.valid:.0%} of the time since, {row.error * 1e6:.0f} µm, {row.wrong} wrong, (e/sd)² {row.ratio:.2f},"
            f" fell off {row.losses} times; {row.reason or 'valid at the end'}"
        )
    good = [row.for_good for row in rows if math.isfinite(row.for_good)]
    claimed = [row for row in rows if math.isfinite(row.settled)]
    yield (
        f"{len(rows)} bodies: {len(claimed)} claimed, {len(good)} right for good (median"
        f" {np.median(good) if good else math.nan:.1f} s), {sum(row.wrong > 0 for row in rows)} ever wrong"
    )
