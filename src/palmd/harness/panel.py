"""What a person at the panel would do next, so that a demo needs none. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

AGAIN_S = 1.0
CALM_S = 0.5


class Panel:
    """Brings the palms to move and keeps them moving; looks at the bus as a person would.

    When somebody else holds or stops them it takes its hands off until they are started again.
    """

    def __init__(self) -> None:
        self._state: str | None = None
        self._hands_off = False
        self._t_told = -AGAIN_S
        self._wanted: str | None = None
        self._t_wanted = 0.0

    def see(self, state: Mapping[str, Any]) -> None:
        """Every palm/state: a hold or a stop without a fault is somebody's wish."""
        before, self._state = self._state, state.get("state")
        if before == self._state:
            return
        faulty = not {"hold", "stop"}.isdisjoint(state.get("severities", ()))
        if self._state == "hold":
            self._hands_off |= not faulty
        elif self._state == "ready":
            self._hands_off |= before in ("tracking", "hold")

    def decide(self, state: Mapping[str, Any], motion: Mapping[str, Any], t: float) -> str | None:
        """The command to give at t (s), from the last palm/state and palm/motion, None for none.

        After a hold or a fault it waits until things have been calm for `CALM_S`, and never hurries.
        """
        if state.get("state") == "tracking" and motion.get("segment", -1) >= 0:
            self._hands_off = False
        wanted = None if self._hands_off else self._wish(state, motion)
        if wanted != self._wanted:
            self._wanted, self._t_wanted = wanted, t
        patience = 0.0 if wanted == "arm" else CALM_S
        if wanted is None or t - self._t_wanted < patience or t - self._t_told < AGAIN_S:
            return None
        self._t_told = t
        return wanted

    def _wish(self, state: Mapping[str, Any], motion: Mapping[str, Any]) -> str | None:
        severities = set(state.get("severities", ()))
        match state.get("state"):
            case "ready" if "stop" not in severities:
                return "arm"
            case "tracking" if motion.get("segment", -1) < 0:
                return "start"
            case "hold" if not severities & {"hold", "stop"}:
                return "start"
            case "fault":
                return "reset"
        return None
