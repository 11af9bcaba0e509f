"""What JSON has no form for becomes None wherever it stands; all else stays what it is."""

import json
import math

import numpy as np
import pytest

from palmd.jsonvalues import or_none


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, np.float64("nan")])
def test_numbers_that_are_none_are_none_at_any_depth(bad):
    told = or_none({"a": bad, "b": [1.0, bad, {"c": [bad]}], "d": [[bad, 2.0]], "e": (bad, 1.0)})
    assert told == {"a": None, "b": [1.0, None, {"c": [None]}], "d": [[None, 2.0]], "e": [None, 1.0]}
    assert or_none(bad) is None
    json.dumps(told, allow_nan=False)


def test_all_else_stays_and_what_was_given_too():
    given = {
        "text": "nan",
        "yes": True,
        "nothing": None,
        "count": 3,
        "list": [0.0, -0.0, 1e308],
        "deep": {"x": [math.nan]},
    }
    told = or_none(given)
    assert told == {**given, "deep": {"x": [None]}}
    assert told["yes"] is True
    assert math.isnan(given["deep"]["x"][0])
