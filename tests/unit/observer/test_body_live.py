"""The live observer of a body between three palms, against the plant, which has independent equations."""

import math
from dataclasses import replace
from functools import partial

import msgpack
import numpy as np
import pytest
from plain_body_filter import PlainFilter

from palmd import three_palms_messages as says
from palmd.events import PadLift, PadSample, PalmSample
from palmd.harness.system_comparisons import between, matrix, surface_error
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
from palmd.system.reasons import Code
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
    """A smooth body on moving palms for 0.4 s, with its parameters as the observer has them."""

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
        self.initial_state = R[0], omega
        for t in self.t:
            plant.advance(np.concatenate([inputs(t - 2e-3), inputs(t - 1e-3), inputs(t)]), 2e-3)
            self.states.append(plant.state.copy())
            self.read.append(readings_of(planes(t), plant.point[None])[0])
            self.force.append(plant.force.copy())

    def belief(self, spin_off=0.0):
        R, omega = self.initial_state
        width = 6 + len(self.p)
        sd = np.array([1e-3] * 3 + [0.3] * 3 + [1e-6] * (width - 6))
        none = np.zeros(0)
        return BodyAnswer(
            0.0, 0.0, True, "", 1, R, omega + spin_off, self.p, np.diag(sd**2), none, none, none, none, 0.06, 1e-3
        )


@pytest.fixture(scope="module")
def rolled():
    return Rolled()


def reported_joints():
    """The joints as reported every 2 ms."""
    t = 2e-3 * np.arange(-1, 210)
    first, *others = (PalmSample(at, *map(tuple, each)) for at, *each in zip(t.tolist(), *joints(t), strict=True))
    track = JointTrack(first)
    for each in others:
        track.take(each)
    return track


def carried(filtered, readings, until):
    filtered.propagate(readings, until, reported_joints())


def test_prediction_follows_the_plants_rigid_body_motion(rolled):
    filtered = BodyFilter(rolled.belief(), RIG)
    carried(filtered, [], 0.4)
    true = rolled.states[-1]
    assert np.abs(true[15:] - rolled.initial_state[1]).max() > 0.3  # the spin changes considerably
    assert filtered.omega == pytest.approx(true[15:], abs=3e-3)
    assert np.abs(filtered.R - true[6:15].reshape(3, 3)).max() < 1e-3


def test_readings_determine_an_unknown_spin(rolled):
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


def test_unexplained_sd_restores_a_nis_of_one(rolled):
    rng, rough = np.random.default_rng(1), 1.5e-4
    sd = math.hypot(math.sqrt(RIG.pad.reading_variance), rough)
    readings = [
        PlaneReading(t, k % 3, *(rolled.read[k][k % 3] + sd * rng.normal(size=2))) for k, t in enumerate(rolled.t)
    ]
    with_sd, without_sd = (BodyFilter(replace(rolled.belief(), unexplained_sd=each), RIG) for each in (rough, 0.0))
    for each in (with_sd, without_sd):
        carried(each, readings[:-1], rolled.t[-1])
    assert 0.7 < with_sd.nis < 1.3 < without_sd.nis
    assert with_sd._compiled is without_sd._compiled  # nothing is kept of each answer


def test_compiled_filter_agrees_with_numpy(rolled):
    rng = np.random.default_rng(4)
    width = 6 + len(rolled.p)
    root = rng.normal(size=(width, width)) * np.array([1e-3] * 3 + [0.1] * 3 + [1e-4] * (width - 6))[:, None]
    belief = replace(rolled.belief(spin_off=0.1), covariance=root @ root.T / width, unexplained_sd=7e-5)
    readings = [
        PlaneReading(rolled.t[k], k % 3, *(rolled.read[k][k % 3] + 1e-4 * rng.normal(size=2))) for k in range(3, 60)
    ]
    readings[20] = replace(readings[20], a=0.5)  # not fused
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
    one, other = compiled.outputs(reported_joints(), 0.15), twin.outputs(reported_joints(), 0.15)
    for name in ("contacts", "centre", "heights"):
        for mine, its in zip(getattr(one, name), getattr(other, name), strict=True):
            assert mine == pytest.approx(its, rel=1e-6, abs=1e-9)
    assert one.force == pytest.approx(other.force, rel=1e-6)


def test_contacts_centre_heights_and_forces_match_the_plant(rolled):
    k = 100
    R, omega = rolled.states[k][6:15].reshape(3, 3), rolled.states[k][15:]
    filtered = BodyFilter(replace(rolled.belief(), t=rolled.t[k], R=R, omega=omega), RIG)
    seen = filtered.outputs(reported_joints(), rolled.t[k])
    assert np.abs(seen.contacts[0] - rolled.read[k]).max() < 2e-6
    assert np.abs(seen.centre[0] - rolled.states[k][:3]).max() < 1e-6
    assert np.abs(seen.heights[0] - planes(rolled.t[k]).normal[0] @ rolled.states[k][:3]).max() < 1e-6
    assert seen.force == pytest.approx(rolled.force[k], rel=0.02)
    assert seen.centre[1].shape == (3,)


def test_quaternions_match_their_rotations():
    for R in random_rotation(np.random.default_rng(3), 20):
        assert np.abs(matrix(quaternion(R)) - R).max() < 1e-12


# ---------------------------------------------------------------- from a blind start to an estimate, on a log's events


class Stub:
    """A smoother that gives an answer when requested."""

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
    """Parameters of a body from its support function and inertia; no drag, and the prior's friction."""
    u, n = icosphere()[0], count(order)
    c = np.linalg.lstsq(evaluator(order)(u)[0], h_of(u), rcond=None)[0]
    lam = np.linalg.cholesky(0.5 * np.trace(inertia) * np.eye(3) - inertia) / (MOMENT * Y00 * c[0])
    lam[np.diag_indices(3)] = np.log(np.diagonal(lam))
    return np.concatenate([c[:n], lam[np.tril_indices(3)], [0.0, 0.1, math.log(0.01)]])


class LiveRun:
    """Readings of a body on swinging palms, and a smoother started at the true motion to save a blind start."""

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
        self.events = self._events_of(read, np.stack([force[0], *force]), rng)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(incremental, "fit_blind_starts", lambda task, record, _: self._true_hypothesis(task, record))
            patch.setattr(incremental, "propagate_and_prune", self._propagated)
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

    def _events_of(self, read, force, rng):
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

    def _propagated(self, task, running, *how, **ways):
        ended = propagate_and_prune(task, running, *how, **ways)
        self.propagated = task, [replace(each, confirmed=each.intervals) for each in ended]
        return self.propagated[1]

    def _true_hypothesis(self, task, record):
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

    def replayed(self, observer, stub, until, answer_at):
        result, waiting, t = [], iter(self.events), self.END - 0.4
        event = next(waiting)
        while t < until:
            t += 0.01
            while event.t_sample <= t:
                observer.feed(event)
                event = next(waiting)
            if t >= answer_at and self.answer is not None and not observer.improvements:
                stub.next = self.answer
            observer.improve(t)
            result.append(observer.estimate(t))
        return result


@pytest.fixture(scope="module")
def live_run():
    return LiveRun()


def test_the_smoother_continues_from_its_previous_answer(live_run):
    assert live_run.first is not None
    assert live_run.answer.accepted, live_run.answer.reason
    assert live_run.answer.t == pytest.approx(live_run.END, abs=0.05)
    assert live_run.answer.t > live_run.first.t + 0.4


def test_failed_starts_are_retried_with_longer_and_shorter_records_then_restarted(live_run, monkeypatch):
    task, (first, *_) = live_run.propagated
    smoother, attempts, numbers = IncrementalBodySmoother(live_run.rig), [], 2 * len(first.record.readings.t)
    costly, near_chance = (replace(first, cost=share * numbers) for share in (1.4, 1.1))
    starts = []
    monkeypatch.setattr(
        incremental, "fit_blind_starts", lambda _, record, __: attempts.append(record.t[-1] - record.t[0]) or starts
    )
    monkeypatch.setattr(incremental, "start_candidates", lambda _, seconds: attempts.append(seconds) or [])
    monkeypatch.setattr(incremental, "branch_starts", lambda _, found, **__: found)
    monkeypatch.setattr(smoother, "_restart_record", lambda _: attempts.append("restart"))
    assert not smoother._start_search(task)  # all were rejected
    starts = [costly]
    assert not any(smoother._start_search(task) for _ in range(2))
    whole = pytest.approx(task.end - task.start, abs=0.03)
    assert attempts == [whole, whole, incremental.SHORT_START_S, "restart"]
    starts = [near_chance]
    assert not smoother._start_search(task)  # a longer record may lead elsewhere
    assert smoother._start_search(task)
    assert smoother._hypotheses == [near_chance]
    monkeypatch.setattr(incremental, "start_candidates", lambda *_: [first, costly, replace(first, cost=math.inf)])
    assert smoother._start_search(task)  # more hypotheses of such a short record are followed
    assert smoother._hypotheses == [first, costly]


def test_agreement_of_two_starts_of_the_whole_record_confirms_a_hypothesis(live_run, monkeypatch):
    task, (first, *_) = live_run.propagated
    met = replace(first, confirmed=first.intervals)
    monkeypatch.setattr(incremental, "fit_blind_starts", lambda *_: [replace(first, confirmed=0)])
    monkeypatch.setattr(incremental, "confirm_by_restarts", lambda *_: [met, replace(first, confirmed=0)])
    smoother = IncrementalBodySmoother(live_run.rig)
    assert smoother._start_search(task)
    assert [each.is_confirmed for each in smoother._hypotheses] == [True, False]


def test_an_unconfirmed_motion_is_not_accepted(live_run):
    task, (first, *_) = live_run.propagated
    enough = -(-2 * first.intervals // 3)
    assert live_run.smoother._make_answer(task, [replace(first, confirmed=enough)]).accepted
    result = live_run.smoother._make_answer(task, [replace(first, confirmed=enough - 1)])
    assert (result.accepted, result.reason_code) == (False, Code.UNCONFIRMED)


def test_the_filter_catches_up_and_is_consistent(live_run):
    stub = Stub()
    observer = BodyObserver(live_run.rig, stub)
    result = live_run.replayed(observer, stub, live_run.END + 0.5, live_run.END + 0.05)
    before = [each for each in result if each.t < live_run.END]
    assert not any(each.valid for each in before)
    assert before[-1].invalid_reasons == (Code.NO_OBJECT,)
    assert (Code.CATCHING_UP,) in {each.invalid_reasons for each in result}
    valid = [each for each in result if each.valid]
    assert valid
    assert valid[0].t < live_run.END + 0.3
    squares = []
    for each in valid:
        names = [f"omega_{axis}_rad_s" for axis in "xyz"], [f"com_{axis}_m" for axis in "xyz"]
        for group, part in zip(names, (slice(15, 18), slice(0, 3)), strict=True):
            true = live_run.truth(each.t)[part]
            squares += [((each.values[n] - v) / each.sd[n]) ** 2 for n, v in zip(group, true, strict=True)]
    assert np.mean(squares) < 3.0
    shape = observer.shape(live_run.END + 0.5)
    assert observer.shape(live_run.END + 0.5) is None  # once
    fields = says.shape_fields(shape, 1, True)
    true = live_run.h_of(icosphere()[0])
    error, sd, share = surface_error(fields, true, live_run.gauge)
    assert error < 1e-4
    assert 0.2 < error / sd < 3.0
    assert share > 0.01


def test_sds_of_contacts_and_spin_include_the_unexplained_residual(live_run):
    def sds_with(rough):
        live_run.answer, kept = replace(live_run.answer, unexplained_sd=rough), live_run.answer
        result = live_run.replayed(
            BodyObserver(live_run.rig, stub := Stub()), stub, live_run.END + 0.2, live_run.END + 0.05
        )[-1]
        live_run.answer = kept
        return result.sd

    exact, rough = sds_with(0.0), sds_with(9e-5)
    for name in ("a1_m", "b3_m", "com_z_m"):
        assert rough[name] > 9e-5 > exact[name]
    assert rough["omega_x_rad_s"] > 3 * live.TRUNCATED_RAD_S > exact["omega_x_rad_s"]


def test_the_same_input_gives_identical_estimates(live_run):
    first = BodyObserver(live_run.rig, stub := Stub())
    result = [
        says.estimate_fields(each) for each in live_run.replayed(first, stub, live_run.END + 0.3, live_run.END + 0.05)
    ]
    recorded = says.answer_of(says.answer_fields(0.0, live_run.answer))
    live_run.answer, kept = recorded, live_run.answer
    second = BodyObserver(live_run.rig, stub := Stub())
    again = [
        says.estimate_fields(each) for each in live_run.replayed(second, stub, live_run.END + 0.3, live_run.END + 0.05)
    ]
    live_run.answer = kept
    assert msgpack.packb(result) == msgpack.packb(again)


def continued(live_run, observer, begin, end, without=None):
    """Feed the log's events between two times, except those of one pad."""
    for event in live_run.events:
        if begin < event.t_sample <= end and not (isinstance(event, PadSample) and event.pad == without):
            observer.feed(event)
    observer.improve(end)
    return observer.estimate(end)


def ticked(live_run, observer, begin, end):
    """The same in ticks of 10 ms."""
    for k in range(round((end - begin) / 0.01)):
        continued(live_run, observer, begin + 0.01 * k, begin + 0.01 * (k + 1))


def test_a_short_silence_of_a_pad_only_interrupts_validity(live_run):
    observer = BodyObserver(live_run.rig, stub := Stub())
    assert live_run.replayed(observer, stub, live_run.END + 0.4, live_run.END + 0.05)[-1].valid
    observer.feed(PadLift(live_run.END + 0.405, 2))  # on a busy machine late packets can cause this
    result = continued(live_run, observer, live_run.END + 0.4, live_run.END + 0.45, without=2)
    assert not result.valid
    assert (result.reason, result.invalid_reasons) == ("nothing touches palm 2", (Code.UNTOUCHED,))
    result = continued(live_run, observer, live_run.END + 0.45, live_run.END + 0.5)
    assert result.valid, result.reason


def test_losing_a_contact_ends_the_estimate(live_run):
    observer = BodyObserver(live_run.rig, stub := Stub())
    live_run.replayed(observer, stub, live_run.END + 0.4, live_run.END + 0.05)
    observer.feed(PadLift(live_run.END + 0.405, 2))
    result = continued(live_run, observer, live_run.END + 0.4, live_run.END + 0.4 + GAP_S + 0.02, without=2)
    assert not result.valid
    result = continued(live_run, observer, live_run.END + 0.4 + GAP_S + 0.02, live_run.END + 0.6)
    assert not result.valid
    assert math.isnan(result.quaternion[0])
    stub.next = live_run.answer  # refers to the object before
    observer.improve(live_run.END + 0.61)
    assert observer.estimate(live_run.END + 0.61).hypotheses == 0


def test_the_planning_belief_has_pose_and_touched_normals(live_run):
    observer = BodyObserver(live_run.rig, stub := Stub())
    assert not observer.has_planning_belief
    assert observer.planning_belief(live_run.END - 0.2) is None
    live_run.replayed(observer, stub, live_run.END + 0.4, live_run.END + 0.05)
    assert observer.has_planning_belief
    belief = observer.planning_belief(live_run.END + 0.4)
    R = live_run.truth(belief.t)[6:15].reshape(3, 3)
    assert (belief.accepted, belief.record_start) == (True, live_run.answer.record_start)
    assert np.abs(belief.R - R @ live_run.gauge).max() < 0.02
    assert belief.covariance.shape == live_run.answer.covariance.shape
    assert belief.touched.tolist() == (live_run.answer.touched > 0).tolist()
    since = (live_run.END + 0.4 - live_run.answer.t) / live.NORMALS_EVERY_S
    assert len(belief.normals_since) == pytest.approx(since, abs=12)  # it has caught up meanwhile
    normal = palms_at(*swung(np.array([live_run.END + 0.4]))).normal[0]
    assert np.abs(belief.normals_since[-1] - -normal @ belief.R).max() < 0.1
    observer._filter._body[12] = 1.1 * live.NIS_LIMIT  # the accepted motion is slightly contradicted
    assert observer.has_planning_belief
    assert not observer.planning_belief(live_run.END + 0.4).accepted
    stub.next = replace(live_run.answer, accepted=False, reason="too little", reason_code="undetermined")
    result = continued(live_run, observer, live_run.END + 0.4, live_run.END + 0.45)
    assert (result.valid, result.reason, result.invalid_reasons) == (False, "too little", (Code.UNDETERMINED,))
    assert observer.has_planning_belief
    assert not observer.planning_belief(live_run.END + 0.45).accepted
    stub.next = replace(live_run.answer, hypotheses=0, accepted=False)
    continued(live_run, observer, live_run.END + 0.45, live_run.END + 0.5)
    assert not observer.has_planning_belief


def turned(answer, G, begun):
    """The same belief of another record, whose frame lies at G in the first one's."""
    n = count(ORDER)
    h_of = evaluator(ORDER)
    p = parameters(lambda u: h_of(u @ G.T)[0] @ answer.p[:n], G.T @ inertia(answer.p) @ G, ORDER)
    p[n + 6 :] = answer.p[n + 6 :]
    sd = np.array([1e-3] * 3 + [0.02] * 3 + [1e-6] * len(p))
    return replace(answer, R=answer.R @ G, p=p, covariance=np.diag(sd**2), record_start=begun)


def test_the_next_records_frame_follows_from_the_lost_one_while_that_predicts(live_run):
    at, G = live_run.END + 0.2, exp(np.array([0.4, -0.9, 0.3]))
    lost = replace(live_run.answer, hypotheses=0, accepted=False, reason="the motion no longer explains the readings")
    for predicts in (True, False):
        observer = BodyObserver(live_run.rig, stub := Stub())
        live_run.replayed(observer, stub, at, live_run.END + 0.05)
        first = observer.planning_belief(at)
        stub.next = lost
        result = continued(live_run, observer, at, at + 0.05)
        assert (result.valid, result.reason, observer.planning_belief(at + 0.05)) == (False, lost.reason, None)
        assert result.invalid_reasons == (Code.OTHER,)  # its answer has no code, as in older recordings
        if not predicts:
            observer._previous._body[12] = 1.1 * live.NIS_PREDICTIVE
        stub.next = turned(live_run.answer, G, live_run.answer.record_start + 1.0)
        continued(live_run, observer, at + 0.05, at + 0.06)
        assert observer.planning_belief(at + 0.06) is None  # never a belief of one record with the filter of another
        ticked(live_run, observer, at + 0.06, at + 0.16)
        belief = observer.planning_belief(at + 0.16)
        assert belief.record_start > first.record_start
        assert belief.frame - first.frame == (0 if predicts else 1)
        assert np.abs(belief.turn - (G if predicts else np.eye(3))).max() < 5e-3
    stub.next = turned(live_run.answer, np.eye(3), live_run.answer.record_start + 2.0)
    ticked(live_run, observer, at + 0.16, at + 0.3)
    again = observer.planning_belief(at + 0.3)
    assert (again.frame, again.record_start) == (belief.frame, live_run.answer.record_start + 2.0)
    assert np.abs(again.turn - G.T).max() < 5e-3


def test_touched_normals_are_those_of_the_current_answer(live_run):
    task, ended = live_run.propagated
    motion = ended[0].motion
    erring = replace(ended[0], motion=replace(motion, R=motion.R @ exp(np.array([1.0, 0.5, 0.0]))))
    live_run.smoother._make_answer(task, [erring])
    answered = live_run.smoother._make_answer(task, ended)
    assert (answered.touched > 0).tolist() == directions_near(ended[0].touched_normals).tolist()


def test_the_loops_outline_has_the_usual_degree_and_the_predictive_belief(live_run):
    task, (first, *_) = live_run.propagated
    p, ahead = beliefs.with_order(first.motion.p, 16), beliefs.belief_with_order(first.end_belief, 16)
    finer = replace(first, motion=replace(first.motion, p=p), end_belief=ahead)
    answered = live_run.smoother._make_answer(task, [finer])
    assert len(answered.p) == len(first.motion.p)
    touched = answered.touched > 0
    mean, covariance = touched_outline(ahead.mean, np.linalg.inv(ahead.information), touched, ORDER)
    np.testing.assert_allclose(answered.p, mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(np.diagonal(answered.covariance)[10:], np.diagonal(covariance)[10:], rtol=1e-4)
    rows = evaluator(ORDER)(icosphere()[0])[0]
    np.testing.assert_allclose(answered.h[~touched], (rows @ answered.p[: count(ORDER)])[~touched], rtol=1e-9)
    np.testing.assert_allclose(answered.h[touched], (rows @ ahead.mean[: count(ORDER)])[touched], atol=1e-6)


def test_unexplained_residuals_widen_the_sd_of_the_centre_of_mass(live_run):
    task, ended = live_run.propagated
    costing = ([replace(ended[0], cost=share * ended[0].record.numbers)] for share in (1.0, 1.2))
    explained, unexplained = (live_run.smoother._make_answer(task, each) for each in costing)
    assert (explained.unexplained_sd, unexplained.unexplained_sd) == pytest.approx(
        (0.0, math.sqrt(0.2) * task.noise.reading)
    )
    variance = (0.2 - math.sqrt(2.0 / ended[0].record.numbers)) * task.noise.reading**2
    np.testing.assert_allclose(unexplained.h_sd**2 - explained.h_sd**2, variance, rtol=1e-6)
    wider = np.diag(unexplained.covariance - explained.covariance)
    np.testing.assert_allclose(wider[STATES + 1 : STATES + 4], variance * 4.0 * np.pi / 3.0, rtol=1e-6)
    assert np.count_nonzero(wider) == 3


def test_a_confirmed_and_proven_hypothesis_may_cost_as_much_as_truncation(live_run, monkeypatch):
    task, ended = live_run.propagated
    costly = [replace(ended[0], cost=1.2 * 2 * len(ended[0].record.readings.t))]
    smoother = live_run.smoother
    monkeypatch.setattr(smoother, "_accepted", False)
    monkeypatch.setattr(smoother, "_confirmed_since", ended[0].record.t[-1] - incremental.PROVEN_S + 0.1)
    assert not smoother._make_answer(task, costly).accepted
    assert not smoother._accepted
    assert smoother._make_answer(task, ended).accepted  # accepted from now on
    assert smoother._accepted
    assert not smoother._make_answer(task, costly).accepted
    monkeypatch.setattr(smoother, "_confirmed_since", ended[0].record.t[-1] - incremental.PROVEN_S - 0.1)
    assert smoother._make_answer(task, costly).accepted
    worse = [replace(ended[0], cost=1.1 * reconstruct.PROVEN_COST * ended[0].record.numbers)]
    assert smoother._make_answer(task, worse).reason_code == Code.UNEXPLAINED


def test_a_tumbled_body_may_cost_no_more_than_noise(live_run):
    task, (first, *_) = live_run.propagated
    tumbled = replace(first.motion, omega=np.full_like(first.motion.omega, 9.0))
    costly = replace(first, motion=tumbled, cost=1.2 * first.record.numbers)
    assert reconstruct.reconstruction_of(task, [costly]).reason.code == Code.UNEXPLAINED


def test_a_start_of_a_whole_record_above_the_cost_limit_is_rejected(live_run, monkeypatch):
    task, _ = live_run.propagated
    record, (way, *_) = task.record(1.5), beliefs.start_assumptions()
    assert propagation.fit_blind_starts(task, record, [way])
    monkeypatch.setattr(propagation, "START_COST_LIMIT", 0.1)
    assert propagation.fit_blind_starts(task, record, [way]) == []


def test_the_best_hypothesis_is_smoothed_before_it_is_answered(live_run, monkeypatch):
    def unsmoothed(task, running, **_):
        return [propagate(task, running[0], task.intervals(task.end - task.start))]

    monkeypatch.setattr(incremental, "propagate_and_prune", unsmoothed)
    live_run.smoother.add([event for event in live_run.events if event.t_sample >= live_run.END])
    answer = live_run.smoother.answer()
    assert answer is not None
    assert answer.t > live_run.answer.t + 0.5
    assert math.isfinite(answer.mass)


def test_only_confirmed_hypotheses_get_finer_harmonics(live_run, monkeypatch):
    def propagate_confirmed(twice, task, running, **__):
        return [replace(each, confirmed=twice * each.intervals) for each in propagate_and_prune(task, running)]

    asked = []
    monkeypatch.setattr(
        incremental, "fit_blind_starts", lambda task, record, _: live_run._true_hypothesis(task, record)
    )
    monkeypatch.setattr(
        incremental, "refine_outline", lambda _, now, orders: asked.append((now.is_confirmed, orders)) or now
    )
    for twice in (False, True):
        smoother = IncrementalBodySmoother(live_run.rig)
        smoother.add([event for event in live_run.events if event.t_sample < live_run.FIRST])
        monkeypatch.setattr(incremental, "propagate_and_prune", partial(propagate_confirmed, twice))
        smoother.answer()
    assert asked == [(True, FINER_ORDERS_LIVE)]


@pytest.mark.parametrize("innovation_test", [2.9, 3.1])
def test_after_a_failed_innovation_test_a_hypothesis_needs_confirmation(live_run, monkeypatch, innovation_test):
    """Several continuations may explain the readings, especially with finer harmonics."""
    task, (first, *_) = live_run.propagated
    smoother = IncrementalBodySmoother(live_run.rig)
    on = replace(first, windows=(*first.windows, (5, innovation_test)), confirmed=first.intervals)
    monkeypatch.setattr(smoother, "_task", lambda: task)
    monkeypatch.setattr(smoother, "_hypotheses", [replace(first, record=task.full_record.first(first.intervals - 5))])
    monkeypatch.setattr(smoother, "_confirm", lambda _, ended: ended)
    monkeypatch.setattr(smoother, "_confirmed_since", -math.inf)
    monkeypatch.setattr(propagation, "TUMBLE_RAD_S", 0.0)
    monkeypatch.setattr(incremental, "propagate_and_prune", lambda *_, **__: [on])
    result = smoother.answer()
    assert smoother._hypotheses[0].is_confirmed is (innovation_test < 3.0)
    assert (result.reason_code == Code.UNCONFIRMED) is (innovation_test > 3.0)
    assert (smoother._confirmed_since == math.inf) is (innovation_test > 3.0)


def test_residuals_hidden_by_finer_harmonics_are_kept_as_hidden_cost(live_run, monkeypatch):
    def bent(_, now, __):
        p = beliefs.with_order(now.motion.p, 16)
        ahead = beliefs.belief_with_order(now.end_belief, 16)
        return replace(now, motion=replace(now.motion, p=p), end_belief=ahead, cost=now.record.numbers)

    def costly(_, running, **__):
        return [replace(each, cost=1.2 * each.record.numbers, confirmed=each.intervals) for each in running]

    def hidden_share(finer):
        smoother = IncrementalBodySmoother(live_run.rig)
        smoother.add([event for event in live_run.events if event.t_sample < live_run.FIRST])
        monkeypatch.setattr(incremental, "refine_outline", finer)
        smoother.answer()
        return smoother._hidden_cost / smoother._hypotheses[0].record.numbers

    monkeypatch.setattr(
        incremental, "fit_blind_starts", lambda task, record, _: live_run._true_hypothesis(task, record)
    )
    monkeypatch.setattr(incremental, "propagate_and_prune", costly)
    assert hidden_share(lambda _, now, __: now) == 0.0
    assert hidden_share(bent) == pytest.approx(0.2)


def test_the_hidden_cost_widens_the_sd_of_the_centre_of_mass(live_run, monkeypatch):
    task, ended = live_run.propagated
    result = live_run.smoother._make_answer(task, ended)
    monkeypatch.setattr(live_run.smoother, "_hidden_cost", 0.1 * ended[0].record.numbers)
    hidden = live_run.smoother._make_answer(task, ended)
    assert (hidden.h_sd**2 - result.h_sd**2).min() > 0.5 * 0.1 * task.noise.reading**2
    long = replace(ended[0], marginalised=(9 * ended[0].record.numbers, 9.0 * ended[0].record.numbers))
    later = live_run.smoother._make_answer(task, [long])  # spread over all readings since
    assert (later.h_sd**2 - result.h_sd**2).max() < 0.2 * 0.1 * task.noise.reading**2
    assert (np.diagonal(hidden.covariance)[7:10] > np.diagonal(result.covariance)[7:10]).all()


def test_hypotheses_with_finer_harmonics_are_confirmed_by_starts_with_the_same_order(live_run, monkeypatch):
    task, (first, *_) = live_run.propagated
    asked = []
    monkeypatch.setattr(propagation, "fit_blind_starts", lambda *given: asked.append(given[-1]) or [first])
    monkeypatch.setattr(propagation, "refine_outline", lambda _, now, orders: asked.append(orders) or now)
    assert propagation.confirm_by_restarts(task, [replace(first, confirmed=0)], [None])[0].is_confirmed
    assert asked == [first.cost, ()]
    asked.clear()
    p = beliefs.with_order(first.motion.p, 16)
    propagation.confirm_by_restarts(task, [replace(first, motion=replace(first.motion, p=p), confirmed=0)], [None])
    assert asked == [math.inf, (16,)]  # it costs more until the finer order is fitted


def test_short_restarts_wait_for_the_next_round_and_acceptance_waits_for_them(live_run, monkeypatch):
    task, (first, *_) = live_run.propagated
    smoother, tried = live_run.smoother, []
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
    result = smoother._make_answer(task, [first])
    assert (result.accepted, "restarts are pending" in result.reason) == (False, True)
    found = []  # no other hypothesis
    assert smoother._confirm(task, [first])[0] is first
    assert tried == ["whole", "short"]
    assert smoother._make_answer(task, [first]).accepted
    assert smoother._confirm(task, [first]) == [first]
    assert tried == ["whole", "short"]  # neither again until there are more readings
    found, smoother._restarts_tried_at = [cheaper], 0
    smoother._confirm(task, [first])
    assert smoother._confirm(task, [first])[0] is cheaper
    assert tried == ["whole", "short", "whole", "short", "whole"]  # the cheaper one needs confirmation, too


def test_a_lower_minimum_of_the_accepted_motion_is_confirmed_and_another_motion_is_not(live_run, monkeypatch):
    task, (first, *_) = live_run.propagated

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
def test_after_marginalisation_a_restart_with_the_same_motion_confirms(live_run, monkeypatch, off, twice):
    task, (first, *_) = live_run.propagated
    smoother = IncrementalBodySmoother(live_run.rig)
    smoother._marginalised = True
    alone, turn = replace(first, confirmed=0), exp(np.array([0.3, -0.4, 0.2]))
    motion = replace(first.motion, R=first.motion.R @ turn, omega=first.motion.omega + off)
    monkeypatch.setattr(
        propagation, "fit_blind_starts", lambda *_: [replace(first, motion=motion, cost=first.cost - 80.0)]
    )
    (again,) = smoother._confirm(task, [alone])
    assert again == (replace(first, confirmed=first.intervals) if twice else alone)
    monkeypatch.setattr(propagation, "fit_blind_starts", None)
    assert smoother._confirm(task, [again]) == [again]  # not again until there are more readings


def test_hypotheses_above_the_cost_limit_stop_and_branches_are_limited(live_run, monkeypatch):
    task, _ = live_run.propagated
    (early,) = live_run._true_hypothesis(task, task.record(2.0))
    assert propagate_and_prune(task, [early], early.cost - 1.0)[0].intervals == early.intervals
    forked = []
    monkeypatch.setattr(
        propagation, "_best_branch", lambda *it: forked.append(it) or propagation._extended(*it[:2], 0.4, it[2])
    )
    monkeypatch.setattr(propagation, "BRANCH_COST_GATE", 0.0)  # every window fails its prediction
    for forks in (0, 1):
        forked.clear()
        further = propagate(task, early, early.intervals + 45, branchings=forks)
        assert further.intervals == early.intervals + 45
        assert len(forked) == forks


def test_late_events_are_counted_and_dropped():
    observer = BodyObserver(RIG, Stub())
    observer.feed(PalmSample(1.0, (0.9, 0.8, 0.8), (0.0,) * 3, (0.0,) * 3))
    observer.feed(PadSample(1.0, 1, 0.02, 0.1, 0.0))
    observer.improve(1.5)
    observer.feed(PadSample(1.2, 2, 0.02, 0.1, 0.0))
    observer.feed(PadSample(math.nan, 2, 0.02, 0.1, 0.0))
    assert observer.late_dropped == 2


def test_joints_are_interpolated_at_past_times():
    track = JointTrack(PalmSample(0.0, (0.5, 0.5, 0.5), (1.0,) * 3, (0.0,) * 3))
    for k in range(1, 3000):
        t = 0.016 * k
        track.take(PalmSample(t, (0.5 + t,) * 3, (1.0,) * 3, (0.0,) * 3))
    t = 0.016 * 2999 - np.array([0.0, 0.004, 3.0, 9.0])
    assert track.at(t)[0][:, 0] == pytest.approx(0.5 + t)


def test_a_surface_is_scored_after_the_best_rotation():
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
