"""Readings laid out on the nodes of a record."""

import numpy as np
import pytest

from palmd.events import PadSample, PalmSample
from palmd.observer.palm_path import smoothed_path
from palmd.observer.record import lay_out
from palmd.system.description import PadSensor, RigDescription

RIG = RigDescription(hinge="fixed")
PATH = smoothed_path(
    [PalmSample(0.016 * k, (0.7 + 0.2 * 0.016 * k, 1.6), (0.2, 0.0), (0.0, 0.0)) for k in range(80)], 2e-4
)


def pads(*times, force=1.0):
    return [PadSample(t, 1 + k % 2, 0.02 + t / 1000, force) for k, t in enumerate(times)]


def laid(samples, end=0.1, spacing=0.01, rig=RIG):
    return lay_out(samples, PATH, rig, 0.0, end, spacing)


def test_each_reading_is_assigned_to_its_step():
    times = (0.0, 0.0099, 0.01, 0.055, 0.1)
    record = laid(pads(*times))
    assert record.t == pytest.approx(np.arange(11) * 0.01)
    assert record.contact_step.tolist() == [0, 0, 1, 5, 9]
    assert record.t[record.contact_step] + record.contact_offset == pytest.approx(times)
    assert (record.contact_offset <= 0.01 + 1e-12).all()
    assert record.contact_pad.tolist() == [1, 2, 1, 2, 1]
    assert record.contact_palms[:, 0] == pytest.approx(0.7 + 0.2 * np.array(times), abs=1e-6)
    assert record.palms[:, 0] == pytest.approx(0.7 + 0.2 * record.t, abs=1e-6)


def test_modelled_contact_forces_are_scaled_to_the_readings():
    samples = pads(*np.arange(0.0, 0.1, 0.005), force=2.0)
    silent = [PadSample(each.t_sample, each.pad, each.s, None if each.pad == 2 else each.force) for each in samples]
    record = laid(silent)
    first = record.contact_pad == 1
    model = 1.0 + record.t[record.contact_step] + record.contact_offset  # of an object of another mass
    pressed = record.with_contact_forces(model)
    ratio = pressed.contact_force[first] / model[first]
    assert ratio == pytest.approx(np.median(2.0 / model[first]))
    assert (pressed.contact_force[~first] == 0.0).all()
    assert record.contact_force[first] == pytest.approx(2.0), "the record itself is unchanged"
    assert laid(pads(0.01, 0.02, force=None)).with_contact_forces(np.ones(2)).contact_force.tolist() == [0.0, 0.0]


def test_a_saturated_reading_gets_the_pads_largest_force():
    """It has no force reading, but not a zero force."""
    forces = [1.0, 2.0, 2.5, None, None, 2.4, 1.5]
    record = laid([PadSample(0.01 * k, 1, 0.02, force) for k, force in enumerate(forces)])
    assert record.contact_force.min() == pytest.approx(1.0)
    assert record.contact_force[3:5] == pytest.approx(record.contact_force.max())
    assert record.force_step.tolist() == [0, 1, 2, 5, 6]


def test_a_permanently_saturated_pad_gets_the_modelled_force():
    """Scaled by the other pad, since its own largest earlier reading is no measure of the force."""
    silent = [PadSample(0.01 * k, 1 + k % 2, 0.02, 1.0 if k % 2 else None) for k in range(8)]
    record = lay_out(silent, PATH, RigDescription(hinge="fixed"), 0.0, 0.1, 0.01, most_forces=(2.5, 1.2))
    beyond = record.contact_pad == 1
    assert record.contact_force[beyond] == pytest.approx(2.5)
    assert record.contact_force[~beyond] == pytest.approx(1.0)
    pressed = record.with_contact_forces(np.where(beyond, 6.0, 2.0))
    assert pressed.contact_force == pytest.approx(np.where(beyond, 3.0, 1.0))


def test_readings_outside_the_nodes_are_left_out():
    assert laid(pads(-0.01, 0.05, 0.11)).contact_value == pytest.approx([0.02005])


def test_noise_of_contacts_and_forces():
    record = laid(pads(*np.arange(0.0, 0.1, 0.01), force=2.0))
    assert record.contact_variance == pytest.approx(1e-4**2 + 1.27e-4**2 / 12)
    assert record.force_variance == pytest.approx((0.05 * 2.0) ** 2 + 0.02**2 / 12)


def test_each_pad_has_its_own_noise_and_gain():
    worse = PadSensor(noise=5e-4, force_scale_std=0.1, force_gain_std=0.03, length=0.04)
    samples = pads(*np.arange(0.0, 0.1, 0.01), force=2.0)
    record = laid(samples, rig=RigDescription(hinge="fixed", pads=(PadSensor(), worse)))
    assert record.contact_variance[:2] == pytest.approx([1e-8 + 1.27e-4**2 / 12, 25e-8 + 1.27e-4**2 / 12])
    assert set(record.force_pad) == {1.0}, "only forces of a pad with a drifting gain are left out"
    assert record.contact_inputs(64)[0, -2:].tolist() == [0.0555, 0.04]
    steady = RigDescription(hinge="fixed", pads=(PadSensor(), PadSensor(force_scale_std=0.1)))
    assert laid(samples, rig=steady).force_variance[:2] == pytest.approx([0.01 + 0.02**2 / 12, 0.04 + 0.02**2 / 12])


def test_an_outlier_of_force_does_not_widen_its_own_variance():
    samples = pads(*np.arange(0.0, 0.1, 0.005), force=2.0)
    samples[6] = PadSample(samples[6].t_sample, samples[6].pad, 0.02, 2000.0)
    assert laid(samples).force_variance.max() == pytest.approx((0.05 * 2.0) ** 2 + 0.02**2 / 12)


@pytest.mark.parametrize("force", [None, 0.0, -1.0, float("nan"), float("inf")])
def test_missing_zero_or_invalid_forces_are_left_out(force):
    samples = [*pads(0.01, 0.02), PadSample(0.03, 1, 0.02, force)]
    record = laid(samples)
    assert len(record.contact_value) == 3
    assert record.force_step.tolist() == [1, 2]
    assert np.isfinite(record.force_variance).all()


def test_a_part_of_a_record_equals_its_own_layout():
    samples = pads(*np.arange(0.0, 0.1, 0.003))
    part, wanted = laid(samples).until(0.0501), laid([s for s in samples if s.t_sample < 0.05], end=0.05)
    for name in ("t", "palms", "contact_step", "contact_offset", "contact_value", "force_step", "force_value"):
        assert getattr(part, name) == pytest.approx(getattr(wanted, name))
    assert len(laid(samples).until(-1.0).t) == 2


def test_kernel_inputs_are_padded_with_finite_values():
    record = laid(pads(0.01, 0.02))
    for inputs in (record.step_inputs(64), record.contact_inputs(64), record.force_inputs(64)):
        assert np.isfinite(inputs).all()
        assert (inputs[:, 0] > 0).all()
    assert record.step_inputs(64)[:10, 0] == pytest.approx(0.01)
    kappa, transmission, averaged, off = 0.0, 1.0, 0.0, [0.0] * 4
    half_period = RIG.vibration.half_period
    wanted = [9.81, *[0.0] * 6, kappa, transmission, averaged, half_period, *off, 0.0555, 0.0555]
    assert record.step_inputs(64)[0, 9:].tolist() == wanted


def test_the_contact_force_is_averaged_over_neighbours_in_time():
    """A reading's own noise would bias the estimated dependence on force towards 0."""
    random = np.random.default_rng(1)
    times = np.arange(0.0, 1.0, 0.005)
    noisy = [PadSample(t, 1 + k % 2, 0.02, 1.0 + 0.05 * random.standard_normal()) for k, t in enumerate(times)]
    record = laid(noisy, end=1.0)
    assert np.std(record.contact_force) < 0.5 * np.std(record.force_value)
    assert record.contact_force.mean() == pytest.approx(1.0, abs=0.02)
