"""Jogging by small steps, as with a dead-man switch."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from typing import Any

from palmd.bus.command_client import CommandClient

JOG_EVERY_S = 0.05  # well within the daemon's dead-man time
JOG_STEP_DEG = 0.4  # 8°/s, which the palms can follow
JOG_ARRIVING_S = 0.5


def jog(
    client: CommandClient, whole_deg: Mapping[str, float], first: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Turn each joint, named as the jog command's argument, by so many degrees; returns the last reply.

    The first step states the whole motion, so that an impossible motion is not begun. The palms stop if no further step
    is sent. If a later step is refused, its error contains the angles commanded before it. `first`: further arguments
    of the first step.
    """
    reply: dict[str, Any] = {}
    commanded = dict.fromkeys(whole_deg, 0.0)
    whole: dict[str, Any] = {f"whole_{name}": angle for name, angle in whole_deg.items()} | dict(first or {})
    for step in jog_steps(*whole_deg.values()):
        t_next = time.monotonic() + JOG_EVERY_S
        reply = client.ask("jog", {**dict(zip(whole_deg, step, strict=True)), **whole})
        whole = {}
        if not reply["ok"]:
            if any(commanded.values()):
                so_far = ", ".join(
                    f"{name} {commanded[name]:.1f} of {angle:g}" for name, angle in whole_deg.items() if angle
                )
                reply = reply | {"error": f"stopped before the end ({so_far}): {reply['error']}"}
            break
        commanded = {name: commanded[name] + angle for name, angle in zip(whole_deg, step, strict=True)}
        time.sleep(max(0.0, t_next - time.monotonic()))
    return reply


def jog_steps(*whole_deg: float) -> Iterator[tuple[float, ...]]:
    """Equal steps that add up to the angles, then zero steps until the palms have arrived."""
    count = max(1, math.ceil(max(map(abs, whole_deg)) / JOG_STEP_DEG))
    for _ in range(count):
        yield tuple(angle / count for angle in whole_deg)
    for _ in range(round(JOG_ARRIVING_S / JOG_EVERY_S)):
        yield (0.0,) * len(whole_deg)
