import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from palmd.system.corrections import corrections


@pytest.mark.parametrize("count", [2, 3, 4, 9])
def test_corrections_are_the_natural_cubic_spline_and_constant_beyond_its_ends(count):
    random = np.random.default_rng(count)
    at = np.sort(random.uniform(0.0, 50.0, count))
    values = random.normal(0.0, 0.1, count)
    points = list(zip(at.tolist(), values.tolist(), strict=True))
    places = np.linspace(at[0], at[-1], 101)
    assert corrections(points, places) == pytest.approx(CubicSpline(at, values, bc_type="natural")(places), abs=1e-12)
    assert corrections(points, at) == pytest.approx(values, abs=1e-12)
    assert corrections(points, [-5.0, 60.0]) == pytest.approx(values[[0, -1]], abs=1e-12)
