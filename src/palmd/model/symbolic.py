"""CasADi, loaded when something of it is first used: a process whose kernels have been built needs none of it."""

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

        def _found(self) -> Any:
            module = importlib.import_module("casadi")
            return getattr(module, self._name) if self._name else module

        def __getattr__(self, name: str) -> Any:
            value = getattr(self._found(), name)
            setattr(self, name, value)  # models ask for the same few a hundred thousand times
            return value

        def __call__(self, *arguments: Any) -> Any:
            return self._found()(*arguments)

    ca, SX = _Lazy(), _Lazy("SX")

__all__ = ["SX", "ca"]
