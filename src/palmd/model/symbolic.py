"""CasADi, imported lazily at its first use: a process whose kernels are already built never loads it."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import casadi as ca
    from casadi import SX
else:

    class _Lazy:
        def __init__(self, name: str = "") -> None:
            self._name = name

        def _loaded(self) -> Any:
            module = importlib.import_module("casadi")
            return getattr(module, self._name) if self._name else module

        def __getattr__(self, name: str) -> Any:
            value = getattr(self._loaded(), name)
            setattr(self, name, value)  # cached: models access the same few names a hundred thousand times
            return value

        def __call__(self, *arguments: Any) -> Any:
            return self._loaded()(*arguments)

    ca, SX = _Lazy(), _Lazy("SX")

__all__ = ["SX", "ca"]
