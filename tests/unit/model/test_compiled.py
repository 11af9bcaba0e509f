"""Compiled functions: same numbers as the virtual machine, refused arrays, and life without a compiler."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from palmd.model import compiled
from palmd.model.compiled import BLOCK, densified, load, mapped_over_block


def _function() -> ca.Function:
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 1)
    y = ca.vertcat(ca.sin(x[0]) * u, x[1] * x[2], ca.sqrt(x[2] ** 2 + 1))
    return ca.Function("f", [x, u], [y, ca.densify(ca.jacobian(y, x))], ["x", "u"], ["y", "J"])


def test_compiled_code_gives_the_virtual_machines_numbers(tmp_path: Path) -> None:
    function = _function()
    library = load("toy", [function], tmp_path)
    assert library.backend == "c"
    x, u, y, J = np.array([0.3, 1.7, -2.0]), np.array([0.9]), np.zeros(3), np.zeros((3, 3))
    library.bind("f", [x, u], [y, J])()
    wanted = function(x, u)
    assert y == pytest.approx(np.asarray(wanted[0]).ravel(), abs=1e-15)
    assert pytest.approx(np.asarray(wanted[1]), abs=1e-15) == J.T


def test_a_bound_call_keeps_its_arrays_alive_and_reads_them_anew_each_time(tmp_path: Path) -> None:
    library = load("toy", [_function()], tmp_path)
    x, y = np.array([0.0, 2.0, 3.0]), np.zeros(3)
    call = library.bind("f", [x, np.ones(1)], [y, np.zeros((3, 3))])
    call()
    assert y[1] == 6.0
    x[1] = 5.0
    call()
    assert y[1] == 15.0


def test_the_second_load_compiles_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load("toy", [_function()], tmp_path)
    built = list(tmp_path.glob("*.so"))
    stamp = built[0].stat().st_mtime_ns
    load("toy", [_function()], tmp_path)
    assert list(tmp_path.glob("*.so")) == built
    assert built[0].stat().st_mtime_ns == stamp
    assert list(tmp_path.iterdir()) == built, "nothing else is left behind"


def test_without_a_compiler_the_virtual_machine_serves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    library = load("toy", [_function()], tmp_path)
    assert library.backend == "vm"
    assert "install gcc" in caplog.text
    y = np.zeros(3)
    library.bind("f", [np.array([0.3, 1.7, -2.0]), np.array([0.9])], [y, np.zeros((3, 3))])()
    assert y[1] == pytest.approx(-3.4)


def test_a_compiler_that_fails_is_reported_and_survived(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    broken = tmp_path / "cc"
    broken.write_text('#!/bin/sh\n[ "$1" = --version ] && exit 0\necho "disk full" >&2\nexit 1\n')
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    assert load("toy", [_function()], tmp_path / "cache").backend == "vm"
    assert "disk full" in caplog.text


def test_wrong_code_in_the_cache_is_refused(tmp_path: Path) -> None:
    """A library that computes something else must never be used, whatever its name says."""
    load("toy", [_function()], tmp_path)
    (victim,) = tmp_path.glob("*.so")
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 1)
    other = ca.Function("f", [x, u], [2 * x, ca.densify(ca.SX.eye(3))], ["x", "u"], ["y", "J"])
    load("other", [other], tmp_path / "elsewhere")
    (imposter,) = (tmp_path / "elsewhere").glob("*.so")
    victim.write_bytes(imposter.read_bytes())
    with pytest.raises(RuntimeError, match="differs from CasADi's virtual machine"):
        compiled._check_against_vm(ca.external("f", str(imposter)), _function())


@pytest.mark.parametrize(
    ("inputs", "outputs", "complaint"),
    [
        ([np.zeros(2), np.zeros(1)], [np.zeros(3), np.zeros((3, 3))], "input x: needs 3"),
        ([np.zeros(3, dtype=np.float32), np.zeros(1)], [np.zeros(3), np.zeros((3, 3))], "float32"),
        ([np.zeros(6)[::2], np.zeros(1)], [np.zeros(3), np.zeros((3, 3))], "contiguous"),
        ([np.zeros(3), np.zeros(1)], [np.zeros(3)], "takes 2 inputs and 2 outputs"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(
    tmp_path: Path, inputs: list[np.ndarray], outputs: list[np.ndarray], complaint: str
) -> None:
    library = load("toy", [_function()], tmp_path)
    with pytest.raises(ValueError, match=complaint):
        library.bind("f", inputs, outputs)


def test_an_output_may_not_be_written_over_an_input(tmp_path: Path) -> None:
    library = load("toy", [_function()], tmp_path)
    shared = np.zeros(3)
    with pytest.raises(ValueError, match="shares memory"):
        library.bind("f", [shared, np.zeros(1)], [shared, np.zeros((3, 3))])


def test_a_mapped_function_treats_each_filter_by_itself(tmp_path: Path) -> None:
    library = load("toy", [mapped_over_block(densified(_function()))], tmp_path)
    x = np.arange(3.0 * BLOCK).reshape(BLOCK, 3)
    y = np.zeros((BLOCK, 3))
    library.bind("f_block", [x, np.array([0.5])], [y, np.zeros((BLOCK, 3, 3))])()
    for row, out in zip(x, y, strict=True):
        assert out == pytest.approx(np.asarray(_function()(row, [0.5])[0]).ravel())
