"""The process of the smoother of a body between three palms: see `daemon.smoothing`."""

from __future__ import annotations

import sys
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from palmd.daemon.smoothing import flat, rig_from_json, work
from palmd.system.three_palms import BodyAnswer, ThreePalmsRig

PERIOD_S = 0.2  # polling interval for the end of an update
SWITCH_S = 5e-4  # thread switch interval: receiving events must not wait for an update


def serve(address: str, rig: str) -> None:
    """Main function of the process, never returns; `rig`: the rig's fields as JSON. Updates run in a thread."""
    from palmd.observer.three_palms.incremental import IncrementalBodySmoother  # SciPy, in this process alone

    sys.setswitchinterval(SWITCH_S)
    smoother = IncrementalBodySmoother(rig_from_json(rig, ThreePalmsRig))
    pool = ThreadPoolExecutor(1)
    update: Future[BodyAnswer | None] | None = None

    def answer() -> list[Any] | None:
        nonlocal update
        if update is not None and not update.done():
            return None
        answered = None if update is None else update.result()
        update = pool.submit(smoother.answer)
        return flat(answered)

    work(address, smoother.add, answer, lambda: PERIOD_S)
