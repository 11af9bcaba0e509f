"""The emulated rig on the guest's clock: `farside.py FOLDER`. Its ports are in FOLDER; QEMU connects to FOLDER/clock.

The guest sends its time each millisecond; the rig advances to that time and confirms. Both agree on the time, however
slow the guest is. While no guest runs, the rig's time stands still.
"""

import json
import select
import socket
import sys
from pathlib import Path

from palmd.daemon import realtime
from palmd.quantities import BODY, TRUTH
from palmd.rig.app import OBJECT_S, TRUTH_S, RigProcess, StopSignal
from palmd.rig.world import World, default_config

WAIT_S = 0.1
SEED = 3


class GuestsRig(RigProcess):
    """The rig process on the guest's time; see the module."""

    def __init__(self, folder: Path) -> None:
        self.heard_ns = 0
        super().__init__(World(default_config(), SEED, t=0.0), folder, StopSignal())
        path = folder / "clock"
        path.unlink(missing_ok=True)
        self._listening = socket.socket(socket.AF_UNIX)
        self._listening.bind(str(path))
        self._listening.listen(1)
        self._clock: socket.socket | None = None
        self._ahead_s: float | None = None  # of the guest's clock
        self._rest = b""

    def run(self) -> None:
        truth_due = object_due = 0.0
        while True:
            t = self._time()
            self._serve()
            if t is None:
                continue
            self._tick(t)
            if t >= truth_due:
                truth_due = t + TRUTH_S
                self._publish(TRUTH, self.world.truth())
            if t >= object_due:
                object_due = t + OBJECT_S
                self._publish(BODY, self.world.object_truth())

    def _time(self) -> float | None:
        """The rig's time (s) by the guest's last message, None before the first."""
        source = self._clock or self._listening
        if not select.select([source], [], [], WAIT_S)[0]:
            return None
        if self._clock is None:
            self._clock, self._ahead_s, self._rest = self._listening.accept()[0], None, b""
            return None
        data = self._clock.recv(1 << 16)
        if not data:  # its power is off
            self._clock.close()
            self._clock = None
            return None
        data = self._rest + data
        whole = len(data) // 8 * 8
        self._rest = data[whole:]
        if not whole:
            return None
        self.heard_ns = int.from_bytes(data[whole - 8 : whole], sys.byteorder)
        if self._ahead_s is None:
            self._ahead_s = self.world.t - self.heard_ns * 1e-9
        return self._ahead_s + self.heard_ns * 1e-9

    def _status(self) -> dict[str, object]:
        return super()._status() | {"guest_ns": self.heard_ns}


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    realtime.prepare(realtime.RIG_PRIORITY)
    rig = GuestsRig(folder)
    print(json.dumps(rig.addresses()), flush=True)
    rig.run()
