"""An object that sticks to one palm and slips on the other: the model against the plant, and blind reconstruction."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from palmd.events import PadSample
from palmd.model import shape
from palmd.model.rolling import SLIPS_SIGN, Lying, friction_asked, normal_forces
from palmd.model.smoothing import CONSTANTS, ORDER, RIG_CONSTANTS, C, R, contact_function
from palmd.observer import dry_reconstruct
from palmd.observer.data_segment import longest_segment
from palmd.observer.dry_fit import LN_MASS as LN_MASS_OF_FIT
from palmd.observer.dry_fit import MU, RIG, SHAPE, DryModel, _palms, _q, _s, phases_of
from palmd.observer.dry_reconstruct import _with_forces, dry_reconstruction, friction_sd
from palmd.observer.noise import with_scatter
from palmd.observer.search import Search
from palmd.observer.stuck_palms import (
    LN_MASS,
    STANDOFF,
    _contacts,
    _initial_filters,
    _learned,
    _not_diverged,
    _rolled,
    blind,
    stuck_guess,
)
from palmd.record.eventlog import read_log
from palmd.rig.dry_plant import DRY, DryPlant
from palmd.rig.imperfections import PERFECT
from palmd.rig.plant import Hinge, PlantOptions, stable_poses
from palmd.rig.shapes import random_body
from palmd.rig.simulate import Rock, Rocking, simulate_log
from palmd.score import score_outline
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.rig_constants import prior_sds
from tools.studies.object_logs import SharpTask, simulated
from tools.studies.simulated import written

STEP = 5e-4
ROCKING = Rocking(Rock(0.75, 0.5, 0.5, 0.3), Rock(1.65, 0.25, 0.8, 1.0))


def searched(log, seconds=math.inf):
    segment = longest_segment(log.events)
    return Search(segment.until(min(segment.start + seconds, segment.end)), with_scatter(log.rig, segment.pads))


@pytest.fixture(scope="module")
def dry():
    return simulated(SharpTask("dry lump", 9000, 8.0))[:2]


def test_the_model_agrees_with_the_emulated_plant():
    """The rolling invariants, direction and speed of slip, both forces, and the friction of the sticking contact."""
    body = random_body("friction", np.random.default_rng(3))
    plant = DryPlant(body, Hinge("fixed", base=(0.0, 0.0)), DRY)
    plant.place(ROCKING.at(0.0), stable_poses(body, ROCKING.at(0.0))[0])
    theta = np.linspace(0.0, math.tau, 360, endpoint=False)
    outline = shape.coefficients_of(body.support.sample(theta), ORDER)
    kept, met = {0: [], 1: []}, 0
    for k in range(1600):
        palms = ROCKING.at((k + 1) * STEP)
        plant.advance(ROCKING.at((k + 0.5) * STEP), palms, STEP)
        sticks = plant.sticking()
        if sticks.count(True) != 1:
            kept[0].append(np.nan)
            continue
        stuck = sticks.index(True)
        at = np.array([[*palms.angles, *palms.rates, *palms.accelerations]])
        lying = Lying.at(at, np.array([plant.state.psi]), ORDER)
        kept[stuck].append(float(lying.kept(stuck)[0] @ outline))
        kept[1 - stuck].append(np.nan)
        if k % 100:
            continue
        met |= 1 << stuck
        slip, s = plant.slips()[1 - stuck], [contact.s for contact in plant.contacts()]
        omega2, phi2, own, other = palms.rates[1], palms.angles[1], s[stuck], s[1 - stuck]
        centres = own * other * math.sin(phi2) / (other - own * math.cos(phi2))
        assert slip == pytest.approx(SLIPS_SIGN[1 - stuck] * omega2 * centres, rel=1e-3, abs=1e-6)
        ax, ay, alpha, *forces = plant._rates
        h, slope = ([float(rows[0] @ outline) for rows in each] for each in (lying.h, lying.slope))
        ratio, pull = np.array([math.copysign(DRY.mu, slip)]), (np.array([ax]), np.array([ay + 9.81]))
        modelled = normal_forces(
            np.array([stuck]), ratio, at, tuple(h), tuple(slope), pull, np.array([body.rho**2 * alpha])
        )
        assert np.ravel(modelled) == pytest.approx(forces, rel=1e-3)
        asked = friction_asked(np.array([stuck]), ratio, at, pull, modelled)
        assert asked[0] == pytest.approx(plant._ratios[stuck], abs=1e-3)
    assert met == 3
    for each in kept.values():
        steps = np.diff(each)
        assert np.nanmax(np.abs(steps)) < 1e-8


def test_filters_determine_the_sticking_palm_and_the_objects_constants(dry):
    log, truth = dry
    search = searched(log)
    guess = stuck_guess(search.record, blind(search.record, search.prior, 0.0))
    assert guess.mass == pytest.approx(truth["mass_kg"], rel=0.02)
    assert guess.mu == pytest.approx(DRY.mu, abs=0.03)
    assert guess.asymmetry == pytest.approx(0.0, abs=1e-6)
    truly = truly_stuck(search.record, truth)
    assert np.mean(truly != guess.palms) < 0.03


def test_contacts_determine_unequal_friction_where_forces_do_not():
    """Forces show the sticking palm by the slip on the other one, which is small here."""
    off = replace(PERFECT, friction=0.3)
    lines, truth = simulate_log("rig", 1109, 5.0, PlantOptions(friction_law="coulomb"), imperfections=off)
    with written(lines) as path:
        search = searched(read_log(path))
    record = search.record
    guess = stuck_guess(record, blind(record, search.prior, AS_CALIBRATED["friction_sd"]))
    assert guess.asymmetry == pytest.approx(0.3, abs=0.1)
    assert np.mean(truly_stuck(record, truth) != guess.palms) < 0.1


def test_a_diverged_filter_is_dropped_and_the_others_continue(dry):
    search = searched(dry[0], 2.0)
    filters = _initial_filters(blind(search.record, search.prior, 0.0))
    x = filters.x.copy()
    x[0, LN_MASS.start] += 800.0
    assert _not_diverged(replace(filters, x=x), filters.x[0]).tolist() == [False, True]
    lost = replace(filters, cost=np.array([0.0, math.nan]))
    assert _not_diverged(lost, filters.x[0]).tolist() == [True, False]


def test_filters_estimate_the_pads_standoffs(dry):
    """Invariants, readings and their sensitivities agree with the fit for the same standoffs."""
    log, _ = dry
    search = searched(replace(log, rig=log.rig.known_to(AS_CALIBRATED)), 2.0)
    record = search.record
    filters = _initial_filters(blind(record, search.prior, 0.0))
    variance = np.diagonal(filters.covariance[0])[STANDOFF]
    assert np.sqrt(variance) == pytest.approx([AS_CALIBRATED["standoff_sd"]] * 2)
    x, part, step = filters.x.copy(), record.between(0, 40), 1e-6
    x[:, STANDOFF] = 5e-4, -2e-4

    def after(x):
        moved = replace(filters, x=x)
        rolled = _rolled(moved, record.palms[0], record.palms[40])
        return rolled, _contacts(moved, part, np.zeros((2, len(part.contact_pad))))

    rolled, (read, by) = after(x)
    outline, standoffs = x[0, 1 : STANDOFF.start], x[0, STANDOFF]
    at_rest = Lying.at(part.contact_palms, np.zeros(len(part.contact_pad)), ORDER)
    both = [_s(at_rest, palm, outline, standoffs) for palm in (0, 1)]
    assert read[0] == pytest.approx(np.where(part.contact_pad == 1, *both))
    for palm in (0, 1):
        ends = Lying.at(record.palms[[0, 40]], np.array([0.0, rolled.x[palm, 0]]), ORDER)
        start, end = _q(ends, palm, outline, standoffs)
        assert end == pytest.approx(start, abs=1e-9)
    for i in range(STANDOFF.start, STANDOFF.stop):
        then, (then_read, _) = after(x + step * np.eye(x.shape[1])[i])
        turned = (then.x[:, 0] - rolled.x[:, 0]) / step
        assert rolled.covariance[:, 0, i] == pytest.approx(turned * variance[0], rel=1e-3)
        assert by[:, :, i] == pytest.approx((then_read - read) / step, rel=1e-3, abs=1e-6)


def test_covariances_stay_positive_despite_rounding(dry):
    """A negative squared residual would be taken for the likeliest sequence of palms."""
    search = searched(dry[0], 2.0)
    record = search.record
    filters = _initial_filters(blind(record, search.prior, 0.3))
    skew = 1e-9 * np.random.default_rng(4).normal(size=filters.covariance.shape)
    sd = np.sqrt(np.diagonal(filters.covariance[0]) + 1e-12)
    filters = replace(filters, covariance=filters.covariance + (skew - skew.transpose(0, 2, 1)) * sd[:, None] * sd)
    still_air = np.zeros(len(record.t)), np.full(len(record.t), 9.81)
    for k in range(0, len(record.t) - 3, 2):
        before = filters.x[:, 0]
        filters = _rolled(filters, record.palms[k], record.palms[k + 2])
        filters = _learned(filters, record.between(k, k + 2), before, tuple(each[k : k + 2] for each in still_air))
    asymmetry = np.abs(filters.covariance - filters.covariance.transpose(0, 2, 1))
    assert (asymmetry <= 1e-12 * sd[:, None] * sd).all()


def test_sticking_palms_are_determined_to_a_step_from_a_fit(dry):
    """With errors of the mode changes as large as those of blind filters, and one change missing."""
    log, truth = dry
    search = searched(log)
    record = search.record
    truly = truly_stuck(record, truth).astype(np.intp)
    wrong = np.roll(truly, 6)
    changes = np.flatnonzero(np.diff(wrong))
    short = int(np.argmin(np.diff(changes)))
    wrong[changes[short] : changes[short + 1] + 1] = wrong[changes[short]]
    model = DryModel(record, search.path, search.prior, phases_of(wrong, record.t))
    fit = model.fit(model.initial_constants(search.prior.mean[C.SHAPE :], truth["mass_kg"], DRY.mu, 0.0))
    start = model.filter_start(fit, blind(record, search.prior, 0.0))
    guess = stuck_guess(record, start)
    assert np.mean(truly != guess.palms) < min(0.01, 0.5 * np.mean(truly != wrong))


def test_restarted_filters_use_the_fits_standoffs(dry):
    log, _ = dry
    search = searched(replace(log, rig=log.rig.known_to(AS_CALIBRATED)), 4.0)
    model, z = drawn(search)
    fit = model._result(z, model._terms(z), settled=True)
    start = model.filter_start(fit, blind(search.record, search.prior, 0.0))
    its = slice(RIG.start + R.STANDOFF, RIG.start + R.STANDOFF + 2)
    assert np.abs(z[its]).min() > 1e-5
    assert start.x[STANDOFF] == pytest.approx(z[its])
    assert start.covariance[STANDOFF, STANDOFF] == pytest.approx(4.0 * np.linalg.inv(fit.matrix)[its, its])


def test_the_pads_force_gains_are_estimated_with_the_object(dry):
    """If they were taken as known, their errors would be unexplained forces."""
    log, truth = dry
    gains = (1.05, 0.96)
    believed = log.rig.with_pads(force_gain_std=0.03)
    off = [
        replace(event, force=event.force * gains[event.pad - 1]) if isinstance(event, PadSample) else event
        for event in log.events
    ]
    search = searched(replace(log, events=tuple(off), rig=believed), 6.0)
    assert len(search.record.force_value) == 0
    record = _with_forces(search)
    phases = phases_of(truly_stuck(record, truth).astype(np.intp), record.t)
    fits = {}
    for stds in ((0.0, 0.0), (0.03, 0.03)):
        model = DryModel(record, search.path, search.prior, phases, stds)
        fits[stds] = model.fit(model.initial_constants(search.prior.mean[C.SHAPE :], truth["mass_kg"], DRY.mu, 0.0))
    estimated, known = fits[0.03, 0.03], fits[0.0, 0.0]
    assert estimated.force_chi2 < known.force_chi2 - 0.05
    modes = model._gain_modes(np.ones(len(record.force_value))) @ estimated.z[model.gains]
    weighed = math.exp(estimated.z[LN_MASS_OF_FIT]) / truth["mass_kg"]
    for pad, gain in enumerate(gains, 1):
        assert weighed * (1.0 + np.mean(modes[record.force_pad == pad])) == pytest.approx(gain, abs=0.01)
    assert estimated.z[MU] == pytest.approx(DRY.mu, abs=0.01)


def truly_stuck(record, truth):
    """The sticking palm at the record's nodes."""
    outline, t = shape.coefficients_of(np.array(truth["h_m"]), ORDER), np.array(truth["t"])
    palms = np.zeros((len(t), 6))
    palms[:, 0], palms[:, 1] = truth["phi1_rad"], truth["phi2_rad"]
    lying = Lying.at(palms, np.array(truth["psi_rad"]), ORDER)
    slips = [np.abs(np.gradient(lying.kept(palm) @ outline, t)) for palm in (0, 1)]
    return np.interp(record.t, t, np.argmin(slips, axis=0).astype(float)) > 0.5


@pytest.mark.nightly
def test_a_sticking_lump_is_reconstructed_from_a_blind_start(dry):
    log, truth = dry
    answer = dry_reconstruction(searched(log), 0, time.perf_counter())
    score = score_outline(answer.theta, answer.h, answer.touched, np.array(truth["h_m"]))
    sd = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    assert score.e_h < min(1e-4, 3.0 * sd)
    assert sd < 1e-4
    assert answer.mu == pytest.approx(DRY.mu, abs=4.0 * answer.mu_sd)
    assert answer.mass == pytest.approx(truth["mass_kg"], abs=4.0 * answer.mass_sd)
    assert answer.turned_sd > 0.0


def test_the_motion_before_a_tumble_is_reconstructed(dry):
    """After a tumble the object continues elsewhere, which no sticking object does."""
    log, truth = dry
    tumbles = 6.3

    def moved(event):
        return replace(event, s=event.s + (4e-3 if event.pad == 1 else -4e-3))

    events = [
        moved(event) if isinstance(event, PadSample) and event.t_sample > tumbles else event for event in log.events
    ]
    search = searched(replace(log, events=tuple(events)))
    answer = dry_reconstruction(search, 0, time.perf_counter())
    assert tumbles - 0.6 < search.segment.start + answer.lasts < tumbles
    assert score_outline(answer.theta, answer.h, answer.touched, np.array(truth["h_m"])).e_h < 1e-4


def test_the_motion_between_two_tumbles_is_reconstructed(dry, monkeypatch):
    """The first tumble makes filters diverge; the second, at the end, is found by the fit and not by filters."""
    monkeypatch.setattr(dry_reconstruct, "LEAST_S", 3.0)
    monkeypatch.setattr(dry_reconstruct, "ROUNDS", 0)  # quicker
    log, truth = dry
    first, until, second = 2.4, 2.9, 7.55

    def moved(event):
        off = 4e-3 if first < event.t_sample < until else 5e-4 if event.t_sample > second else 0.0
        return replace(event, s=event.s + (off if event.pad == 1 else -off))

    events = [moved(event) if isinstance(event, PadSample) else event for event in log.events]
    answer = dry_reconstruction(searched(replace(log, events=tuple(events))), 0, time.perf_counter())
    assert until < answer.t[0] < until + 1.0
    assert second - 0.6 < answer.t[-1] < second
    score = score_outline(answer.theta, answer.h, answer.touched, np.array(truth["h_m"]))
    assert score.e_h < min(1e-4, 3.0 * float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2))))


@pytest.mark.parametrize("gain_std", [0.0, 0.03])
def test_sliding_under_vibration_is_not_taken_for_sticking(gain_std):
    lines, _ = simulate_log("friction", 77, 5.0)
    with written(lines) as path:
        log = read_log(path)
    search = searched(replace(log, rig=log.rig.with_pads(force_gain_std=gain_std)))
    assert dry_reconstruction(search, 0, time.perf_counter()) is None


def test_on_a_calibrated_rig_the_errors_are_within_the_bands(dry):
    log, truth = dry
    calibrated = replace(log, rig=log.rig.known_to(AS_CALIBRATED))
    answer = dry_reconstruction(searched(calibrated), 0, time.perf_counter())
    score = score_outline(answer.theta, answer.h, answer.touched, np.array(truth["h_m"]))
    sd = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    assert score.e_h < 3.0 * sd
    assert 5e-5 < sd < 3e-4  # standoffs of 0.2 mm are partly determined
    assert answer.mu == pytest.approx(DRY.mu, abs=4.0 * answer.mu_sd)
    assert answer.mass == pytest.approx(truth["mass_kg"], abs=4.0 * answer.mass_sd)
    assert answer.turned_sd > 0.0
    sds = np.sqrt(np.diagonal(answer.rig_covariance))
    assert (np.abs(answer.rig) < 3.0 * sds).all()
    assert (sds <= answer.rig_prior_sd * (1.0 + 1e-6)).all()


def drawn(search):
    """A model of a few phases, and constants of an object and of a mis-calibrated rig."""
    palms = (np.arange(len(search.record.t)) // 300 % 2).astype(np.intp)
    model = DryModel(search.record, search.path, search.prior, phases_of(palms, search.record.t), (0.03, 0.0))
    random = np.random.default_rng(5)
    z = model.initial_constants(
        search.prior.mean[C.SHAPE :] + 0.3 * search.prior.sd[C.SHAPE :] * random.normal(size=25), 0.1, 0.2, 0.0
    )
    z[RIG] = prior_sds(RigDescription().known_to(AS_CALIBRATED)) * random.normal(size=RIG_CONSTANTS)
    return model, z


def test_readings_agree_with_the_smoothers_kernel_on_a_mis_calibrated_rig(dry):
    model, z = drawn(searched(dry[0], 6.0))
    record, kernel = model.record, contact_function()
    p = np.zeros(CONSTANTS)
    p[C.RIG : C.SHAPE], p[C.SHAPE :] = z[RIG], z[SHAPE]
    lying = Lying.at(_palms(record.contact_palms, z), np.full(len(record.contact_pad), 0.1), ORDER)
    inputs = record.contact_inputs(len(record.contact_pad))
    for k in range(0, len(inputs), 97):
        palm = int(record.contact_pad[k]) - 1
        value, _, _ = model._contact(lying, palm, z, np.zeros(len(inputs)))
        from_kernel = float(kernel([0.1, 0.0], [0.1, 0.0], p, inputs[k])[0])
        assert value[k] == pytest.approx(from_kernel, abs=3e-6)


def test_a_reading_at_a_nodes_time_up_to_rounding_is_predicted_smoothly(dry):
    """Over 1e-15 s the rate of ψ would be dominated by rounding, and no fit would converge."""
    search = searched(dry[0], 4.0)
    record = search.record
    k = len(record.contact_step) // 2
    node = float(record.t[record.contact_step[k]])
    offset = record.contact_offset.copy()
    offset[k] = np.nextafter(node, math.inf) - node
    record = replace(record, contact_offset=offset)
    palms = (np.arange(len(record.t)) // 300 % 2).astype(np.intp)
    model = DryModel(record, search.path, search.prior, phases_of(palms, record.t))
    z = model.initial_constants(search.prior.mean[C.SHAPE :], 0.1, DRY.mu, 0.0)
    z[RIG.start + R.LAG : RIG.start + R.LAG + 2] = 3e-3
    predicted = []
    for step in range(4):
        z[4] = step * 1e-6
        predicted.append(model._contact_terms(z, *model._orientation(z)).residual[k])
    assert np.diff(predicted, 3) == pytest.approx(0.0, abs=1e-6)


def test_derivatives_agree_with_finite_differences(dry):
    model, z = drawn(searched(dry[0], 4.0))
    psi, slope = model._orientation(z)
    of_contacts, of_forces = (of(z, psi, slope).jacobian for of in (model._contact_terms, model._force_terms))
    standoff, tilt, turn, asymmetry = (RIG.start + which for which in (R.STANDOFF, R.TILT, R.TURN, R.FRICTION))

    def differences(i, of):
        after, before = (z + sign * 1e-7 * np.eye(model.size)[i] for sign in (1.0, -1.0))
        return (of(after) - of(before)) / 2e-7

    for i in (3, standoff, tilt, turn, RIG.stop):
        column = slope[:, i]
        assert differences(i, lambda z: model._orientation(z)[0]) == pytest.approx(
            column, rel=1e-4, abs=1e-4 * np.abs(column).max() + 1e-5
        )
        miss = differences(i, lambda z: -model._contact_terms(z, *model._orientation(z)).residual) - of_contacts[:, i]
        assert np.median(np.abs(miss)) < 1e-2 * np.median(np.abs(of_contacts[:, i])) + 1e-3
    for i in (tilt, turn, asymmetry, model.gains.start, model.gains.stop - 2):
        miss = differences(i, lambda z: -model._force_terms(z, *model._orientation(z)).residual) - of_forces[:, i]
        moved = of_forces[:, i] != 0.0  # only the pad's own gain changes it
        assert np.median(np.abs(miss[moved])) < 1e-2 * np.median(np.abs(of_forces[moved, i]))


@pytest.mark.parametrize("sliding", [1.0, -1.0])  # the object slides on palm 1, or on palm 2
def test_the_band_of_friction_includes_a_palm_with_much_more_of_it_on_which_the_object_only_sticks(sliding) -> None:
    """By the covariance alone a band would end at half of this."""
    asymmetry, sd = 0.05 * sliding, 0.25
    drawn = asymmetry + sd * np.random.default_rng(3).standard_normal(100_000)
    means = 0.08 / (1.0 + sliding * drawn[np.abs(drawn) < 0.9])
    mean = 0.08 / (1.0 + sliding * asymmetry)
    along = -sliding * mean / (1.0 + sliding * asymmetry)
    covariance = sd**2 * np.array([[along**2, along], [along, 1.0]])
    above = np.quantile(means, 0.9772)  # 2 sigma
    assert mean + 2.0 * friction_sd(asymmetry, covariance) == pytest.approx(above, rel=0.05)
    assert friction_sd(0.0, np.diag([1e-4, 0.0])) == pytest.approx(0.01)  # equal palms
