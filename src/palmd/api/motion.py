"""Motions as context managers: a move, an exploration, jogging. An exception inside the block stops the palms."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Self

import yaml

from palmd.api.errors import PalmdError, as_palmd_error
from palmd.bus.jogging import jog
from palmd.quantities import ESTIMATE, STATE
from palmd.system.mechanism import JOINTS

if TYPE_CHECKING:
    from palmd.api.live import Live

HELD_S = 30.0
"""Longest hold, in which its cause may be removed and the motion started again."""

STANDING_S, LOOK_S = 3.0, 0.1
"""Longest time in which held palms come to rest, and the polling period."""

_CAN_MOVE = ("ready", "tracking", "hold")


class Armed:
    """Arms the rig for the block if it is not armed yet; if so, stops it at the end."""

    def __init__(self, rig: Live) -> None:
        self._rig = rig
        self._armed_here = False

    def __enter__(self) -> Self:
        """Raises PalmdError with the cause if the arm cannot be armed."""
        status = self._rig.status()
        if status["state"] not in _CAN_MOVE:
            raise PalmdError(f"cannot move: the state is {status['state']}: {_why(status)}")
        if status["state"] == "ready":
            self._rig.command("arm")
            self._armed_here = True
        try:
            self._begin()
        except BaseException:
            self._disarm()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._finish()
            else:
                self._hold()
        except BaseException:
            self._hold()
            raise
        finally:
            self._disarm()

    def _begin(self) -> None:
        """Called when the block is entered."""

    def _finish(self) -> None:
        """Called to wait when the block is left without an exception."""

    def _hold(self) -> None:
        with suppress(PalmdError):
            self._rig.command("hold")

    def _disarm(self) -> None:
        if self._armed_here:
            self._armed_here = False
            with suppress(PalmdError):
                self._rig.command("stop")


class RigMotion(Armed):
    """A plan of one segment: iterating yields the estimates during it; leaving the block waits for its end.

    An exception inside the block, Ctrl-C too, holds the palms.
    """

    def __init__(self, rig: Live, name: str, segment: Mapping[str, Any]) -> None:
        super().__init__(rig)
        self._plan = {"name": name, "segments": [dict(segment)]}
        self.over = False
        self.coverage = math.nan
        """Of an exploration: fraction touched of the reachable normals."""
        self.reason = ""
        """Of an exploration: why it ended."""

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """The fields of `palm/estimate`, tick by tick, until the motion is complete; PalmdError if it was stopped."""
        if self.over:
            return
        t_tracking = time.monotonic()
        for message in self._rig.messages(ESTIMATE.name, STATE.name):
            if message.topic == ESTIMATE.name:
                yield message.fields
                continue
            fields = message.fields
            self.coverage, self.reason = fields["coverage"], fields["reason"]
            if fields["state"] == "tracking" and self._rig.status()["over"]:
                self.over = True
                return
            if fields["state"] == "tracking":
                t_tracking = time.monotonic()
            elif fields["state"] != "hold" or time.monotonic() > t_tracking + HELD_S:
                raise PalmdError(f"{self._plan['name']}: the state is {fields['state']}: {_why(fields)}")

    def wait(self) -> None:
        """Wait until the motion is complete; PalmdError if it was stopped."""
        for _ in self:
            pass

    def end(self) -> None:
        """Hold the palms now and do not wait for the end."""
        self.over = True
        self._rig.command("hold")

    def _begin(self) -> None:
        t_end = time.monotonic() + STANDING_S
        while self._rig.status()["moving"] and time.monotonic() < t_end:  # a held motion may not have come to rest yet
            time.sleep(LOOK_S)
        name = f"{self._plan['name']}.yaml"
        self._rig.command("plan", path=name, text=yaml.safe_dump(self._plan))
        self._rig.command("start")

    def _finish(self) -> None:
        self.wait()


class RigJog(Armed):
    """Turns the palms by small steps."""

    def turn(self, **angles_deg: float) -> None:
        """Turn joints, each given by its name with `_deg`, by so much, and wait for their arrival; 8° per second.

        Raises PalmdError, without moving anything, if the whole motion is not possible.
        """
        if not angles_deg:
            raise PalmdError(f"jog: name the joint to turn, for example turn({JOINTS[0]}_deg=1.0)")
        with as_palmd_error():
            reply = jog(self._rig.client, angles_deg)
        if not reply["ok"]:
            raise PalmdError(str(reply.get("error", "jog refused")))


def _why(fields: Mapping[str, Any]) -> str:
    blocking = [
        f"{code}: {hint}"
        for code, severity, hint in zip(fields["faults"], fields["severities"], fields["hints"], strict=True)
        if severity in ("hold", "stop")
    ]
    return "; ".join(blocking) or fields.get("cause") or "the cause is unknown"
