"""The live observer of a body between three palms, against the plant, which has other equations."""

import math
from dataclasses import replace
from functools import partial

import msgpack
import numpy as np
import pytest
from plain_body_filter import PlainFilter

from palmd import three_palms_messages as says
from palmd.events import PadLift, PadSample, PalmSample
from palmd.harness.three_palms_comparison import between, matrix, surface_error
from palmd.model.icosphere import icosphere
from palmd.model.rotation import exp, quaternion
from palmd.model.spherical import Y00, count, evaluator
from palmd.model.three_palms import MOMENT
from palmd.observer.three_palms import beliefs, incremental, live, propagation, reconstruct
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.body import FINER_ORDERS_LIVE, ORDER, inertia
from palmd.observer.three_palms.body_filter import BodyFilter, PlaneReading
from palmd.observer.three_palms.equations import BodyMotion
from palmd.observer.three_palms.incremental import IncrementalBodySmoother
from palmd.observer.three_palms.joint_track import JointTrack
from palmd.observer.three_palms.live import BodyObserver
from palmd.observer.three_palms.propagation import BodyHypothesis, propagate, propagate_and_prune
from palmd.observer.three_palms.smoother import BodySmoother
from palmd.observer.three_palms.touched_outline import directions_near, touched_outline
from palmd.rig.three_palms.bodies import Bodies, random_bodies, random_rotation
from palmd.rig.three_palms.plant import BodyOnPalms, FrictionParameters
from palmd.system.three_palms import GAP_S, BodyAnswer, ThreePalmsRig, palms_at, readings_of

RIG = ThreePalmsRig()
SEED = 7
PHASE = np.array([0.3, 1.5, -0.8])


def joints(t):
    """(angle, rate, acceleration) of all joints, each (T, 3)."""
    t, w = np.atleast_1d(t)[:, None], np.array([3.0, 2.0, 2.5])
    return (
        np.array([0.9, 0.8, 0.8]) + 0.15 * np.sin(w * t), 0.15 * w * np.cos(w * t), -0.15 * w**2 * np.sin(w * t)
    )  # fmt: skip


def planes(t):
    return palms_at(*joints(t))


def inputs_of(each):
    return np.concatenate(
        [kind.reshape(-1, 9) for kind in (each.normal, each.normal_rate, each.normal_acceleration, each.spin)], axis=1
    )


def inputs(t):
    return inputs_of(planes(t))


class Rolled:
    """A smooth body on moving palms for 0.4 s, and its parameters as the observer has them: none of its own."""

    def __init__(self):
        rng = np.random.default_rng(2)
        turns = np.linalg.qr(rng.normal(size=(2, 3, 3)))[0]
        axes = np.exp(rng.normal(0.0, 0.1, (2, 3)))
        forms = np.einsum("eij,ej,ekj->eik", turns, axes**2, turns) * 0.005**2
        points = rng.normal(size=(12, 3))
        self.inertia = np.diag([1.5e-4, 1.7e-4, 1.6e-4])
        body = Bodies(
            np.array([0.01]), forms[None], 1e-7 * points[None], np.array([4.0]), np.array([[4e-4, -3e-4, 5e-4]]),
            self.inertia[None],
        )  # fmt: skip
        self.p = parameters(lambda u: body.support(u[None])[0][0], self.inertia, 8)
        self.p[-3] = 1e-4
        plant = BodyOnPalms(body, FrictionParameters(np.array([0.1]), np.array([0.01]), np.array([1e-4])), 9.81)
        R, at = random_rotation(rng, 1), planes(0.0)
        normal, rate = at.normal[0], at.normal_rate[0]
        h, x, _ = body.support(-np.einsum("bji,nj->bni", R, normal))
        centre, omega = np.linalg.solve(normal, h[0]), np.array([0.5, -0.3, 0.2])
        r = np.einsum("ij,nj->ni", R[0], x[0])
        lift = -rate @ centre + (r * (np.cross(omega, normal) - rate)).sum(-1)
        plant.begin(centre, np.linalg.solve(normal, lift), R, omega)
        self.t = 2e-3 * np.arange(1, 201)
        self.states, self.read, self.force = [], [], []
        self.begun = R[0], omega
        for t in self.t:
            plant.advance(np.concatenate([inputs(t - 2e-3), inputs(t - 1e-3), inputs(t)]), 2e-3)
            self.states.append(plant.state.copy())
            self.read.append(readings_of(planes(t), plant.point[None])[0])
            self.force.append(plant.force.copy())

    def belief(self, spin_off=0.0):
        R, omega = self.begun
        width = 6 + len(self.p)
        sd = np.array([1e-3] * 3 + [0.3] * 3 + [1e-6] * (width - 6))
        none = np.zeros(0)
        return BodyAnswer(
            0.0, 0.0, True, "", 1, R, omega + spin_off, self.p, np.diag(sd**2), none, none, none, none, 0.06, 1e-3
        )


@pytest.fixture(scope="module")
def rolled():
    return Rolled()


def tracked():
    """The joints as they are reported every 2 ms."""
    t = 2e-3 * np.arange(-1, 210)
    first, *others = (PalmSample(at, *map(tuple, each)) for at, *each in zip(t.tolist(), *joints(t), strict=True))
    track = JointTrack(first)
    for each in others:
        track.take(each)
    return track


def carried(filtered, readings, until):
    filtered.propagate(readings, until, tracked())


def test_a_step_keeps_to_the_motion_of_a_body_in_six_degrees_of_freedom(rolled):
    filtered = BodyFilter(rolled.belief(), RIG)
    carried(filtered, [], 0.4)
    true = rolled.states[-1]
    assert np.abs(true[15:] - rolled.begun[1]).max() > 0.3  # there is something to foretell
    assert filtered.omega == pytest.approx(true[15:], abs=3e-3)
    assert np.abs(filtered.R - true[6:15].reshape(3, 3)).max() < 1e-3


def test_readings_tell_the_spin_that_was_not_known(rolled):
    filtered = BodyFilter(rolled.belief(spin_off=0.2), RIG)
    rng = np.random.default_rng(1)
    sd = math.sqrt(RIG.pad.reading_variance)
    readings = [
        PlaneReading(t, k % 3, *(rolled.read[k][k % 3] + sd * rng.normal(size=2))) for k, t in enumerate(rolled.t)
    ]
    carried(filtered, readings[:-1], rolled.t[-1])
    off = filtered.omega - rolled.states[-1][15:]
    band = np.sqrt(np.diagonal(filtered.P)[3:6])
    assert band.max() < 0.1
    assert np.abs(off / band).max() < 3.5
    assert 0.7 < filtered.nis < 1.4


def test_readings_that_are_missed_by_more_than_their_noise_surprise_as_little_where_that_is_told(rolled):
    rng, rough = np.random.default_rng(1), 1.5e-4
    sd = math.hypot(math.sqrt(RIG.pad.reading_variance), rough)
    readings = [
        PlaneReading(t, k % 3, *(rolled.read[k][k % 3] + sd * rng.normal(size=2))) for k, t in enumerate(rolled.t)
    ]
    told, untold = (BodyFilter(replace(rolled.belief(), unexplained_sd=each), RIG) for each in (rough, 0.0))
    for each in (told, untold):
        carried(each, readings[:-1], rolled.t[-1])
    assert 0.7 < told.nis < 1.3 < untold.nis
    assert told._compiled is untold._compiled  # nothing is kept of each answer


def test_what_is_compiled_is_its_twin_in_numpy(rolled):
    rng = np.random.default_rng(4)
    width = 6 + len(rolled.p)
    root = rng.normal(size=(width, width)) * np.array([1e-3] * 3 + [0.1] * 3 + [1e-4] * (width - 6))[:, None]
    belief = replace(rolled.belief(spin_off=0.1), covariance=root @ root.T / width, unexplained_sd=7e-5)
    readings = [
        PlaneReading(rolled.t[k], k % 3, *(rolled.read[k][k % 3] + 1e-4 * rng.normal(size=2))) for k in range(3, 60)
    ]
    readings[20] = replace(readings[20], a=0.5)  # is not fused
    compiled, twin = (make(belief, RIG) for make in (BodyFilter, PlainFilter))
    sd = np.sqrt(np.diagonal(belief.covariance))
    for each in (compiled, twin):
        carried(each, readings, 0.15)
    assert pytest.approx(twin.R, abs=1e-9) == compiled.R
    assert compiled.omega == pytest.approx(twin.omega, abs=1e-8)
    assert np.abs((compiled.p - twin.p) / sd[6:]).max() < 1e-7
    assert np.abs((compiled.P - twin.P) / np.outer(sd, sd)).max() < 1e-7
    assert (compiled.P == compiled.P.T).all()
    assert compiled.nis == pytest.approx(twin.nis, rel=1e-7)
    one, other = compiled.outputs(tracked(), 0.15), twin.outputs(tracked(), 0.15)
    for name in ("contacts", "centre", "heights"):
        for mine, its in zip(getattr(one, name), getattr(other, name), strict=True):
            assert mine == pytest.approx(its, rel=1e-6, abs=1e-9)
    assert one.force == pytest.approx(other.force, rel=1e-6)


def test_contacts_centre_heights_and_forces_are_the_plants(rolled):
    k = 100
    R, omega = rolled.states[k][6:15].reshape(3, 3), rolled.states[k][15:]
    filtered = BodyFilter(replace(rolled.belief(), t=rolled.t[k], R=R, omega=omega), RIG)
    seen = filtered.outputs(tracked(), rolled.t[k])
    assert np.abs(seen.contacts[0] - rolled.read[k]).max() < 2e-6
    assert np.abs(seen.centre[0] - rolled.states[k][:3]).max() < 1e-6
    assert np.abs(seen.heights[0] - planes(rolled.t[k]).normal[0] @ rolled.states[k][:3]).max() < 1e-6
    assert seen.force == pytest.approx(rolled.force[k], rel=0.02)
    assert seen.centre[1].shape == (3,)


def test_a_quaternion_is_its_rotation():
    for R in random_rotation(np.random.default_rng(3), 20):
        assert np.abs(matrix(quaternion(R)) - R).max() < 1e-12


# ---------------------------------------------------------------- from a blind start to an estimate, on a log's events


class Stub:
    """A smoother that answers when it is told to."""

    def __init__(self):
        self.next = None

    def submit(self, *_):
        pass

    def collect(self, _):
        answer, self.next = self.next, None
        return answer


def swung(t):
    """Joints that stand until 0.5 s, then swing."""
    t, w = np.maximum(np.atleast_1d(t)[:, None] - 0.5, 0.0), np.array([2.6, 2.1, 3.0])
    x = np.clip(t / 1.0, 0.0, 1.0)
    ease = 10 * x**3 - 15 * x**4 + 6 * x**5, 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)
    wave = 0.18 * np.sin(w * t + PHASE), 0.18 * w * np.cos(w * t + PHASE), -0.18 * w**2 * np.sin(w * t + PHASE)
    return (
        np.array([0.9, 0.8, 0.8]) + ease[0] * wave[0],
        ease[1] * wave[0] + ease[0] * wave[1],
        ease[2] * wave[0] + 2 * ease[1] * wave[1] + ease[0] * wave[2],
    )


def parameters(h_of, inertia, order):
    """Of a body by its support function and inertia; no drag, and friction as believed beforehand."""
    u, n = icosphere()[0], count(order)
    c = np.linalg.lstsq(evaluator(order)(u)[0], h_of(u), rcond=None)[0]
    lam = np.linalg.cholesky(0.5 * np.trace(inertia) * np.eye(3) - inertia) / (MOMENT * Y00 * c[0])
    lam[np.diag_indices(3)] = np.log(np.diagonal(lam))
    return np.concatenate([c[:n], lam[np.tril_indices(3)], [0.0, 0.1, math.log(0.01)]])


class Lived:
    """Readings of a body on swinging palms, and a smoother that is led to the right start: a blind one takes long."""

    FIRST, END, SECONDS, STEP = 4.4, 4.9, 5.6, 2e-3

    def __init__(self):
        rng = np.random.default_rng(SEED)
        self.rig = RIG
        plant = BodyOnPalms(
            random_bodies(1, rng), FrictionParameters(np.array([0.1]), np.array([0.01]), np.zeros(1)), 9.81
        )
        self._settle(plant, rng)
        self.h_of = lambda at: plant.body.support(at[None])[0][0]
        self.inertia = plant.body.inertia[0]
        self.t = self.STEP * np.arange(round(self.SECONDS / self.STEP) + 1)
        halves = palms_at(*swung(0.5 * self.STEP * np.arange(2 * len(self.t) - 1)))
        inputs, states, points, force = inputs_of(halves), [plant.state.copy()], [], []
        for k in range(0, len(inputs) - 2, 2):
            plant.advance(inputs[k : k + 3], self.STEP)
            states.append(plant.state.copy())
            points.append(plant.point.copy())
            force.append(plant.force.copy())
        self.states = np.stack(states)
        read = readings_of(palms_at(*swung(self.t)), np.stack([points[0], *points]))
        self.events = self._said(read, np.stack([force[0], *force]), rng)
        with pytest.MonkeyPatch.context() as led:
            led.setattr(incremental, "fit_blind_starts", lambda task, record, _: self._right(task, record))
            led.setattr(incremental, "propagate_and_prune", self._followed)
            smoother = self.smoother = IncrementalBodySmoother(self.rig)
            smoother.add([event for event in self.events if event.t_sample < self.FIRST])
            self.first = smoother.answer()
            smoother.add([event for event in self.events if self.FIRST <= event.t_sample < self.END])
            self.answer = smoother.answer()

    def _settle(self, plant, rng):
        R, at = random_rotation(rng, 1), palms_at(*swung(np.zeros(3)))
        h = plant.body.support(-np.einsum("bji,nj->bni", R, at.normal[0]))[0][0]
        slow = BodyOnPalms(plant.body, FrictionParameters(np.zeros(1), np.ones(1), np.full(1, 4e-3)), 9.81)
        slow.begin(np.linalg.solve(at.normal[0], h), np.zeros(3), R, np.zeros(3))
        for _ in range(1500):
            slow.advance(inputs_of(at), self.STEP)
        plant.state[:] = slow.state
        plant.state[3:6] = plant.state[15:] = 0.0

    def _said(self, read, force, rng):
        angle, rate, acceleration = swung(self.t[::8])
        angle = angle + self.rig.angle_noise * rng.normal(size=angle.shape)
        events = [
            PalmSample(t, *map(tuple, each)) for t, *each in zip(self.t[::8], angle, rate, acceleration, strict=True)
        ]
        step = self.rig.pad.resolution
        for k in range(len(self.t)):
            if k % 5 < 3:  # each pad every 10 ms
                a, b = step * np.round((read[k, k % 5] + self.rig.pad.noise * rng.normal(size=2)) / step)
                events.append(PadSample(self.t[k], k % 5 + 1, b, 0.06 * force[k, k % 5], a))
        return sorted(events, key=lambda event: event.t_sample)

    def truth(self, t):
        return np.array([np.interp(t, self.t, column) for column in self.states.T])

    def _followed(self, task, running, *how, **ways):
        ended = propagate_and_prune(task, running, *how, **ways)
        self.raced = task, [replace(each, confirmed=each.intervals) for each in ended]
        return self.raced[1]

    def _right(self, task, record):
        x = self.states[np.round(record.t / self.STEP).astype(int)]
        R, omega = x[:, 6:15].reshape(-1, 3, 3), x[:, 15:]
        self.gauge = R[0].T
        # R = 1 at the first node: the body's frame is turned
        p = parameters(lambda u: self.h_of(u @ R[0]), R[0] @ self.inertia @ R[0].T, ORDER)
        prior = beliefs.prior(Y00 * p[0], ORDER, task.spin_sd)
        smoother = BodySmoother(record, prior, task.noise, self.rig)
        fit = smoother.fit(BodyMotion(R @ R[0].T, omega, p), 12)
        now = BodyHypothesis(prior, record, fit.motion, smoother.end_belief(fit), fit.cost, fit)
        return [now]

    def told(self, observer, stub, until, answer_at):
        said, waiting, t = [], iter(self.events), self.END - 0.4
        event = next(waiting)
        while t < until:
            t += 0.01
            while event.t_sample <= t:
                observer.feed(event)
                event = next(waiting)
            if t >= answer_at and self.answer is not None and not observer.improvements:
                stub.next = self.answer
            observer.improve(t)
            said.append(observer.estimate(t))
        return said


@pytest.fixture(scope="module")
def lived():
    return Lived()


def test_the_smoother_goes_on_with_what_it_has(lived):
    assert lived.first is not None
    assert lived.answer.accepted, lived.answer.reason
    assert lived.answer.t == pytest.approx(lived.END, abs=0.05)
    assert lived.answer.t > lived.first.t + 0.4


def test_where_all_of_a_record_tells_nothing_it_is_tried_with_more_then_short_starts_then_anew(lived, monkeypatch):
    task, (first, *_) = lived.raced
    smoother, sought, numbers = IncrementalBodySmoother(lived.rig), [], 2 * len(first.record.readings.t)
    dear, strange = (replace(first, cost=share * numbers) for share in (1.4, 1.1))
    told = []
    monkeypatch.setattr(
        incremental, "fit_blind_starts", lambda _, record, __: sought.append(record.t[-1] - record.t[0]) or told
    )
    monkeypatch.setattr(incremental, "start_candidates", lambda _, seconds: sought.append(seconds) or [])
    monkeypatch.setattr(incremental, "branch_starts", lambda _, found, **__: found)
    monkeypatch.setattr(smoother, "_restart_record", lambda _: sought.append("anew"))
    assert not smoother._start_search(task)  # all were given up
    told = [dear]
    assert not any(smoother._start_search(task) for _ in range(2))
    whole = pytest.approx(task.end - task.start, abs=0.03)
    assert sought == [whole, whole, incremental.SHORT_START_S, "anew"]
    told = [strange]
    assert not smoother._start_search(task)  # some more may lead elsewhere
    assert smoother._start_search(task)
    assert smoother._hypotheses == [strange]
    monkeypatch.setattr(incremental, "start_candidates", lambda *_: [first, dear, replace(first, cost=math.inf)])
    assert smoother._start_search(task)  # of so short a record more is followed
    assert smoother._hypotheses == [first, dear]


def test_what_two_starts_of_all_of_a_record_have_met_in_is_found_twice_at_once(lived, monkeypatch):
    task, (first, *_) = lived.raced
    met = replace(first, confirmed=first.intervals)
    monkeypatch.setattr(incremental, "fit_blind_starts", lambda *_: [replace(first, confirmed=0)])
    monkeypatch.setattr(incremental, "confirm_by_restarts", lambda *_: [met, replace(first, confirmed=0)])
    smoother = IncrementalBodySmoother(lived.rig)
    assert smoother._start_search(task)
    assert [each.is_confirmed for each in smoother._hypotheses] == [True, False]


def test_what_was_found_but_once_is_not_claimed(lived):
    task, (first, *_) = lived.raced
    enough = -(-2 * first.intervals // 3)
    assert lived.smoother._make_answer(task, [replace(first, confirmed=enough)]).accepted
    said = lived.smoother._make_answer(task, [replace(first, confirmed=enough - 1)])
    assert (said.accepted, said.reason) == (False, "the motion is not yet confirmed by an independent restart")


def test_the_filter_comes_to_the_present_and_is_right_within_its_bands(lived):
    stub = Stub()
    observer = BodyObserver(lived.rig, stub)
    said = lived.told(observer, stub, lived.END + 0.5, lived.END + 0.05)
    before = [each for each in said if each.t < lived.END]
    assert not any(each.valid for each in before)
    assert before[-1].reason == "no motion found yet that explains the readings"
    valid = [each for each in said if each.valid]
    assert valid
    assert valid[0].t < lived.END + 0.3
    squares = []
    for each in valid:
        names = [f"omega_{axis}_rad_s" for axis in "xyz"], [f"com_{axis}_m" for axis in "xyz"]
        for group, part in zip(names, (slice(15, 18), slice(0, 3)), strict=True):
            true = lived.truth(each.t)[part]
            squares += [((each.values[n] - v) / each.sd[n]) ** 2 for n, v in zip(group, true, strict=True)]
    assert np.mean(squares) < 3.0
    shape = observer.shape(lived.END + 0.5)
    assert observer.shape(lived.END + 0.5) is None  # once
    fields = says.shape_fields(shape, 1, True)
    true = lived.h_of(icosphere()[0])
    error, sd, share = surface_error(fields, true, lived.gauge)
    assert error < 1e-4
    assert 0.2 < error / sd < 3.0
    assert share > 0.01


def test_contacts_and_spin_are_told_as_roughly_as_readings_are_missed(lived):
    def told(rough):
        lived.answer, kept = replace(lived.answer, unexplained_sd=rough), lived.answer
        said = lived.told(BodyObserver(lived.rig, stub := Stub()), stub, lived.END + 0.2, lived.END + 0.05)[-1]
        lived.answer = kept
        return said.sd

    exact, rough = told(0.0), told(9e-5)
    for name in ("a1_m", "b3_m", "com_z_m"):
        assert rough[name] > 9e-5 > exact[name]
    assert rough["omega_x_rad_s"] > 3 * live.TRUNCATED_RAD_S > exact["omega_x_rad_s"]


def test_told_the_same_it_says_the_same_to_the_last_bit(lived):
    first = BodyObserver(lived.rig, stub := Stub())
    said = [says.estimate_fields(each) for each in lived.told(first, stub, lived.END + 0.3, lived.END + 0.05)]
    recorded = says.answer_of(says.answer_fields(0.0, lived.answer))
    lived.answer, kept = recorded, lived.answer
    second = BodyObserver(lived.rig, stub := Stub())
    again = [says.estimate_fields(each) for each in lived.told(second, stub, lived.END + 0.3, lived.END + 0.05)]
    lived.answer = kept
    assert msgpack.packb(said) == msgpack.packb(again)


def go_on(lived, observer, begin, end, without=None):
    """The log's events between two times, but for those of a pad."""
    for event in lived.events:
        if begin < event.t_sample <= end and not (isinstance(event, PadSample) and event.pad == without):
            observer.feed(event)
    observer.improve(end)
    return observer.estimate(end)


def ticked(lived, observer, begin, end):
    """The same tick by tick."""
    for k in range(round((end - begin) / 0.01)):
        go_on(lived, observer, begin + 0.01 * k, begin + 0.01 * (k + 1))


def test_a_pad_that_is_silent_for_a_moment_interrupts_the_claim_and_nothing_else(lived):
    observer = BodyObserver(lived.rig, stub := Stub())
    assert lived.told(observer, stub, lived.END + 0.4, lived.END + 0.05)[-1].valid
    observer.feed(PadLift(lived.END + 0.405, 2))  # on a busy machine it says so of packets that come late
    said = go_on(lived, observer, lived.END + 0.4, lived.END + 0.45, without=2)
    assert not said.valid
    assert said.reason == "nothing touches palm 2"
    said = go_on(lived, observer, lived.END + 0.45, lived.END + 0.5)
    assert said.valid, said.reason


def test_a_palm_that_is_let_go_ends_what_is_known_of_the_motion(lived):
    observer = BodyObserver(lived.rig, stub := Stub())
    lived.told(observer, stub, lived.END + 0.4, lived.END + 0.05)
    observer.feed(PadLift(lived.END + 0.405, 2))
    said = go_on(lived, observer, lived.END + 0.4, lived.END + 0.4 + GAP_S + 0.02, without=2)
    assert not said.valid
    said = go_on(lived, observer, lived.END + 0.4 + GAP_S + 0.02, lived.END + 0.6)
    assert not said.valid
    assert math.isnan(said.quaternion[0])
    stub.next = lived.answer  # about what was there before
    observer.improve(lived.END + 0.61)
    assert observer.estimate(lived.END + 0.61).hypotheses == 0


def test_who_chooses_motions_is_told_where_the_body_is_and_where_it_was_touched(lived):
    observer = BodyObserver(lived.rig, stub := Stub())
    assert not observer.has_planning_belief
    assert observer.planning_belief(lived.END - 0.2) is None
    lived.told(observer, stub, lived.END + 0.4, lived.END + 0.05)
    assert observer.has_planning_belief
    told = observer.planning_belief(lived.END + 0.4)
    R = lived.truth(told.t)[6:15].reshape(3, 3)
    assert (told.accepted, told.record_start) == (True, lived.answer.record_start)
    assert np.abs(told.R - R @ lived.gauge).max() < 0.02
    assert told.covariance.shape == lived.answer.covariance.shape
    assert told.touched.tolist() == (lived.answer.touched > 0).tolist()
    since = (lived.END + 0.4 - lived.answer.t) / live.NORMALS_EVERY_S
    assert len(told.normals_since) == pytest.approx(since, abs=12)  # it has caught up meanwhile
    normal = palms_at(*swung(np.array([lived.END + 0.4]))).normal[0]
    assert np.abs(told.normals_since[-1] - -normal @ told.R).max() < 0.1
    observer._filter._body[12] = 1.1 * live.NIS_LIMIT  # what was claimed is contradicted a little
    assert observer.has_planning_belief
    assert not observer.planning_belief(lived.END + 0.4).accepted
    stub.next = replace(lived.answer, accepted=False, reason="the readings determine too little of the shape")
    said = go_on(lived, observer, lived.END + 0.4, lived.END + 0.45)
    assert (said.valid, observer.has_planning_belief, observer.planning_belief(lived.END + 0.45).accepted) == (
        False,
        True,
        False,
    )
    stub.next = replace(lived.answer, hypotheses=0, accepted=False)
    go_on(lived, observer, lived.END + 0.45, lived.END + 0.5)
    assert not observer.has_planning_belief


def turned(answer, G, begun):
    """The same belief of another record, whose frame lies at G in the first one's."""
    n = count(ORDER)
    h_of = evaluator(ORDER)
    p = parameters(lambda u: h_of(u @ G.T)[0] @ answer.p[:n], G.T @ inertia(answer.p) @ G, ORDER)
    p[n + 6 :] = answer.p[n + 6 :]
    sd = np.array([1e-3] * 3 + [0.02] * 3 + [1e-6] * len(p))
    return replace(answer, R=answer.R @ G, p=p, covariance=np.diag(sd**2), record_start=begun)


def test_the_frame_of_the_next_record_is_known_by_what_was_given_up_as_long_as_that_foretells(lived):
    at, G = lived.END + 0.2, exp(np.array([0.4, -0.9, 0.3]))
    lost = replace(lived.answer, hypotheses=0, accepted=False, reason="the motion no longer explains the readings")
    for foretells in (True, False):
        observer = BodyObserver(lived.rig, stub := Stub())
        lived.told(observer, stub, at, lived.END + 0.05)
        first = observer.planning_belief(at)
        stub.next = lost
        said = go_on(lived, observer, at, at + 0.05)
        assert (said.valid, said.reason, observer.planning_belief(at + 0.05)) == (False, lost.reason, None)
        if not foretells:
            observer._previous._body[12] = 1.1 * live.NIS_PREDICTIVE
        stub.next = turned(lived.answer, G, lived.answer.record_start + 1.0)
        go_on(lived, observer, at + 0.05, at + 0.06)
        assert observer.planning_belief(at + 0.06) is None  # not of one record by the filter of another
        ticked(lived, observer, at + 0.06, at + 0.16)
        told = observer.planning_belief(at + 0.16)
        assert told.record_start > first.record_start
        assert told.frame - first.frame == (0 if foretells else 1)
        assert np.abs(told.turn - (G if foretells else np.eye(3))).max() < 5e-3
    stub.next = turned(lived.answer, np.eye(3), lived.answer.record_start + 2.0)  # one follows the other at once
    ticked(lived, observer, at + 0.16, at + 0.3)
    again = observer.planning_belief(at + 0.3)
    assert (again.frame, again.record_start) == (told.frame, lived.answer.record_start + 2.0)
    assert np.abs(again.turn - G.T).max() < 5e-3


def test_what_an_earlier_answer_took_to_be_touched_is_not_unless_it_is(lived):
    task, ended = lived.raced
    motion = ended[0].motion
    erring = replace(ended[0], motion=replace(motion, R=motion.R @ exp(np.array([1.0, 0.5, 0.0]))))
    lived.smoother._make_answer(task, [erring])
    told = lived.smoother._make_answer(task, ended)
    assert (told.touched > 0).tolist() == directions_near(ended[0].touched_normals).tolist()


def test_the_loop_is_told_an_outline_of_the_usual_degree_as_what_was_felt_tells_it(lived):
    task, (first, *_) = lived.raced
    p, ahead = beliefs.with_order(first.motion.p, 16), beliefs.belief_with_order(first.end_belief, 16)
    finer = replace(first, motion=replace(first.motion, p=p), end_belief=ahead)
    told = lived.smoother._make_answer(task, [finer])
    assert len(told.p) == len(first.motion.p)
    touched = told.touched > 0
    mean, covariance = touched_outline(ahead.mean, np.linalg.inv(ahead.information), touched, ORDER)
    np.testing.assert_allclose(told.p, mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(np.diagonal(told.covariance)[10:], np.diagonal(covariance)[10:], rtol=1e-4)
    rows = evaluator(ORDER)(icosphere()[0])[0]
    np.testing.assert_allclose(told.h[~touched], (rows @ told.p[: count(ORDER)])[~touched], rtol=1e-9)
    np.testing.assert_allclose(told.h[touched], (rows @ ahead.mean[: count(ORDER)])[touched], atol=1e-6)


def test_what_is_not_explained_widens_what_is_told_of_the_centre_of_mass(lived):
    task, ended = lived.raced
    costing = ([replace(ended[0], cost=share * ended[0].record.numbers)] for share in (1.0, 1.2))
    explained, unexplained = (lived.smoother._make_answer(task, each) for each in costing)
    assert (explained.unexplained_sd, unexplained.unexplained_sd) == pytest.approx(
        (0.0, math.sqrt(0.2) * task.noise.reading)
    )
    variance = (0.2 - math.sqrt(2.0 / ended[0].record.numbers)) * task.noise.reading**2
    np.testing.assert_allclose(unexplained.h_sd**2 - explained.h_sd**2, variance, rtol=1e-6)
    wider = np.diag(unexplained.covariance - explained.covariance)
    np.testing.assert_allclose(wider[STATES + 1 : STATES + 4], variance * 4.0 * np.pi / 3.0, rtol=1e-6)
    assert np.count_nonzero(wider) == 3


def test_what_was_found_twice_and_has_foretold_for_long_may_cost_what_truncation_does(lived, monkeypatch):
    task, ended = lived.raced
    costly = [replace(ended[0], cost=1.2 * 2 * len(ended[0].record.readings.t))]
    smoother = lived.smoother
    monkeypatch.setattr(smoother, "_accepted", False)
    monkeypatch.setattr(smoother, "_confirmed_since", ended[0].record.t[-1] - incremental.PROVEN_S + 0.1)
    assert not smoother._make_answer(task, costly).accepted
    assert not smoother._accepted
    assert smoother._make_answer(task, ended).accepted  # from now on
    assert smoother._accepted
    assert not smoother._make_answer(task, costly).accepted
    monkeypatch.setattr(smoother, "_confirmed_since", ended[0].record.t[-1] - incremental.PROVEN_S - 0.1)
    assert smoother._make_answer(task, costly).accepted
    worse = [replace(ended[0], cost=1.1 * reconstruct.PROVEN_COST * ended[0].record.numbers)]
    assert (
        smoother._make_answer(task, worse).reason
        == "no motion that satisfies the equations of motion explains the readings"
    )


def test_what_has_tumbled_may_cost_no_more_than_its_noise(lived):
    task, (first, *_) = lived.raced
    tumbled = replace(first.motion, omega=np.full_like(first.motion.omega, 9.0))
    costly = replace(first, motion=tumbled, cost=1.2 * first.record.numbers)
    assert (
        reconstruct.reconstruction_of(task, [costly]).reason
        == "no motion that satisfies the equations of motion explains the readings"
    )


def test_a_start_of_a_whole_record_that_leads_nowhere_is_given_up(lived, monkeypatch):
    task, _ = lived.raced
    record, (way, *_) = task.record(1.5), beliefs.start_assumptions()
    assert propagation.fit_blind_starts(task, record, [way])
    monkeypatch.setattr(propagation, "START_COST_LIMIT", 0.1)
    assert propagation.fit_blind_starts(task, record, [way]) == []


def test_who_was_given_up_before_it_was_smoothed_and_is_the_cheapest_then_is_smoothed(lived, monkeypatch):
    def unsmoothed(task, running, **_):
        return [propagate(task, running[0], task.intervals(task.end - task.start))]

    monkeypatch.setattr(incremental, "propagate_and_prune", unsmoothed)
    lived.smoother.add([event for event in lived.events if event.t_sample >= lived.END])
    answer = lived.smoother.answer()
    assert answer is not None
    assert answer.t > lived.answer.t + 0.5
    assert math.isfinite(answer.mass)


def test_who_is_found_twice_may_have_finer_harmonics_and_nobody_else(lived, monkeypatch):
    def lived_again(twice, task, running, **__):
        return [replace(each, confirmed=twice * each.intervals) for each in propagate_and_prune(task, running)]

    asked = []
    monkeypatch.setattr(incremental, "fit_blind_starts", lambda task, record, _: lived._right(task, record))
    monkeypatch.setattr(
        incremental, "refine_outline", lambda _, now, orders: asked.append((now.is_confirmed, orders)) or now
    )
    for twice in (False, True):
        smoother = IncrementalBodySmoother(lived.rig)
        smoother.add([event for event in lived.events if event.t_sample < lived.FIRST])
        monkeypatch.setattr(incremental, "propagate_and_prune", partial(lived_again, twice))
        smoother.answer()
    assert asked == [(True, FINER_ORDERS_LIVE)]


@pytest.mark.parametrize("innovation_test", [2.9, 3.1])
def test_what_goes_on_after_a_surprise_is_to_be_found_again(lived, monkeypatch, innovation_test):
    """Ways on that differ may all be explained, the more so the further harmonics bend."""
    task, (first, *_) = lived.raced
    smoother = IncrementalBodySmoother(lived.rig)
    on = replace(first, windows=(*first.windows, (5, innovation_test)), confirmed=first.intervals)
    monkeypatch.setattr(smoother, "_task", lambda: task)
    monkeypatch.setattr(smoother, "_hypotheses", [replace(first, record=task.full_record.first(first.intervals - 5))])
    monkeypatch.setattr(smoother, "_confirm", lambda _, ended: ended)
    monkeypatch.setattr(smoother, "_confirmed_since", -math.inf)
    monkeypatch.setattr(propagation, "TUMBLE_RAD_S", 0.0)
    monkeypatch.setattr(incremental, "propagate_and_prune", lambda *_, **__: [on])
    said = smoother.answer()
    assert smoother._hypotheses[0].is_confirmed is (innovation_test < 3.0)
    assert (said.reason == reconstruct.UNCONFIRMED) is (innovation_test > 3.0)
    assert (smoother._confirmed_since == math.inf) is (innovation_test > 3.0)


def test_what_was_not_explained_before_finer_harmonics_bent_to_it_widens_what_is_told_of_the_centre(lived, monkeypatch):
    def bent(_, now, __):
        p = beliefs.with_order(now.motion.p, 16)
        ahead = beliefs.belief_with_order(now.end_belief, 16)
        return replace(now, motion=replace(now.motion, p=p), end_belief=ahead, cost=now.record.numbers)

    def dear(_, running, **__):
        return [replace(each, cost=1.2 * each.record.numbers, confirmed=each.intervals) for each in running]

    def told(finer):
        smoother = IncrementalBodySmoother(lived.rig)
        smoother.add([event for event in lived.events if event.t_sample < lived.FIRST])
        monkeypatch.setattr(incremental, "refine_outline", finer)
        smoother.answer()
        return smoother._hidden_cost / smoother._hypotheses[0].record.numbers

    monkeypatch.setattr(incremental, "fit_blind_starts", lambda task, record, _: lived._right(task, record))
    monkeypatch.setattr(incremental, "propagate_and_prune", dear)
    assert told(lambda _, now, __: now) == 0.0
    assert told(bent) == pytest.approx(0.2)


def test_what_finer_harmonics_may_hide_of_the_centre_of_mass_is_in_its_band(lived, monkeypatch):
    task, ended = lived.raced
    said = lived.smoother._make_answer(task, ended)
    monkeypatch.setattr(lived.smoother, "_hidden_cost", 0.1 * ended[0].record.numbers)
    hidden = lived.smoother._make_answer(task, ended)
    assert (hidden.h_sd**2 - said.h_sd**2).min() > 0.5 * 0.1 * task.noise.reading**2
    long = replace(ended[0], marginalised=(9 * ended[0].record.numbers, 9.0 * ended[0].record.numbers))
    later = lived.smoother._make_answer(task, [long])  # spread over what was read since
    assert (later.h_sd**2 - said.h_sd**2).max() < 0.2 * 0.1 * task.noise.reading**2
    assert (np.diagonal(hidden.covariance)[7:10] > np.diagonal(said.covariance)[7:10]).all()


def test_what_bends_further_is_found_again_by_starts_that_may_as_well(lived, monkeypatch):
    task, (first, *_) = lived.raced
    asked = []
    monkeypatch.setattr(propagation, "fit_blind_starts", lambda *given: asked.append(given[-1]) or [first])
    monkeypatch.setattr(propagation, "refine_outline", lambda _, now, orders: asked.append(orders) or now)
    assert propagation.confirm_by_restarts(task, [replace(first, confirmed=0)], [None])[0].is_confirmed
    assert asked == [first.cost, ()]
    asked.clear()
    p = beliefs.with_order(first.motion.p, 16)
    propagation.confirm_by_restarts(task, [replace(first, motion=replace(first.motion, p=p), confirmed=0)], [None])
    assert asked == [math.inf, (16,)]  # it costs more until it has been bent


def test_short_starts_of_a_strange_motion_wait_for_the_next_lap_and_its_claim_for_them(lived, monkeypatch):
    task, (first, *_) = lived.raced
    smoother, tried = lived.smoother, []
    for name in ("_short_starts_due", "_restarts_tried_at", "_marginalised", "_accepted", "_confirmed_since"):
        monkeypatch.setattr(smoother, name, getattr(smoother, name))
    cheaper = replace(first, cost=first.cost - 50.0, confirmed=0)
    monkeypatch.setattr(incremental, "CHANCE_SD", -math.inf)
    monkeypatch.setattr(
        incremental, "confirm_by_restarts", lambda _, together, __, **___: tried.append("whole") or together
    )
    monkeypatch.setattr(incremental, "start_candidates", lambda *_: tried.append("short"))
    monkeypatch.setattr(incremental, "branch_starts", lambda *_, **__: [])
    monkeypatch.setattr(incremental, "propagate_and_prune", lambda *_: found)
    smoother._restarts_tried_at = 0
    assert smoother._confirm(task, [first]) == [first]
    assert tried == ["whole"]
    said = smoother._make_answer(task, [first])
    assert (said.accepted, "restarts are pending" in said.reason) == (False, True)
    found = []  # nothing else
    assert smoother._confirm(task, [first])[0] is first
    assert tried == ["whole", "short"]
    assert smoother._make_answer(task, [first]).accepted
    assert smoother._confirm(task, [first]) == [first]
    assert tried == ["whole", "short"]  # neither again until there is more
    found, smoother._restarts_tried_at = [cheaper], 0
    smoother._confirm(task, [first])
    assert smoother._confirm(task, [first])[0] is cheaper
    assert tried == ["whole", "short", "whole", "short", "whole"]  # which is to be found twice, too


def test_a_minimum_beside_a_believed_one_is_of_its_motion_and_another_motion_is_to_be_found_again(lived, monkeypatch):
    task, (first, *_) = lived.raced

    def found(off, *, accepted):
        omega = first.motion.omega + off
        beside = replace(first, motion=replace(first.motion, omega=omega), cost=first.cost - 80.0, confirmed=0)
        monkeypatch.setattr(propagation, "fit_blind_starts", lambda *_: [beside])
        monkeypatch.setattr(propagation, "_fitted_from", lambda *_: first)
        return propagation.confirm_by_restarts(task, [replace(first, confirmed=0)], [None], accepted=accepted)[0]

    assert found(0.03, accepted=True).is_confirmed
    assert found(0.03, accepted=True).cost == first.cost - 80.0
    assert not found(0.03, accepted=False).is_confirmed
    assert not found(0.2, accepted=True).is_confirmed


@pytest.mark.parametrize(("off", "twice"), [(0.03, True), (0.2, False)])
def test_what_goes_on_from_a_fold_is_found_again_by_who_moves_alike_and_goes_on_in_its_own_frame(
    lived, monkeypatch, off, twice
):
    task, (first, *_) = lived.raced
    smoother = IncrementalBodySmoother(lived.rig)
    smoother._marginalised = True
    alone, turn = replace(first, confirmed=0), exp(np.array([0.3, -0.4, 0.2]))
    motion = replace(first.motion, R=first.motion.R @ turn, omega=first.motion.omega + off)
    monkeypatch.setattr(
        propagation, "fit_blind_starts", lambda *_: [replace(first, motion=motion, cost=first.cost - 80.0)]
    )
    (again,) = smoother._confirm(task, [alone])
    assert again == (replace(first, confirmed=first.intervals) if twice else alone)
    monkeypatch.setattr(propagation, "fit_blind_starts", None)
    assert smoother._confirm(task, [again]) == [again]  # not again until there is more


def test_who_costs_more_than_is_enough_is_followed_no_further_and_forked_no_more_than_it_may(lived, monkeypatch):
    task, _ = lived.raced
    (early,) = lived._right(task, task.record(2.0))
    assert propagate_and_prune(task, [early], early.cost - 1.0)[0].intervals == early.intervals
    forked = []
    monkeypatch.setattr(
        propagation, "_best_branch", lambda *it: forked.append(it) or propagation._extended(*it[:2], 0.4, it[2])
    )
    monkeypatch.setattr(propagation, "BRANCH_COST_GATE", 0.0)  # every window is foretold badly
    for forks in (0, 1):
        forked.clear()
        further = propagate(task, early, early.intervals + 45, branchings=forks)
        assert further.intervals == early.intervals + 45
        assert len(forked) == forks


def test_what_is_late_is_counted_and_dropped():
    observer = BodyObserver(RIG, Stub())
    observer.feed(PalmSample(1.0, (0.9, 0.8, 0.8), (0.0,) * 3, (0.0,) * 3))
    observer.feed(PadSample(1.0, 1, 0.02, 0.1, 0.0))
    observer.improve(1.5)
    observer.feed(PadSample(1.2, 2, 0.02, 0.1, 0.0))
    observer.feed(PadSample(math.nan, 2, 0.02, 0.1, 0.0))
    assert observer.late_dropped == 2


def test_joints_are_known_in_the_past_too():
    track = JointTrack(PalmSample(0.0, (0.5, 0.5, 0.5), (1.0,) * 3, (0.0,) * 3))
    for k in range(1, 3000):
        t = 0.016 * k
        track.take(PalmSample(t, (0.5 + t,) * 3, (1.0,) * 3, (0.0,) * 3))
    t = 0.016 * 2999 - np.array([0.0, 0.004, 3.0, 9.0])
    assert track.at(t)[0][:, 0] == pytest.approx(0.5 + t)


def test_a_surface_is_scored_after_the_best_turn_and_no_better():
    u = icosphere()[0]
    rng = np.random.default_rng(4)
    c = np.concatenate([[0.07], rng.normal(size=24) * 3e-4])
    true = evaluator(4)(u)[0] @ c
    turn = exp(np.array([0.3, -0.2, 0.5]))
    touched = (u[:, 2] > 0.9).astype(int)
    fields = {
        "h_m": evaluator(4)(u @ turn.T)[0] @ c + 1e-5 * rng.choice([-1, 1], len(u)),
        "h_sd_m": np.full(len(u), 2e-5), "touched": touched,
    }  # fmt: skip
    error, sd, share = surface_error(fields, true, exp(np.array([0.02, 0.01, -0.02])) @ turn)
    assert error == pytest.approx(1e-5, rel=0.1)
    assert sd == pytest.approx(2e-5)
    assert share == pytest.approx(0.05, abs=0.01)
    assert np.abs(between(true, u[:50])[0] - true[:50]).max() < 1e-6
