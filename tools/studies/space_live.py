"""Bodies between three palms estimated live, closed loop without wires, and judged by the emulated truth.

By the shipped plan that swings, or by the one that explores.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from palmd.blas import one_thread
from palmd.config.three_palms import ThreePalmsConfig, TiltPlanSpec, three_palms_rig
from palmd.console.shipped import shipped
from palmd.daemon.body_decider import BodyDecider
from palmd.harness.three_palms_comparison import matrix, surface_error
from palmd.harness.three_palms_wireless import ThreePalmsWireless
from palmd.jsonvalues import or_none
from palmd.model.icosphere import icosphere
from palmd.motion.body_explorer import NEAR_RAD
from palmd.quantities import STATE
from palmd.system.three_palms import JOINTS, PALMS, palms_at
from palmd.three_palms_quantities import PALM3, PALM3_SHAPE, WORLD_AXES
from palmd.yamlfile import load_any_config, parse, read_document
from tools.studies.paced import PacedExplorer, PacedGrowing
from tools.studies.space_exploring import GOAL, HALVINGS, MARKS_S

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
    valid ticks. coverage: the share of all directions within 10 degrees of a contact curve after each of `MARKS_S`;
    told: what was said of it in the end. losses: how often the body fell off the palms, recovered: after how many of
    them it was valid again, for `back_s` in the mean without.
    """

    seed: int
    settled: float
    for_good: float
    valid: float
    error: float
    wrong: int
    ratio: float
    coverage: tuple[float, ...]
    told: float
    losses: int
    recovered: int
    back_s: float
    reason: str

    def line(self) -> dict[str, Any]:
        """As JSON, None for what is not a number."""
        line: dict[str, Any] = or_none(asdict(self))
        return line


class TrueCoverage:
    """What of the body has been touched in truth."""

    def __init__(self) -> None:
        self._directions = icosphere(HALVINGS)[0]
        self._touched = np.zeros(len(self._directions), np.bool_)
        self._at_marks: list[float] = []

    def see(self, since: float, truth: dict[str, Any]) -> None:
        """At so many seconds since the first motion."""
        if len(self._at_marks) < len(MARKS_S) and since >= MARKS_S[len(self._at_marks)]:
            self._at_marks.append(self.share)
        if truth["touch1"]:
            still = np.zeros((1, 3))
            joints = np.array([[truth[f"{joint}_rad"] for joint in JOINTS]])
            normals = -palms_at(joints, still, still).normal[0] @ matrix(truth["quat_xyzw"])
            self._touched |= (self._directions @ normals.T).max(axis=1) > math.cos(NEAR_RAD)

    @property
    def share(self) -> float:
        """Of all directions."""
        return float(self._touched.mean())

    @property
    def at_marks(self) -> tuple[float, ...]:
        """After each of them; the last share where it did not last so long."""
        return (*self._at_marks, *[self.share] * (len(MARKS_S) - len(self._at_marks)))


@one_thread()
def lived(seed: int, seconds: float, pace: float | None = None) -> SpaceLiveRow:
    """The plan that swings; what is thought comes after `pace` times its processor time, or after fixed times."""
    return _lived(seed, seconds, "sway.yaml", pace)


@one_thread()
def lived_exploring(seed: int, seconds: float, pace: float | None = None) -> SpaceLiveRow:
    """The plan that explores, blind; see `lived`."""
    return _lived(seed, seconds, "explore.yaml", pace)


def _lived(seed: int, seconds: float, plan: str, pace: float | None) -> SpaceLiveRow:
    """The shipped configuration and this plan, with the body and the noise of this seed."""
    config = load_any_config(shipped("three_palms.yaml"))
    if not isinstance(config, ThreePalmsConfig):
        raise TypeError("the shipped configuration is not of three palms in space")
    spec = parse(read_document(shipped("plans") / "three_palms" / plan), TiltPlanSpec)
    if pace is None:
        rig = ThreePalmsWireless(config, spec, seed)
    else:
        known = three_palms_rig(config)
        paced = PacedGrowing(known, pace), PacedExplorer(BodyDecider(known, seed), pace)
        rig = ThreePalmsWireless(config, spec, seed, *paced)
    rig.start()
    begun, settled = rig.t, math.nan
    ticks, valid, squares = 0, 0, []
    surfaces: list[tuple[float, float]] = []
    estimate: dict[str, Any] = {}
    coverage, told = TrueCoverage(), math.nan
    lost, back, losses = math.nan, list[float](), 0
    for now in rig.run(seconds):
        estimate, truth = now.messages[PALM3.name], now.truth
        coverage.see(rig.t - begun, truth)
        told = now.messages.get(STATE.name, {}).get("coverage", told)
        if rig.world.contact_losses > losses:
            losses, lost = rig.world.contact_losses, rig.t
        if estimate["valid"]:
            if math.isfinite(lost):
                back.append(rig.t - lost)
                lost = math.nan
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
        coverage.at_marks, told, losses, len(back), float(np.mean(back)) if back else math.nan,
        str(estimate["reason"]),
    )  # fmt: skip


def told(rows: list[SpaceLiveRow]) -> Iterator[str]:
    """A line for each, and what they come to."""
    for row in rows:
        lost = f", {row.recovered} times valid again after {row.back_s:.1f} s" if row.losses else ""
        yield (
            f"{row.seed:8}: valid after {row.settled:.1f} s, right for good after {row.for_good:.1f} s, valid"
            f" {row.valid:.0%} of the time since, {row.error * 1e6:.0f} µm, {row.wrong} wrong, (e/sd)² {row.ratio:.2f},"
            f" fell off {row.losses} times{lost}; {row.reason or 'valid at the end'}"
        )
    good = [row.for_good for row in rows if math.isfinite(row.for_good)]
    claimed = [row for row in rows if math.isfinite(row.settled)]
    yield (
        f"{len(rows)} bodies: {len(claimed)} claimed, {len(good)} right for good (median"
        f" {np.median(good) if good else math.nan:.1f} s), {sum(row.wrong > 0 for row in rows)} ever wrong"
    )


def told_of_exploring(rows: list[SpaceLiveRow]) -> Iterator[str]:
    """As `told`, and how much was touched."""
    for row in rows:
        shares = ", ".join(f"{share:.0%} after {mark:.0f} s" for mark, share in zip(MARKS_S, row.coverage, strict=True))
        yield f"{row.seed:8}: {shares}, told {row.told:.0%}"
    yield from told(rows)
    last = np.array([row.coverage[-1] for row in rows])
    yield (
        f"touched: median {np.median(last):.0%}, {np.count_nonzero(last >= GOAL)} with at least {GOAL:.0%}; lost"
        f" {sum(row.losses > 0 for row in rows)}"
    )
