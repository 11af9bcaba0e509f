"""The arm link's conformance test: the emulated controller passes, and each deviation fails its own check."""

from dataclasses import replace

import pytest
from farend import BAUD, HOME, LIMITS, FarEnd

from palmd.devices import armlink
from palmd.devices.armlink import Ack, ArmState, HelloReply, LineReader, Refusal, SetPoint, Start, Stop, encode_reply
from palmd.rig import controller
from palmd.rig.controller import ArmLimits, Controller
from tools.conformance.arm_checks import CHECKS, MAX_EXCURSION_M, examine
from tools.conformance.arm_talk import Talk


def outcomes(make=Controller):
    return {result.number: result for result in FarEnd(make).examine()}


def failures(make):
    return {number for number, result in outcomes(make).items() if result.outcome == "failed"}


@pytest.mark.parametrize("phase_s", [0.0003, 0.0058, 0.0131])
def test_the_emulated_controller_passes_and_hardly_moves(phase_s):
    far_end = FarEnd(phase_s=phase_s)
    results = far_end.examine()
    assert [result for result in results if result.outcome != "passed"] == []
    assert far_end.far_m < MAX_EXCURSION_M
    assert far_end.controller.state is ArmState.READY


def test_static_checks_cause_no_motion():
    far_end, talk = FarEnd(), Talk(BAUD)
    for check in CHECKS:
        if not check.tracks:
            far_end.play(examine(check, talk))
    assert far_end.controller.counters.starts == 0


def test_a_controller_that_is_not_ready_is_not_tested():
    class Off(Controller):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.switch_power_off()

    results = outcomes(Off)
    assert results[2].outcome == "not run"
    assert "POWER_OFF" in results[2].seen


def test_a_large_acceleration_limit_leaves_the_clamp_untested(monkeypatch):
    monkeypatch.setattr("farend.LIMITS", ArmLimits(-0.2, 0.4, -0.3, 0.3, v_max=0.5, a_max=10.0))
    [clamp] = [result for result in outcomes().values() if result.outcome == "not run"]
    assert "5.9 m/s²" in clamp.seen


def test_a_check_disturbed_by_a_late_host_is_repeated():
    far_end = FarEnd()
    talk = Talk(BAUD)
    results = [far_end.play(examine(check, talk)) for check in CHECKS[:16]]
    assert {result.outcome for result in results} == {"passed"}
    for times, outcome in ((1, "passed"), (99, "failed")):
        late = LateHost(far_end, times)
        result = late.play(examine(CHECKS[16], talk))
        assert result.outcome == outcome
        assert ("late, make it idle" in result.seen) == (outcome == "failed")


class LateHost:
    """Sleeps for 200 ms instead of listening for 30, a number of times."""

    def __init__(self, far_end, times):
        self._far_end, self._times = far_end, times

    def play(self, script):
        return self._far_end.play(self._slowed(script))

    def _slowed(self, script):
        say = next(script)
        while True:
            slow = self._times > 0 and say.listen_s == 0.03
            self._times -= slow
            heard = yield replace(say, listen_s=0.2, enough=0) if slow else say
            try:
                say = script.send(heard)
            except StopIteration as end:
                return end.value


class Careless(LineReader):
    """Accepts lines whatever their checksum."""

    def _check(self, raw):
        body = raw.rpartition(b"*")[0]
        return body.decode("ascii", errors="replace") or None


class Deaf(LineReader):
    """After a bad line, loses the next one too."""

    _lost = False

    def _check(self, raw):
        body = None if self._lost else super()._check(raw)
        self._lost = body is None and not self._lost
        return body


def reading(reader):
    class Broken(Controller):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.reader = reader(BAUD)

    return Broken


class AnswersSuperseded(Controller):
    def _execute(self, command, t, actual):
        out = b""
        if isinstance(command, SetPoint) and self._pending is not None:
            out = encode_reply(Ack(self._pending.ss, self.state, actual))
        return out + super()._execute(command, t, actual)


class QueuesSetpoints(Controller):
    """Uses the earlier of two."""

    def _execute(self, command, t, actual):
        if isinstance(command, SetPoint) and self._pending is not None:
            return b""
        return super()._execute(command, t, actual)


class AnnouncesTwice(Controller):
    def _finish_deceleration(self):
        super()._finish_deceleration()
        self._unsolicited *= 2


class AnnouncesNothing(Controller):
    def _finish_deceleration(self):
        super()._finish_deceleration()
        self._unsolicited = b""


class FeedsOnRefused(Controller):
    def _consume(self, setpoint, t, actual):
        reply = super()._consume(setpoint, t, actual)
        if isinstance(reply, Refusal):
            self._t_alive = self._t_setpoint = t
        return reply


class ForgetsRepeats(Controller):
    """Mistakes a repeated command for a new one."""

    def _reply(self, _key, reply):
        super()._reply(None, reply)
        return encode_reply(reply)


class FeedsOnRepeats(Controller):
    def _execute(self, command, t, actual):
        if isinstance(command, SetPoint) and ("SetPoint", command.ss) == self._last_key:
            self._t_alive = self._t_setpoint = t
        return super()._execute(command, t, actual)


class StopsSilently(Controller):
    """Reports R at once, without D."""

    def _execute_plain(self, command, t, actual):
        reply = super()._execute_plain(command, t, actual)
        if isinstance(command, Stop) and isinstance(reply, Ack):
            self.state = ArmState.READY
            reply = Ack(command.ss, self.state, actual)
        return reply


class StartsAgain(Controller):
    def _execute_plain(self, command, t, actual):
        if isinstance(command, Start) and self.state is ArmState.TRACKING:
            self._start_tracking(t, actual)
            return Ack(command.ss, self.state, actual)
        return super()._execute_plain(command, t, actual)


class HoldsBeforeTheFirst(Controller):
    def _start_tracking(self, t, actual):
        super()._start_tracking(t, actual)
        self._t_setpoint = t


class ResumesAnywhere(Controller):
    def _consume(self, setpoint, t, actual):
        if self.state is ArmState.HOLD:
            self.state = ArmState.TRACKING
        return super()._consume(setpoint, t, actual)


class TakesTheFirstAnywhere(Controller):
    def _consume(self, setpoint, t, actual):
        self._t_setpoint = t if self._t_setpoint is None else self._t_setpoint
        return super()._consume(setpoint, t, actual)


class StandsStill(Controller):
    def _move(self):
        pass


class ForgetsFaults(Controller):
    def _finish_deceleration(self):
        super()._finish_deceleration()
        self.state = ArmState.READY


class LosesNumbers(Controller):
    def _execute_plain(self, command, t, actual):
        reply = super()._execute_plain(command, t, actual)
        return Ack(reply.ss & 0x7F, reply.state, reply.pose) if isinstance(reply, Ack) else reply


class IsWide(ArmLimits):
    def contain(self, _pose):
        return True


class Roams(Controller):
    """Has neither workspace nor largest step."""

    def __init__(self, limits, *arguments):
        wide = IsWide(limits.x_min, limits.x_max, limits.y_min, limits.y_max, limits.v_max, limits.a_max)
        super().__init__(wide, *arguments)


class Bolts(Controller):
    """Limits neither speed nor acceleration, and refuses no jump."""

    def __init__(self, limits, *arguments):
        super().__init__(limits, *arguments)
        self._announced = limits
        self.limits = ArmLimits(limits.x_min, limits.x_max, limits.y_min, limits.y_max, 100.0, 1e6)

    def _execute(self, command, t, actual):
        if isinstance(command, armlink.Hello):
            return encode_reply(self._announced.hello())
        return super()._execute(command, t, actual)


class SaysOtherLimits(Controller):
    def _execute(self, command, t, actual):
        if isinstance(command, armlink.Hello):
            return encode_reply(HelloReply(0.016, 0.3, 0.4, -0.3, 0.3, 0.5, 5.0))
        return super()._execute(command, t, actual)


class IsSlow(Controller):
    """Uses a set-point two cycles late."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._late = [b"", b""]

    def cycle(self, t, actual):
        self._late.append(super().cycle(t, actual))
        return self._late.pop(0)


BROKEN = {
    "checksum ignored": (reading(Careless), {4}),
    "deaf after noise": (reading(Deaf), {5}),
    "superseded answered": (AnswersSuperseded, {15}),
    "first of two taken": (QueuesSetpoints, {15}),
    "fault announced twice": (AnnouncesTwice, {12, 19}),
    "fault not announced": (AnnouncesNothing, {12, 19}),
    "refused feed the watchdog": (FeedsOnRefused, {23}),
    "repeats taken for new": (ForgetsRepeats, {10, 16}),
    "repeats feed the watchdog": (FeedsOnRepeats, {16}),
    "R at once after P": (StopsSilently, {11}),
    "G in T granted": (StartsAgain, {10}),
    "hold before the first S": (HoldsBeforeTheFirst, {12, 21}),
    "resumes anywhere": (ResumesAnywhere, {18}),
    "first S anywhere": (TakesTheFirstAnywhere, {21}),
    "never moves": (StandsStill, {20}),
    "faults not latched": (ForgetsFaults, {12, 13, 19}),
    "numbers cut short": (LosesNumbers, {7}),
    "no workspace": (Roams, {22}),
    "no clamps": (Bolts, {24, 25}),
    "limits elsewhere": (SaysOtherLimits, {2}),
    "slow": (IsSlow, {14}),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_deviating_controller_fails_the_right_check(name):
    make, where = BROKEN[name]
    assert where <= failures(make)


@pytest.mark.parametrize(
    ("constant", "value", "where"),
    [
        ("HOLD_AFTER_S", 0.112, {17}),
        ("HOLD_AFTER_S", 0.016, {17}),
        ("GIVE_UP_AFTER_S", 0.320, {12, 19}),
        ("GIVE_UP_AFTER_S", 0.112, {12, 19}),
        ("WRONG_STATE", -622, {8, 10, 13}),
        ("LINK_LOST", -601, {12, 19}),
        ("STEP_TOO_LARGE", -610, {18, 21, 24}),
        ("OUTSIDE", -611, {22}),
        ("RESUME_WITHIN_M", 8e-3, {18, 21}),
    ],
)
def test_a_wrong_constant_is_detected(monkeypatch, constant, value, where):
    monkeypatch.setattr(controller, constant, value)
    assert where <= failures(Controller)


def test_a_cycle_other_than_announced_is_detected(monkeypatch):
    monkeypatch.setattr("farend.CYCLE_S", 0.020)
    assert 14 in failures(Controller)


@pytest.mark.parametrize("newline", [b"\n", b"\r"])
def test_wrong_line_ends_are_detected(monkeypatch, newline):
    monkeypatch.setattr(armlink, "CONTROLLER_NEWLINE", newline)
    assert failures(Controller)


def test_motion_of_a_deviating_controller_is_bounded():
    """A jump is taken back in the next cycle."""
    far_end = FarEnd(Bolts)
    far_end.examine()
    assert far_end.far_m < 4.0 * LIMITS.v_max * controller.CYCLE_S
    assert far_end.controller.path.x_m == pytest.approx(HOME.x_m, abs=1e-3)
