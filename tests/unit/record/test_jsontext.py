"""Lines of JSON from C: the same bytes as `json.dumps`, whatever the numbers and what stands beside them."""

import json
import math
import random
import struct

import pytest

from palmd.record import jsontext
from palmd.record.jsontext import as_json

EDGES = [
    *(0.0, -0.0, 0.1, 1.0, 100.0, 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, 9007199254740993.0),
    *(1e15, 1e16, 1e17, 1e22, 1e23, 123456789012345680.0, 1e-4, 9.5e-5, 1e-5, 1764194400.123457, 13.67),
]


@pytest.fixture(autouse=True)
def compiled():
    if jsontext.backend() != "c":
        pytest.skip("no C compiler")


def same(numbers):
    told = as_json({str(i): x for i, x in enumerate(numbers)})
    if told != json.dumps({str(i): x for i, x in enumerate(numbers)}):  # which one it is
        assert [as_json({"x": x}) for x in numbers] == [json.dumps({"x": x}) for x in numbers]
        raise AssertionError("each by itself is right, all together are not")


def test_of_any_double():
    bits = random.Random(5)
    drawn = (struct.unpack("d", struct.pack("Q", bits.getrandbits(64)))[0] for _ in range(20_000))
    same([x for x in drawn if math.isfinite(x)])


def test_of_what_estimates_have():
    drawn = random.Random(6)
    same([drawn.uniform(-1.0, 1.0) * 10.0 ** drawn.randint(-8, 3) for _ in range(20_000)])
    same([round(drawn.uniform(-1.0, 1.0) * 10.0 ** drawn.randint(-4, 18), drawn.randint(0, 12)) for _ in range(5_000)])


def test_at_the_edges():
    same(EDGES)
    powers = [2.0**k for k in range(-1074, 1024)]  # below each of which doubles lie twice as close
    same(powers)
    same([math.nextafter(x, to) for x in powers for to in (0.0, math.inf) if x < 1e308])
    same([10.0**k for k in range(-323, 309)])
    same([float(i) for i in range(-50, 2000)])


def test_of_what_is_no_number_alone():
    told = {
        "t": math.nan,
        "n": -3,
        "yes": True,
        "no": False,
        "none": None,
        "text": 'a "%s" \x01 é',
        "list": [1.5, math.inf],
    }
    nested = {"100 %": {"sd %d": 0.25, "deep": {"x": -math.inf}, "empty": {}}}
    wanted = told | {"t": None, "list": [1.5, None]}
    assert as_json(told | nested) == json.dumps(wanted | {"100 %": {"sd %d": 0.25, "deep": {"x": None}, "empty": {}}})


def test_the_same_without_a_compiler(monkeypatch):
    fields = {"t": 0.1, "sd": {"x": math.nan, "y": 1e-7}, "seq": 3}
    compiled = as_json(fields)
    monkeypatch.setattr(jsontext, "_library", lambda: None)
    assert as_json(fields) == compiled
    assert jsontext.backend() == "python"
