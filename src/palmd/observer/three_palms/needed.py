"""What is compiled for observing a body between three palms. Nothing of it is loaded before it is made."""

from __future__ import annotations

from palmd.observer.kernels import Part


def needed(_config: object) -> list[Part]:
    """Its kernels, whatever its configuration says: as `palmd.observer.kernels.needed`."""
    from palmd.model import body_rollout, three_palms
    from palmd.observer.three_palms.body import FINER_LIVE, ORDER
    from palmd.observer.three_palms.body_filter import steps
    from palmd.observer.three_palms.compiled_equations import written
    from palmd.observer.three_palms.search import COARSE
    from palmd.system.three_palms import ThreePalmsRig

    def space(order: int) -> Part:
        return f"three palms in space, degree {order}", lambda: three_palms.library(order).backend

    def equations() -> str:
        written()
        return "c"

    def filter_() -> str:
        steps(ORDER, ThreePalmsRig())
        return "c"

    return [
        ("three palms in space, the beginning", lambda: three_palms.driven_library().backend),
        *(space(order) for order in (*(order for order, _ in COARSE), ORDER, *FINER_LIVE)),
        ("three palms in space, the smoother's equations", equations),
        ("three palms in space, foresight", lambda: body_rollout.library(ORDER, body_rollout.STEP_S).backend),
        (
            "three palms in space, rough foresight",
            lambda: body_rollout.library(body_rollout.ROUGH_ORDER, body_rollout.ROUGH_STEP_S).backend,
        ),
        ("three palms in space, the filter", filter_),
    ]
