"""Numbers and words with characters that only look like ASCII: reported with their place and the correction."""

import pytest

from palmd.yamlfile import ConfigError, load_any_config

TEXT = """\
rig: {{hinge: fixed}}  # − “comment”
pads:
  palm1: {{kind: strip, port: /dev/a, zero_mm: {}}}
  palm2: {{kind: strip, port: /dev/b}}
arm: {{kind: dynamixel, port: /dev/c}}
"""
COLUMN = 47


def errors(tmp_path, text):
    path = tmp_path / "palmd.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_any_config(path)
    return [line.removeprefix(f"{path}:") for line in caught.value.errors]


@pytest.mark.parametrize(
    ("written", "name", "number"),
    [
        ("\u22125", "U+2212 MINUS SIGN", "-5"),
        ("\u20135", "U+2013 EN DASH", "-5"),
        ("\u200b5", "U+200B ZERO WIDTH SPACE", "5"),
        ("\ufeff5", "U+FEFF ZERO WIDTH NO-BREAK SPACE", "5"),
        ("\uff15", "U+FF15 FULLWIDTH DIGIT FIVE", "5"),
        ("\u201c5\u201d", "U+201C LEFT DOUBLE QUOTATION MARK", "5"),
        ("\u0665", "U+0665 ARABIC-INDIC DIGIT FIVE", "5"),
        ("\u066b5", "U+066B ARABIC DECIMAL SEPARATOR", "0.5"),
    ],
)
def test_a_lookalike_is_reported_with_its_code_point_and_the_intended_number(tmp_path, written, name, number):
    found = errors(tmp_path, TEXT.format(written))
    assert any(line.startswith(f"3:{COLUMN}: {name}: ") for line in found)
    assert any(
        line.startswith(f"3:{COLUMN}: pads.palm1.zero_mm") and line.endswith(f"write {number}") for line in found
    )


@pytest.mark.parametrize(
    ("written", "number"),
    [("-010", "-10"), ("010", "10"), ("-0o10", "-8"), ("1,5", "1.5"), ("-1,5", "-1.5"), ("1 000", "1000"),
     ("1,500.5", "1500.5"), ("-.5", "-0.5"), ("-1:30", "-90")],
)  # fmt: skip
def test_the_advice_is_the_intended_number(tmp_path, written, number):
    (problem,) = errors(tmp_path, TEXT.format(written))
    assert f"write {number}" in problem
    assert problem.startswith("3:")


@pytest.mark.parametrize("odd", ["\u00a0", "\u200b", "\u2028", "\u0085", "\x00"])
def test_invisible_characters_are_always_reported(tmp_path, odd):
    found = errors(tmp_path, TEXT.format(5).replace("/dev/a", f"/dev/a{odd}"))
    assert any(line.startswith(f"3:36: U+{ord(odd):04X} ") for line in found)


def test_other_scripts_are_no_error(tmp_path):
    path = tmp_path / "palmd.yaml"
    path.write_text(TEXT.format(5).replace("/dev/a", "/dev/Küche–links"), encoding="utf-8")
    load_any_config(path)
