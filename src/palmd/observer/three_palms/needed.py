"""Compiled parts that an observer of a body between three palms needs; imported only when they are built."""

from __future__ import annotations

from palmd.observer.kernels import Part


def needed(_config: object) -> list[Part]:
    """The same for every configuration; see `palmd.observer.kernels.needed`."""
    from palmd.model import body_rollout, three_palms
    from palmd.observer.three_palms.body import FINER_ORDERS_LIVE, ORDER
    from palmd.observer.three_palms.body_filter import filter_steps
    from palmd.observer.three_palms.compiled_equations import c_library
    from palmd.observer.three_palms.search import COARSE_STAGES
    from palmd.system.three_palms import ThreePalmsRig

    def space(order: int) -> Part:
        return f"three palms in space, degree {order}", lambda: three_palms.library(order).backend

    def equations() -> str:
        c_library()
        return "c"

    def filter_() -> str:
        filter_steps(ORDER, ThreePalmsRig())
        return "c"

    return [
        ("three palms in space, blind start", lambda: three_palms.driven_library().backend),
        *(space(order) for order in (*(order for order, _ in COARSE_STAGES), ORDER, *FINER_ORDERS_LIVE)),
        ("three palms in space, the smoother's equations", equations),
        ("three palms in space, prediction", lambda: body_rollout.library(ORDER, body_rollout.STEP_S).backend),
        (
            "three palms in space, coarse prediction",
            lambda: body_rollout.library(body_rollout.ROUGH_ORDER, body_rollout.ROUGH_STEP_S).backend,
        ),
        ("three palms in space, the filter", filter_),
    ]
