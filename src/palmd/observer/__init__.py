"""Events in, estimates out: filters, banks of them, and what they have learnt of the object."""

from __future__ import annotations

from typing import Literal, get_args

from palmd.events import RigDescription
from palmd.observer.filters import ExtendedFilters, ShapeFilters
from palmd.observer.improved import ImprovedObserver, Simulated, Smoothing
from palmd.observer.live import BankObserver

ObserverName = Literal["shape", "extended"]
OBSERVERS: tuple[str, ...] = get_args(ObserverName)

__all__ = ["OBSERVERS", "BankObserver", "ImprovedObserver", "ObserverName", "Simulated", "make"]

EXTENDED_BANK, SHAPE_BANK = 24, 32  # multiples of model.compiled.BLOCK


def make(
    name: ObserverName, rig: RigDescription, seed: int = 0, smoothing: Smoothing | None = None
) -> BankObserver | ImprovedObserver:
    """The observer called `name` for `rig`; takes seconds when its C has to be compiled first.

    `smoothing` says where the smoother of a shape map runs; without it there is none, nor for other observers.
    """
    if name == "extended":
        return BankObserver(ExtendedFilters(rig, EXTENDED_BANK), rig, seed)
    bank = BankObserver(ShapeFilters(rig, SHAPE_BANK), rig, seed)
    return bank if smoothing is None else ImprovedObserver(bank, rig, smoothing)
