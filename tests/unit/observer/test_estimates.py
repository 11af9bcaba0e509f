"""The published estimate is complete although it is built faster than by a dataclass constructor."""

import dataclasses
from types import SimpleNamespace

import pytest

from palmd.events import Estimate
from palmd.model.outputs import NAMED
from palmd.observer.estimates import make_estimate

VALUES = [0.1 * i for i in range(1, len(NAMED) + 1)]
SDS = [0.01 * i for i in range(1, len(NAMED) + 1)]


def built():
    mass = SimpleNamespace(value=0.2, sd=0.01)
    return make_estimate(1.5, True, "shape", 2, VALUES, SDS, mass, 1.1, 2.2, 0.3, ("diverged",))


def test_every_field_is_set():
    estimate = built()
    values = {field.name: getattr(estimate, field.name) for field in dataclasses.fields(Estimate)}
    assert repr(estimate) == repr(Estimate(**values))
    assert set(vars(estimate)) | {"e_f", "e_c"} == set(values)
    assert (estimate.t, estimate.r1, estimate.mass, estimate.touched) == (1.5, VALUES[NAMED.index("r1")], 0.2, 0.3)
    assert estimate.invalid_reasons == ("diverged",)
    assert set(estimate.sd) == {*NAMED, "mass"}


def test_it_is_immutable():
    with pytest.raises(dataclasses.FrozenInstanceError):
        built().r1 = 0.0
