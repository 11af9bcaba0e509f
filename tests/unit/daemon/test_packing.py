"""Messages as bytes: a vector is packed exactly as the list of its numbers."""

import math

import msgpack
import numpy as np
import pytest

from palmd.daemon.packing import FieldsPacker

STRANGE = [0.0, -0.0, 1.0, -1e-300, math.pi, math.inf, -math.inf, math.nan, 5e-324]


@pytest.mark.parametrize("count", [0, 1, 9, 15, 16, 300, 70_000])
def test_a_vector_is_packed_as_the_list_of_its_numbers(count):
    numbers = np.resize(STRANGE, count)
    fields = {"t": 1.5, "valid": True, "before": numbers, "names": ["a", "b"], "none": None, "after": numbers[::-1]}
    listed = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in fields.items()}
    assert FieldsPacker()(fields) == msgpack.packb(listed)


def test_a_message_that_cannot_be_packed_is_refused_and_the_next_is_complete():
    pack = FieldsPacker()
    with pytest.raises(TypeError):
        pack({"numbers": np.zeros(3), "thing": object()})
    assert pack({"t": 1.0}) == msgpack.packb({"t": 1.0})
    assert pack({"x": np.ones(2)}) == msgpack.packb({"x": [1.0, 1.0]})
