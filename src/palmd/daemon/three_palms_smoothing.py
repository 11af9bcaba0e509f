"""Run the smoother of a body between three palms in a separate process: see `daemon.smoothing`."""

from __future__ import annotations

import sys
from concurrent.futures import Future, ThreadPoolExecutor

from palmd.daemon.smoothing import rig_from_json, work
from palmd.system.three_palms import BodyAnswer, ThreePalmsRig
from palmd.three_palms_messages import ANSWERS

PERIOD_S = 0.2  # polling interval for the end of an update
SWITCH_S = 5e-4  # thread switch interval: receiving events must not wait for an update


def serve(address: str, rig: str) -> None:
    """Main function of the process, never returns; `rig`: the rig's fields as JSON. Updates run in a thread."""
    from palmd.observer.three_palms.incremental import IncrementalBodySmoother  # SciPy, in this process alone

    sys.setswitchinterval(SWITCH_S)
    smoother = IncrementalBodySmoother(rig_from_json(rig, ThreePalmsRig))
    pool = ThreadPoolExecutor(1)
    update: Future[BodyAnswer | None] | None = None

    def answer() -> BodyAnswer | None:
        nonlocal update
        if update is not None and not update.done():
            return None
        answered = None if update is None else update.result()
        update = pool.submit(smoother.answer)
        return answered

    work(address, smoother.add, answer, ANSWERS.packed, lambda: PERIOD_S)
