"""Values without a JSON form become None at any depth; all others stay unchanged."""

import json
import math

import numpy as np
import pytest

from palmd.jsonvalues import or_none


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, np.float64("nan")])
def test_values_that_are_not_finite_become_none_at_any_depth(bad):
    converted = or_none({"a": bad, "b": [1.0, bad, {"c": [bad]}], "d": [[bad, 2.0]], "e": (bad, 1.0)})
    assert converted == {"a": None, "b": [1.0, None, {"c": [None]}], "d": [[None, 2.0]], "e": [None, 1.0]}
    assert or_none(bad) is None
    json.dumps(converted, allow_nan=False)


def test_other_values_and_the_input_stay_unchanged():
    given = {
        "text": "nan",
        "yes": True,
        "nothing": None,
        "count": 3,
        "list": [0.0, -0.0, 1e308],
        "deep": {"x": [math.nan]},
    }
    converted = or_none(given)
    assert converted == {**given, "deep": {"x": [None]}}
    assert converted["yes"] is True
    assert math.isnan(given["deep"]["x"][0])
