"""Every error in a YAML file is reported with its place; nothing hangs."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmd.yamlfile import ConfigError, load_config, load_plan

PORTS = "pads: {palm1: {port: /dev/a}, palm2: {port: /dev/b}}\narm: {port: /dev/c}\n"
LINE = re.compile(r"(.+):([0-9]+):([0-9]+): (.+)", re.DOTALL)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "palmd.yaml"


def said(path: Path, content: str | bytes) -> list[str]:
    """The errors of a configuration, as `line:col: text`."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    prefix = f"{path}:"
    assert all(error.startswith(prefix) for error in caught.value.errors)
    return [error.removeprefix(prefix) for error in caught.value.errors]


def test_a_good_file_loads_with_paths_beside_it(file: Path) -> None:
    file.write_text(PORTS + "plan: plans/rock.yaml\nlimits: {phi1_deg: [6, 150]}\nrig: {base_mm: [120, 0]}\n")
    config = load_config(file)
    assert config.plan == file.parent / "plans/rock.yaml"
    assert config.limits.phi1_deg == (6.0, 150.0)


def test_all_errors_are_reported_at_once_each_at_its_place(file: Path) -> None:
    content = """\
rig:
  gravity_m_s2: .nan
  palm1_lenght_mm: 120
  palm2_length_mm: 1e2
pads:
  palm1: {port: no, sign: true, zero_mm: "28", counts_per_mm: -1}
  palm2: {port: a, port: b}
limits: {phi1_deg: [150, 6], phi2_deg: [35], rate_deg_s: .inf}
loop:
observer: {primary: shap}
bus: {publish: "tcp://0.0.0.0:9872"}
"""
    assert said(file, content) == [
        "1:1: arm: is missing",
        "2:17: rig.gravity_m_s2: must be a finite number; got .nan",
        "3:3: rig.palm1_lenght_mm: unknown key; did you mean palm1_length_mm?",
        "4:20: rig.palm2_length_mm: must be a number; got the text 1e2; write 100.0 or 1.0e+2",
        '6:17: pads.palm1.port: must be text; got no, which YAML reads as false; put it in quotes: "no"',
        "6:27: pads.palm1.sign: must be a whole number; got true",
        '6:42: pads.palm1.zero_mm: must be a number; got the text "28"; leave out the quotes',
        "6:63: pads.palm1.counts_per_mm: must be more than 0; got -1",
        "7:20: pads.palm2.port: this key is already in line 7",
        "8:20: limits.phi1_deg: must be [low, high] with -30 ≤ low < high ≤ 180; got [150, 6]",
        "8:40: limits.phi2_deg: must have 2 entries; got 1",
        "8:58: limits.rate_deg_s: must be a finite number; got .inf",
        "9:6: loop: has no value: write one or leave the key out",
        "10:21: observer.primary: must be one of shape, extended or quasistatic; got the text shap",
        "11:16: bus.publish: 0.0.0.0 can be reached from other machines, which needs CURVE keys, and none are"
        " configured; use tcp://127.0.0.1:PORT or ipc://PATH",
    ]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "1:1: the file is empty"),
        ("# nothing\n", "1:1: the file is empty"),
        ("- 1\n- 2\n", "1:1: must be a block of keys and values; got a list"),
        ("just words\n", "1:1: must be a block of keys and values; got the text just words"),
        ("rig:\n\tgravity_m_s2: 9\n", "2:1: a tab in the indentation: use spaces"),
        ("rig:\n  gravity_m_s2: 9\n\thinge: arc\n", "3:1: a tab in the indentation: use spaces"),
        ("rig: {hinge:\tarc}\n", "1:13: a tab: use spaces"),
        ("a: 1\n---\nb: 2\n", "2:1: a second document begins here; a file holds one"),
        ("a: {b: 1\nc: 2\n", "2:2: not valid YAML: expected ',' or '}', but got ':' (while parsing a flow mapping)"),
        ("a: &x 1\nb: *x\n", "2:4: aliases (*x) are not accepted; write the values out"),
        (b"a: b\n\xff\xfe: 1", "2:1: not UTF-8 text; save the file as UTF-8"),
        ("a: b\0c", "1:5: U+0000 a control character: it is invisible: delete it"),
        ("[" * 1000, "1:21: nested too deeply"),
    ],
)
def test_unreadable_yaml_files_are_rejected(file: Path, content: str | bytes, expected: str) -> None:
    assert said(file, content) == [expected]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("limits: {rate_deg_s: 1:30}", "3:22: 1:30 is sexagesimal in YAML; write 90 if that is meant"),
        ("limits: {rate_deg_s: 010}", "3:22: 010 is octal in YAML (8); write 10 without the zero"),
        ("limits: {<<: {rate_deg_s: 8}}", "3:10: merge keys (<<) are not accepted; write the keys out"),
        ("rig: !!python/object:os.system {}", "3:6: tags (tag:yaml.org,2002:python/object:os.system) are not accepted"),
        ("plan: !!binary aGk=", "3:7: tags (tag:yaml.org,2002:binary) are not accepted"),
        ("? [1, 2]\n: 3", "3:3: a key must be a plain word"),
        ("limits: {rate_deg_s: !!int fast}", "3:22: not a usable number: fast"),
        (f"limits: {{rate_deg_s: {'9' * 5000}}}", f"3:22: not a usable number: {'9' * 37}…"),
        ("limits: {}\nlimits: {}", "4:1: limits: this key is already in line 3"),
        ("on: 1", "3:1: on: unknown key"),
        ("plan: [a]", "3:7: plan: must be a path as text"),
        ("limits: {rate_deg_s: 1.0.0}", "3:22: limits.rate_deg_s: must be a number; got the text 1.0.0"),
        ("limits: {rate_deg_s: 2001-01-01}", "3:22: limits.rate_deg_s: must be a number; got the text 2001-01-01"),
        (
            "limits: {rate_deg_s: -1e3}",
            "3:22: limits.rate_deg_s: must be a number; got the text -1e3; write -1000.0 or -1.0e+3",
        ),
    ],
)
def test_misleading_yaml_is_rejected(file: Path, line: str, expected: str) -> None:
    assert expected in said(file, PORTS + line + "\n")


def test_a_word_over_several_lines_is_quoted_in_one(file: Path) -> None:
    lines = said(file, '? "ra\n\n  dar"\n: 1\n')
    assert "1:3: ra dar: unknown key" in lines
    assert all(len(line.splitlines()) == 1 for line in lines)


def test_valid_notations_are_accepted(file: Path) -> None:
    file.write_text(
        PORTS + "autostart: yes\nlimits: {rate_deg_s: 1.0e+2, acceleration_deg_s2: 1_000}\n"
        "rig: {gravity_m_s2: 9, base_mm: [0, -0.5]}\n"
    )
    config = load_config(file)
    assert (config.autostart, config.limits.rate_deg_s, config.limits.acceleration_deg_s2) == (True, 100, 1000)


def test_a_byte_order_mark_is_ignored(file: Path) -> None:
    file.write_bytes(b"\xef\xbb\xbf" + PORTS.encode())
    load_config(file)


def test_paths_that_are_no_files_are_rejected(tmp_path: Path) -> None:
    for path, what in (
        (tmp_path, "this is a folder, not a file"),
        (tmp_path / "none.yaml", "no such file"),
        (tmp_path / "none" / "x.yaml", "no such file"),
    ):
        with pytest.raises(ConfigError) as caught:
            load_config(path)
        assert caught.value.errors == [f"{path}:1:1: {what}"]


@pytest.mark.parametrize(
    "content",
    [
        b"a" * 10_000_000,
        b"a: [" * 2_500_000,
        b"a: &a [x, x]\n" + b"".join(b"b%d: &b%d [*a, *a]\n" % (i, i) for i in range(1000)),
        b"\n".join(b"k%d: {a: 1}" % i for i in range(8000)),
        b"{" * 200_000,
    ],
    ids=["10 MB", "10 MB of lists", "aliases", "8000 unknown keys", "braces"],
)
def test_absurd_files_are_rejected_quickly(file: Path, content: bytes) -> None:
    begin = time.monotonic()
    errors = said(file, content)
    assert time.monotonic() - begin < 10.0
    assert 0 < len(errors) < 200


def test_plan_errors_are_placed_within_their_segments(file: Path) -> None:
    file.write_text("""\
name: 1
repeat: often
segments:
  - {move: {phi1_deg: 45, phi2_deg: }, duration_s: 2s}
  - {rate: {phi1_deg_s: 0}, until: {phi1_deg: 55, phi2_deg: 3}}
  - {hold_s: 0}
  - {sine: {phi1_deg: 18}, frequency_hz: x, duration_s: 20, duration_s: 3}
  - {explore: {coverage: 2}, hold_s: 2}
  - move
dither: {amplitude_deg: 0.1}
""")
    with pytest.raises(ConfigError) as caught:
        load_plan(file)
    kinds = "move, rate, hold_s, sine, explore"
    assert [error.removeprefix(f"{file}:") for error in caught.value.errors] == [
        '1:7: name: must be text; got 1; put it in quotes: "1"',
        "2:9: repeat: must be a whole number from 1 to 10000, or forever; got 'often'",
        "4:36: segments.0.move.phi2_deg: has no value: write one or leave the key out",
        "4:52: segments.0.duration_s: must be a number; got the text 2s",
        "5:12: segments.1.rate: needs a rate other than 0 for phi1_deg_s or phi2_deg_s",
        "5:36: segments.1.until: needs exactly one of phi1_deg, phi2_deg",
        "6:14: segments.2.hold_s: must be more than 0; got 0",
        "7:42: segments.3.frequency_hz: must be a number; got the text x",
        "7:61: segments.3.duration_s: this key is already in line 7",
        f"8:5: segments.4: a segment needs exactly one of the keys {kinds}",
        f"9:5: segments.5: a segment needs exactly one of the keys {kinds}",
        "10:1: dither.frequency_hz: is missing",
    ]


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300) | st.text(alphabet="ab:-[]{}#&*!|>'\"%@`,? \n\t1.e", max_size=120).map(str.encode))
def test_any_bytes_give_a_document_or_error_lines(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(content)
    errors = [f"{path}:1:1: none"]
    try:
        load_config(path)
    except ConfigError as error:
        errors = error.errors
    assert errors
    assert all(LINE.fullmatch(line) for line in errors)


def test_a_flood_of_errors_is_cut_with_a_note(file: Path) -> None:
    errors = said(file, PORTS + "\n".join(f"key{number}: 1" for number in range(500)))
    assert "1:1: 400 more errors are not shown" in errors
    assert len(errors) == 101
