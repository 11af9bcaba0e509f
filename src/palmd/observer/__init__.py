"""Events in, estimates out: filters, banks of them, and what they have learnt of the object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

from palmd.model.smoothing import ORDER
from palmd.observer.bank_observer import BankObserver, SmoothedFilters
from palmd.observer.filters import ExtendedFilters, ShapeFilters
from palmd.observer.quasistatic import QuasistaticObserver
from palmd.observer.recogniser import Recogniser
from palmd.observer.smoothed_observer import Simulated, SmoothedObserver, Smoothing
from palmd.outlinefile import Outline
from palmd.system.description import RigDescription

ObserverName = Literal["shape", "extended", "quasistatic"]
OBSERVERS: tuple[str, ...] = get_args(ObserverName)

__all__ = [
    "OBSERVERS",
    "BankObserver",
    "ObserverName",
    "QuasistaticObserver",
    "Recogniser",
    "Simulated",
    "SmoothedObserver",
    "make",
]

EXTENDED_BANK, SHAPE_BANK, AGAIN_BANK = 24, 32, 24  # multiples of model.compiled.BLOCK


def make(
    name: ObserverName,
    rig: RigDescription,
    seed: int = 0,
    smoothing: Smoothing | None = None,
    outlines: Sequence[Outline] = (),
) -> BankObserver | SmoothedObserver | Recogniser | QuasistaticObserver:
    """The observer called `name` for `rig`; takes seconds when its C has to be compiled first.

    `smoothing` says where the smoother of a shape map runs; without it there is none, nor for other observers. With
    `outlines`, which are for shape maps only, the object is one of these or none, and needs no smoother.
    """
    if name == "quasistatic":
        return QuasistaticObserver(rig)
    if name == "extended":
        return BankObserver(ExtendedFilters(rig, EXTENDED_BANK), rig, seed)
    if outlines:
        return Recogniser(outlines, rig, seed)
    filters = ShapeFilters(rig, SHAPE_BANK)
    if smoothing is None:
        return BankObserver(filters, rig, seed)
    smoothed = SmoothedFilters(ShapeFilters(rig, AGAIN_BANK, order=ORDER), ShapeFilters(rig, 1, order=ORDER))
    return SmoothedObserver(BankObserver(filters, rig, seed, smoothed), rig, smoothing)
