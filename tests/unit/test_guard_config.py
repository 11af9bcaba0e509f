"""The guards' keys in a configuration: what they mean, and where bad input is told."""

import pytest

from palmd.config.guards import force_limits
from palmd.yamlfile import ConfigError, load_config

RIG = """\
pads:
  palm1: {port: /dev/a}
  palm2: {port: /dev/b}
arm: {port: /dev/c}
limits:
"""


def limits(tmp_path, text):
    path = tmp_path / "palmd.yaml"
    path.write_text(RIG + text, encoding="utf-8")
    return load_config(path).limits


def test_without_a_limit_a_force_is_limited_where_the_pad_saturates(tmp_path):
    told = limits(tmp_path, "  rate_deg_s: 100\n")
    assert force_limits(told.force_n, {"palm1": 2.54, "palm2": 5.0}) == pytest.approx((2.54, 5.0))
    assert told.following_error.at_rest_deg < told.following_error.at_full_rate_deg


@pytest.mark.parametrize(
    ("text", "expected"), [("1.5", (1.5, 1.5)), ("{palm2: 1.0}", (2.54, 1.0)), ("{palm1: 1, palm2: 2}", (1.0, 2.0))]
)
def test_a_force_is_of_all_pads_or_of_each(tmp_path, text, expected):
    told = limits(tmp_path, f"  force_n: {text}\n")
    assert force_limits(told.force_n, {"palm1": 2.54, "palm2": 2.54}) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("  force_n: -1\n", ":6:"),
        ("  force_n: {palm1: 0}\n", ":6:"),
        ("  force_n: {palm3: 1}\n", ":6:"),
        ("  force_n: much\n", ":6:"),
        ("  following_error: {at_rest_deg: 0}\n", ":6:"),
        ("  following_error: {at_rest_deg: 2, at_full_rate_deg: 1}\n", ":6:"),
        ("  following_error: {at_rest_mm: 9, at_full_rate_mm: 8}\n", ":6:"),
        ("  following_error: {at_rest: 1}\n", ":6:"),
        ("  following_error: 3\n", ":6:"),
    ],
)
def test_bad_input_is_told_with_its_place(tmp_path, text, place):
    with pytest.raises(ConfigError) as told:
        limits(tmp_path, text)
    assert place in str(told.value)
