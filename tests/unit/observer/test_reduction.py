"""The smoother's arithmetic: compiled code against its twin in NumPy, and both against dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
from plain_reduction import PlainArithmetic

from palmd.model.smoothing import CONSTANTS, NODE
from palmd.observer.reduction import BAND, ReadingRows, Reduced, StepRows, arithmetic, wide

STEPS = 41
SIDE, WIDTH = CONSTANTS, wide(CONSTANTS)


def residuals(seed=0, counts=(37, 50), constants=CONSTANTS):
    """Steps and readings of two kinds, of realistic size; the last readings lie in the last step."""
    random = np.random.default_rng(seed)
    x = random.standard_normal((STEPS + 1, NODE))
    J = 0.1 * random.standard_normal((STEPS, NODE + constants, NODE))
    J[:, :NODE] += np.eye(NODE)
    ends = x[1:] + 1e-3 * random.standard_normal((STEPS, NODE))
    steps = StepRows(x, ends, J, random.uniform(1e2, 1e4, (STEPS, NODE)))
    kinds = []
    for count in counts:
        step = np.sort(random.integers(0, STEPS, count))
        step[-3:] = STEPS - 1
        gradient = random.standard_normal((count, 2 * NODE + constants))
        kinds.append(ReadingRows(step, gradient, random.standard_normal(count), random.uniform(0.5, 2.0, count)))
    return steps, kinds


def dense(banded):
    matrix = np.diag(banded[0])
    for k in range(1, BAND):
        part = np.diag(banded[k, :-k], -k)
        matrix += part + part.T
    return matrix


def readings(count, outliers, seed=0):
    """Values beside predictions, with errors of the noise's size; those in `outliers` are a hundred times larger."""
    random = np.random.default_rng(seed)
    variance, weight = random.uniform(0.5e-8, 2e-8, count), random.uniform(0.1, 1.0, count)
    value = random.standard_normal(count)
    off = np.sqrt(variance) * random.standard_normal(count)
    off[outliers] *= 100.0
    return value - off, value, variance, weight


@pytest.mark.parametrize("count", [0, 1, 2, 3, 40, 785])
@pytest.mark.parametrize("outliers", [slice(0), slice(3, 9), slice(None, None, 3), slice(None)])
def test_weights_of_readings_agree_with_the_twin(count, outliers):
    given = readings(count, outliers, count)
    got, wanted = arithmetic().weighed(*given), PlainArithmetic().weighed(*given)
    np.testing.assert_array_equal(got.residual, wanted.residual)
    np.testing.assert_allclose(got.root, wanted.root, rtol=1e-13)
    assert got.cost == pytest.approx(wanted.cost, rel=1e-12)
    assert got.chi2 == pytest.approx(wanted.chi2, rel=1e-12)
    assert (got.outliers, got.outlier_run) == (wanted.outliers, wanted.outlier_run)


def test_nan_readings_terminate():
    predicted, *given = readings(50, slice(0))
    predicted[::3] = np.nan
    assert not np.isfinite(arithmetic().weighed(predicted, *given).cost)


@pytest.mark.parametrize(("counts", "constants"), [((37, 50), 45), ((5,), 45), ((), 45), ((37, 50), 60)])
def test_assembled_equations_agree_with_the_twin(counts, constants):
    steps, kinds = residuals(1, counts, constants)
    got, wanted = arithmetic().assembled(steps, kinds), PlainArithmetic().assembled(steps, kinds)
    assert got.process_cost == pytest.approx(wanted.process_cost, rel=1e-12)
    for name in ("banded", "rows", "corner"):
        a, b = getattr(got, name), getattr(wanted, name)
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-11 * np.abs(b).max(), err_msg=name)
    assert got.rows.shape[1] == wide(constants)
    assert not got.rows[:, constants + 1 :].any()


@pytest.mark.parametrize("does", [arithmetic, PlainArithmetic], ids=["compiled", "twin"])
def test_reduction_gives_the_schur_complement(does):
    steps, kinds = residuals(2)
    made = does().assembled(steps, kinds)
    damping = np.array([3.0, 7.0])
    reduced = does().reduced(made.banded, damping, made.rows, made.corner)
    matrix = dense(made.banded) + np.diag(np.tile(damping, STEPS + 1))
    wanted = made.corner - made.rows.T @ np.linalg.solve(matrix, made.rows)
    np.testing.assert_allclose(reduced.left, wanted, rtol=1e-7, atol=1e-9 * np.abs(made.corner).max())
    factor = np.tril(dense(reduced.factor))
    np.testing.assert_allclose(factor @ factor.T, matrix, rtol=1e-9, atol=1e-9 * np.abs(matrix).max())
    by = np.random.default_rng(0).standard_normal(WIDTH)
    np.testing.assert_allclose(does().back(reduced, by), np.linalg.solve(matrix, made.rows @ by), rtol=1e-7, atol=1e-9)


def test_reduction_agrees_with_the_twin_and_keeps_its_inputs():
    steps, kinds = residuals(3)
    made = arithmetic().assembled(steps, kinds)
    before = [each.copy() for each in (made.banded, made.rows, made.corner)]
    got, wanted = (
        each.reduced(made.banded, np.zeros(NODE), made.rows, made.corner) for each in (arithmetic(), PlainArithmetic())
    )
    for a, b in zip(before, (made.banded, made.rows, made.corner), strict=True):
        np.testing.assert_array_equal(a, b)
    for name in Reduced.__slots__:
        a, b = getattr(got, name), getattr(wanted, name)
        if name == "factor":
            a, b = np.tril(dense(a)), np.tril(dense(b))
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9 * np.abs(b).max(), err_msg=name)


@pytest.mark.parametrize("does", [arithmetic, PlainArithmetic], ids=["compiled", "twin"])
@pytest.mark.parametrize("wrong", [-1e9, np.nan, np.inf])
def test_a_matrix_that_is_not_positive_definite_is_refused(does, wrong):
    steps, kinds = residuals(4)
    made = does().assembled(steps, kinds)
    made.banded[0, 9] = wrong
    with pytest.raises(np.linalg.LinAlgError):
        does().reduced(made.banded, np.zeros(NODE), made.rows, made.corner)


def test_arrays_of_the_wrong_shape_are_refused():
    steps, kinds = residuals(5)
    made, does = arithmetic().assembled(steps, kinds), arithmetic()
    nothing = np.zeros(NODE)
    with pytest.raises(ValueError, match=r"float64 \(28, 56\), not contiguous of shape \(56, 56\)"):
        does.reduced(made.banded, nothing, made.rows, made.corner[::2])
    with pytest.raises(ValueError, match="a multiple of 8, not 54"):
        does.reduced(made.banded, nothing, made.rows[:, :54], made.corner)
    with pytest.raises(ValueError, match=r"float32 \(42, 2\)"):
        does.assembled(replace(steps, x=steps.x.astype(np.float32)), kinds)
    with pytest.raises(ValueError, match="too many constants: 130; the limit is 127"):
        does.assembled(*residuals(5, constants=130))
    with pytest.raises(ValueError, match="a reading is in no step"):
        does.assembled(steps, [replace(kinds[0], step=kinds[0].step + 1)])
