"""Three independent roads to the same filter agree, the other estimators do what they are there for."""

import math

import casadi as ca
import generated_filter
import numpy as np
import plain_shape_map
import pytest
from palms import palm_sample
from plain_filter import PlainFilter

from palmd.events import PadSample, PalmSample
from palmd.model import shape, shape_map
from palmd.model.contact import Contact, offsets
from palmd.model.dynamics import BodyConstants, Palms, newton_euler
from palmd.rig.simulate import simulate_log
from palmd.system.description import RigDescription
from tools.studies.peers import horizon, newton
from tools.studies.peers import task as task_module
from tools.studies.peers.filterpy_filters import FilterpyExtended
from tools.studies.peers.functions import array, functions
from tools.studies.peers.task import PeerReading, PeerTruth, blind, good, task_from

SECONDS = 1.5
SAME_FORMULA = 1e-9
"""Relative: the generated C and NumPy compute the same expressions, in another order."""
SAME_FILTER_SD = 1e-6
"""Of one sigma: what rounding may make of it in a whole run."""
PALMS = np.array([0.7, 1.5, 0.4, -0.3, 1.0, -2.0])
JERK = [3.0, -4.0]
VIBRATION, IN_PHASE = [0.3, 0.8, 0.0, 2e-3, 0.1, -0.05], [-1.0, 1.0, 0.0, 2e-3, 0.0, 0.0]
AVERAGED = [0.0, 1.0, 1.0, 0.0, 0.0, 0.0]
"""κ, λ, whether the old law of friction holds, half a period (s), and by how much κ and λ are off."""
RIG = [9.81, 0.12, 0.12, 0.0, 0.0, 0.0, 0.0, *VIBRATION]


@pytest.fixture(scope="module")
def kernels():
    return generated_filter.library()


@pytest.fixture(scope="module")
def model():
    return functions()


def events_of(lines):
    for line in lines:
        if "pad" in line:
            yield PadSample(line["t"], line["pad"], line["s_m"], line["force_n"])
        elif "palms" in line:
            yield palm_sample(line)


def run_of(kind, seed=101, seconds=SECONDS):
    (header, *lines), fields = simulate_log(kind, seed, seconds)
    hinge = header["rig"]["hinge"]
    arm = hinge.get("palm1_length_m", 0.12)
    rig = RigDescription(hinge=hinge["mode"], palm1_length=arm, base=(arm, 0.0))
    events = list(events_of(lines))
    return rig, events, task_from(rig, events), PeerTruth.from_fields(fields)


@pytest.fixture(scope="module", params=["nominal", "rig"])
def run(request):
    """Without friction, and with stiff friction on a hinge that travels."""
    return run_of(request.param, seconds=2.0)


@pytest.fixture(scope="module")
def nominal():
    return run_of("nominal")


def a_state(random, mu):
    Z = shape_map.Z
    x = np.zeros(shape_map.N)
    x[Z.PSI], x[Z.OMEGA0], x[Z.LN_RHO] = random.uniform(-3, 3), random.uniform(-2, 2), math.log(0.014)
    x[Z.MU], x[Z.LN_DITHER], x[Z.DAMPING] = mu, math.log(0.008), 3e-4
    x[Z.SHAPE :] = 0.5 * shape.prior_sd(0.02) * random.standard_normal(shape.COEFFICIENTS)
    x[Z.SHAPE] = 0.02
    return x


# ---------------------------------------------------------------------------- an independent oracle for the C


@pytest.mark.parametrize(("mu", "law"), [(0.0, VIBRATION), (0.3, VIBRATION), (0.3, IN_PHASE), (0.3, AVERAGED)])
@pytest.mark.parametrize("seed", range(4))
def test_the_c_predicts_as_the_numpy_twin(kernels, seed, mu, law):
    random = np.random.default_rng(seed)
    n = shape_map.N
    x = a_state(random, mu)
    root = random.standard_normal((n, n)) * 1e-3
    P, u = root @ root.T, np.array([0.006, *PALMS, *JERK, *RIG[: -len(law)], *law])
    x_c, P_c = np.zeros(n), np.zeros((n, n))
    kernels.bind("predict", [x, P, u], [x_c, P_c])()
    x_np, F = plain_shape_map.transition(x, u)
    Q = np.zeros(n)
    Q[:2] = np.array([shape_map.Q_PSI, shape_map.Q_OMEGA0]) * u[0]
    P_np = F @ P @ F.T + np.diag(Q)
    assert abs(x_np[1] - x[1]) > 1e-3, "the spin must change for this to say anything"
    assert x_c == pytest.approx(x_np, rel=SAME_FORMULA, abs=SAME_FORMULA * abs(x_np).max())
    assert np.abs(P_c - P_np).max() < SAME_FORMULA * np.abs(P_np).max()


@pytest.mark.parametrize("pad", [1, 2])
def test_the_c_sees_what_the_numpy_twin_sees(kernels, pad):
    """A reading of exactly what is foreseen has no innovation; one that is off moves the state along P hᵀ."""
    x, n = a_state(np.random.default_rng(5), 0.1), shape_map.N
    s, row = plain_shape_map.reading_row(x, *PALMS[:2], pad)
    x_c, P_c, score = np.zeros(n), np.zeros((n, n)), np.zeros(2)
    for off in (0.0, 1e-3):
        z = np.array([s + off, 1e-8, math.inf, 1.0, *PALMS[:2]])
        kernels.bind(f"update_s{pad}", [x, np.eye(n), z], [x_c, P_c, score])()
        assert x_c - x == pytest.approx(row * off / (row @ row + 1e-8), rel=SAME_FORMULA, abs=1e-14)


@pytest.mark.parametrize("start_name", ["good", "blind"])
def test_three_filters_are_one(run, kernels, model, start_name):
    """palmd's C, filterpy on CasADi's functions, and NumPy alone, from the same start and without a gate."""
    _, _, task, truth = run
    start = blind(task) if start_name == "blind" else good(task, truth, np.random.default_rng(1))
    own, plain, other = (
        generated_filter.GeneratedFilter(kernels, start),
        PlainFilter(start),
        FilterpyExtended(model, start),
    )
    for reading in task.readings:
        for peer in (own, plain, other):
            assert peer.step(reading)
        sd = np.sqrt(np.diagonal(own.P))
        assert np.abs((plain.x - own.x) / sd).max() < SAME_FILTER_SD
        assert np.abs((other.x - own.x) / sd).max() < SAME_FILTER_SD
    scale = np.outer(sd, sd)
    assert np.abs((plain.P - own.P) / scale).max() < SAME_FILTER_SD
    assert np.abs((other.P - own.P) / scale).max() < SAME_FILTER_SD
    assert sd[shape_map.Z.SHAPE] < 0.5 * math.sqrt(start.P[shape_map.Z.SHAPE, shape_map.Z.SHAPE]), "it has learnt"


def test_casadis_functions_are_the_numpy_twins(model):
    x = a_state(np.random.default_rng(6), 0.2)
    u = np.array([0.005, *PALMS, *JERK, *RIG])
    moved, F = plain_shape_map.transition(x, u)
    theirs, theirs_F = model.transition(x, u)
    assert array(theirs) == pytest.approx(moved, rel=SAME_FORMULA)
    assert array(model.move(x, u)) == pytest.approx(moved, rel=SAME_FORMULA)
    assert np.abs(theirs_F.full() - F).max() < SAME_FORMULA * np.abs(F).max()
    for pad in (1, 2):
        s, row = plain_shape_map.reading_row(x, *PALMS[:2], pad)
        assert float(model.see[pad - 1](x, PALMS)) == pytest.approx(s, rel=SAME_FORMULA)
        assert model.row[pad - 1](x, PALMS).full()[0] == pytest.approx(row, rel=1e-8, abs=1e-12)


# ------------------------------------------------------------------------------------------------- the task


def test_readings_are_cut_into_short_causal_steps(run):
    _, events, task, _ = run
    pads = [event for event in events if isinstance(event, PadSample)]
    first = next(i for i, event in enumerate(pads) if {event.pad, pads[0].pad} == {1, 2})
    assert [(r.t, r.pad, r.value) for r in task.readings] == [(e.t_sample, e.pad, e.s) for e in pads[first + 1 :]]
    assert task.t_start == pads[first].t_sample
    t = task.t_start
    for reading in task.readings:
        assert sum(u[0] for u in reading.moves) == pytest.approx(reading.t - t)
        assert max(u[0] for u in reading.moves) < 0.0062
        assert reading.palms[:2] == pytest.approx(reading.moves[-1][1:3], abs=0.02)
        t = reading.t
    assert task.readings[0].variance > 10 * task.readings[-1].variance, "the first readings weigh little"


def test_a_run_that_feels_nothing_is_refused():
    with pytest.raises(ValueError, match="both pads"):
        task_from(RigDescription(), [PalmSample(0.0, (0.7, 1.6)), PadSample(0.1, 1, 0.02, 0.5)])


def test_the_truth_knows_what_was_touched(nominal):
    _, _, task, truth = nominal
    theta1 = truth.phi1 - truth.psi - math.pi / 2
    assert truth.touched(theta1).all()
    assert 0.02 < truth.touched(np.linspace(0, math.tau, 360, endpoint=False)).mean() < 0.7
    assert truth.radii(float(truth.t[7])) == pytest.approx([truth.r1[7], truth.r2[7]])
    exact = good(task, truth, np.random.default_rng(0))
    h = shape.basis(np.arange(360) * math.tau / 360) @ exact.x[shape_map.Z.SHAPE :]
    assert 0 < np.abs(h - truth.h).max() < 1.5e-3, "near, but not the truth itself"
    assert np.abs(h - truth.h).max() < np.abs(truth.h - truth.h.mean()).max() + 1e-3


# ------------------------------------------------------------------------------------------------- the others


def test_the_window_is_solved_and_nothing_counts_twice(nominal, model):
    """On a run no longer than the window there is one optimum; past it the arrival cost stands for what has left."""
    _, _, task, truth = nominal
    start = good(task, truth, np.random.default_rng(3))
    peer = horizon.MovingHorizon(model, horizon.program(model), start)
    own = PlainFilter(start)
    wholes = [(own.step(reading), peer.step(reading))[1] for reading in task.readings]
    assert 10 < sum(wholes) < 20
    assert (peer.solved, peer.failed) == (sum(wholes), 0)
    sd = np.sqrt(np.diagonal(own.P))
    late = task.readings[-1]
    assert np.abs(peer.radii(late) - own.radii(late)).max() < 1e-4, "of a near-linear problem both find the answer"
    assert np.abs((peer.x - own.x) / sd)[shape_map.Z.SHAPE :].max() < 3.0


def test_what_leaves_the_window_is_filtered(nominal, model, monkeypatch):
    """Without solutions the window's path is the prediction from the start: about it, the filter of what has left."""
    monkeypatch.setattr(task_module, "GOOD", 0.02)  # so near that all is linear
    _, _, task, truth = nominal
    start = good(task, truth, np.random.default_rng(3))
    peer = horizon.MovingHorizon(model, horizon.program(model), start, every_s=math.inf)
    own, filtered = PlainFilter(start), []
    for reading in task.readings:
        peer.step(reading)
        own.step(reading)
        filtered += [None] * (len(reading.moves) - 1) + [(own.x.copy(), own.P.copy())]
    assert (peer.solved, peer.failed) == (1, 0)
    left = len(filtered) - horizon.NODES
    assert left > 50
    last = max(i for i in range(left) if filtered[i] is not None)
    x, P = filtered[last]
    sd = np.sqrt(np.diagonal(P))
    mean, covariance = peer.arrival
    # ψ and ω0 have moved on by a step that had no reading, the constants have not
    assert np.abs((mean - x) / sd)[2:].max() < 0.3
    assert np.diagonal(covariance)[2:] == pytest.approx(np.diagonal(P)[2:], rel=0.05)
    assert np.abs((x - start.x) / sd)[2:].max() > 2.0, "it has learnt"


def test_the_windows_jacobian_put_together_by_hand_is_right(model):
    solver = horizon.program(model)
    random = np.random.default_rng(4)
    w, p = random.uniform(0.3, 0.6, solver.size1_in("x0")), random.uniform(0.3, 0.6, solver.size1_in("p"))
    _, J = solver.get_function("nlp_jac_g")(w, p)
    g, along, step = solver.get_function("nlp_g"), random.standard_normal(len(w)), 1e-6
    differences = (g(w + step * along, p) - g(w - step * along, p)).full().ravel() / (2 * step)
    assert J.full() @ along == pytest.approx(differences, abs=1e-6 * np.abs(differences).max())


def test_both_forms_of_the_papers_dynamics_are_one():
    """With the forces that Newton and Euler ask for, (4.13)–(4.17) are the regular form's ṙ, ω̇0, ṡ."""
    q = ca.DM([0.02, 0.021, 0.9, 0.019, 0.022, 0.025, 0.018])
    palms = Palms(*(ca.SX(v) for v in PALMS))
    rho, rig = ca.SX(0.014), ca.SX(RIG)
    d1, d2 = offsets(palms.phi2, *(q[i] for i in (0, 1, 3, 4)))
    body = BodyConstants(rho, ca.SX(0), ca.SX(1), ca.SX(0))
    motion = newton_euler(palms, ca.SX(q[2]), Contact(q[0], d1, q[5]), Contact(q[1], d2, q[6]), body, rig)
    forces = ca.vertcat(motion.f1, motion.f2)
    regular = newton.constant(ca.SX(q), palms, forces, rho, rig)[:5]
    papers = newton.eliminated(ca.SX(q[:5]), palms, forces, rho, rig)
    assert array(ca.DM(papers)) == pytest.approx(array(ca.DM(regular)), rel=1e-9)


def own_readings(start, count):
    """Exact readings of an object whose v1 and v2 do stay the same, and its radii at the end."""
    model, rho = newton.window("constant"), math.exp(start.x[shape_map.Z.LN_RHO])
    q = newton.first_state("constant", start, PALMS, np.array(RIG))
    q = q + np.array([1e-5, -1e-5, 1e-2, 0.0, 0.0, 1e-4, -1e-4])
    palms, dt, still = np.concatenate([PALMS[:4], [0.0, 0.0]]), 0.005, [0.0, 0.0]
    readings = []
    for k in range(count):
        u, pad = np.concatenate([[dt], palms, still, RIG]), 1 + k % 2
        q = array(model.step(q, np.concatenate([u, still]), rho))
        palms = np.concatenate([palms[:2] + dt * palms[2:4], palms[2:]])
        readings.append(PeerReading((k + 1) * dt, pad, float(q[2 + pad]), 1e-8, palms, (u,), (math.nan, math.nan)))
    return readings, q


def test_newtons_steps_find_what_keeps_to_their_model(nominal, monkeypatch):
    """Exact readings tell every direction, so that no step need be held back."""
    monkeypatch.setattr(newton, "WELL_SEEN", 1e-12)
    start = blind(nominal[2])
    start.x[shape_map.Z.SHAPE :] += 0.3 * shape.prior_sd(0.02) * np.random.default_rng(9).standard_normal(15)
    readings, end = own_readings(start, 120)
    first = readings[0].moves[0][1:7]
    peer = newton.NewtonObserver(newton.window("constant"), start, first, np.array(RIG), 0.1)
    wholes = [peer.step(reading) for reading in readings]
    assert wholes.index(True) == newton.LEAST - 1
    assert peer.radii(readings[-1]) == pytest.approx(end[:2], abs=1e-7)
    assert peer.outline() is None


def test_a_truth_whose_series_do_not_fit_is_refused():
    fields = simulate_log("nominal", 101, SECONDS)[1]
    with pytest.raises(ValueError, match="lengths"):
        PeerTruth.from_fields(fields | {"r1_m": fields["r1_m"][:-1]})
