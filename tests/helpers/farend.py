"""A controller at the far end of a serial line, in virtual time, for the arm link's conformance scripts."""

import math

from palmd.devices.armlink import LineReader, Pose
from palmd.rig.arm import Servo, wrap_angle
from palmd.rig.controller import CYCLE_S, ArmLimits, Controller
from palmd.rig.line import Wire
from tools.conformance.arm_checks import CHECKS, examine
from tools.conformance.arm_talk import Talk, TalkAnswer

BAUD = 38400
LIMITS = ArmLimits(-0.2, 0.4, -0.3, 0.3, v_max=0.5, a_max=5.0)
HOME = Pose(0.1, 0.02, 1.0)
STEP_S = 0.5e-3


class FarEnd:
    """Controller, servo of its arm, and both directions of the line at their real rate."""

    def __init__(self, make=Controller, phase_s=0.0067):
        self.controller = make(LIMITS, HOME, BAUD, lambda _pose, _t: None)
        self._servos = [Servo(axis) for axis in (HOME.x_m, HOME.y_m, HOME.t_rad)]
        self._to, self._from = Wire(BAUD), Wire(BAUD)
        self._steps, self._t_cycle = 0, phase_s
        self._reader = LineReader(BAUD)
        self.far_m = 0.0

    @property
    def t(self):
        return self._steps * STEP_S

    def _actual(self):
        x, y, angle = (servo.at(self.t)[0] for servo in self._servos)
        self.far_m = max(self.far_m, math.hypot(x - HOME.x_m, y - HOME.y_m))
        return Pose(x, y, wrap_angle(angle))

    def _step(self):
        self._steps += 1
        arrived = self._to.take(self.t)
        if arrived:
            self._from.send(self.controller.feed(arrived, self.t, self._actual()), self.t)
        if self.t >= self._t_cycle:
            self._t_cycle += CYCLE_S
            self._from.send(self.controller.cycle(self.t, self._actual()), self.t)
            path = self.controller.path
            for servo, goal in zip(self._servos, (path.x_m, path.y_m, path.t_rad), strict=True):
                servo.follow(self.t, (goal - servo.goal(self.t)) / CYCLE_S)

    def _listen(self, t_end, enough=0):
        lines, raw = [], b""
        while self.t < t_end and not (enough and len(lines) >= enough):
            self._step()
            heard = self._from.take(self.t)
            raw += heard
            lines += self._reader.feed(heard, self.t)
        return lines, raw

    def play(self, script):
        """The script's outcome."""
        heard = None
        while True:
            try:
                say = script.send(heard)
            except StopIteration as end:
                return end.value
            before, raw_before = self._listen(say.t_send)
            t_sent = self.t
            self._to.send(say.data, t_sent)
            lines, raw = self._listen(t_sent + say.listen_s, max(0, say.enough - len(before)))
            heard = TalkAnswer(before + lines, raw_before + raw, t_sent, self.t)

    def results(self):
        """The outcome of every check, one by one."""
        talk = Talk(BAUD)
        for check in CHECKS:
            yield self.play(examine(check, talk))

    def examine(self):
        """The outcome of every check."""
        return list(self.results())
