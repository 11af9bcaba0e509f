"""Compiled kernels: agreement with CasADi's virtual machine, argument checks, and operation without a compiler."""

from __future__ import annotations

import json
import math
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from palmd.model import building, compiled, compiler, kernels, shape_map, smoothing
from palmd.model.compiled import LANES, Library, load
from palmd.model.kernels import of_columns, single
from tools.wheel import collect


def _function() -> ca.Function:
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 1)
    y = ca.vertcat(ca.sin(x[0]) * u, x[1] * x[2], ca.sqrt(x[2] ** 2 + 1))
    return ca.Function("f", [x, u], [y, ca.densify(ca.jacobian(y, x))], ["x", "u"], ["y", "J"])


@pytest.fixture(autouse=True)
def reset_warnings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget which warnings have been issued, as in a new process."""
    monkeypatch.setattr(compiled, "_WARNED", set())
    monkeypatch.delenv(compiler.FAULT, raising=False)


def toy(folder: Path, name: str = "toy") -> Library:
    return load(name, lambda: [single(_function()), of_columns(_function(), "f_block", ["u"])], folder)


def without_a_compiler(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(folder))


def script(path: Path, text: str) -> Path:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def evaluated(expression: ca.SX, x: ca.SX, folder: Path, values: np.ndarray) -> np.ndarray:
    """The result of the block kernel for these values; the kernel of one column must give identical results."""
    function = ca.Function("g", [x], [expression])
    library = load("one", lambda: [single(function), of_columns(function, "gs", [])], folder)
    assert library.backend == "c"
    padded = np.resize(values, (-(-len(values) // LANES) * LANES,))
    many, one, into, out = np.zeros(len(padded)), np.zeros(len(padded)), np.zeros(1), np.zeros(1)
    library.bind("gs", [padded], [many])()
    call = library.bind("g", [into], [out])
    for i, value in enumerate(padded):
        into[0] = value
        call()
        one[i] = out[0]
    assert many.tobytes() == one.tobytes()
    return many[: len(values)]


def test_compiled_code_agrees_with_the_virtual_machine(tmp_path: Path) -> None:
    library = toy(tmp_path)
    assert library.backend == "c"
    x, u, y, J = np.array([0.3, 1.7, -2.0]), np.array([0.9]), np.zeros(3), np.zeros((3, 3))
    library.bind("f", [x, u], [y, J])()
    wanted = _function()(x, u)
    assert y == pytest.approx(np.asarray(wanted[0]).ravel(), abs=1e-15)
    assert pytest.approx(np.asarray(wanted[1]), abs=1e-15) == J.T


ANGLES = np.concatenate([np.linspace(-7.0, 7.0, 4001), np.arange(1, 400) * (math.pi / 2), [0.0, 1e-300, 9.9e5, -3e5]])


@pytest.mark.parametrize(
    ("operation", "values", "ulps"),
    [
        ("sin", ANGLES, 1.5),
        ("cos", ANGLES, 1.5),
        ("exp", np.concatenate([np.linspace(-700.0, 700.0, 4001), [0.0, -0.0, 1e-20, 709.7]]), 1.5),
        ("log", np.concatenate([np.geomspace(1e-307, 1e308, 4001), np.linspace(0.5, 2.0, 2001), [5e-324]]), 1.5),
        ("atan", np.concatenate([ANGLES, np.geomspace(1e-300, 1e300, 4001), [0.4375, 0.6875, 1.1875, 2.4375]]), 1.5),
    ],
)
def test_elementary_functions_agree_with_libm_within_an_ulp(
    tmp_path: Path, operation: str, values: np.ndarray, ulps: float
) -> None:
    x = ca.SX.sym("x")
    got = evaluated(getattr(ca, operation)(x), x, tmp_path, values)
    wanted = getattr(np, {"atan": "arctan"}.get(operation, operation))(values)
    # near a zero the rounding of the angle itself dominates
    of_angle = 2.0**-54 * np.spacing(np.abs(values)) if operation in ("sin", "cos") else 0.0
    spacing = np.maximum(np.spacing(np.abs(wanted)), of_angle)
    assert (np.abs(got - wanted) / spacing).max() < ulps


def test_nan_and_infinity_propagate(tmp_path: Path) -> None:
    x = ca.SX.sym("x")
    nothing = np.array([math.nan, math.inf, -math.inf])
    for number, (expression, wanted) in enumerate(
        [
            (ca.sin(x), [math.nan] * 3),
            (ca.exp(x), [math.nan, math.inf, 0.0]),
            (ca.log(x), [math.nan, math.inf, math.nan]),
            (ca.atan(x), [math.nan, math.pi / 2, -math.pi / 2]),
            (ca.fmin(x, 1.0), [1.0, 1.0, -math.inf]),
            (ca.fmax(x, 1.0), [1.0, math.inf, 1.0]),
            (ca.if_else(x < 0, 2.0, 3.0), [3.0, 3.0, 2.0]),
        ]
    ):
        got = evaluated(expression, x, tmp_path / str(number), nothing)
        assert got == pytest.approx(np.array(wanted), nan_ok=True), expression
    assert evaluated(ca.log(x), x, tmp_path / "log", np.array([0.0, -1.0]))[0] == -math.inf
    assert np.isnan(evaluated(ca.cos(x), x, tmp_path / "far", np.array([1.1e6]))), "the argument is too large to reduce"


def test_a_function_split_into_pieces_passes_intermediate_results_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels, "PART", 3)
    n = 4 * LANES
    x, y, J = np.arange(3.0 * n).reshape(n, 3), np.zeros((n, 3)), np.zeros((n, 3, 3))
    toy(tmp_path).bind("f_block", [x, np.ones(1)], [y, J])(3 * LANES)  # full blocks and one left over
    for row, out in zip(x[: 3 * LANES], y, strict=False):
        assert out == pytest.approx(np.asarray(_function()(row, 1.0)[0]).ravel(), rel=1e-15)
    assert not y[3 * LANES :].any()
    assert not J[3 * LANES :].any()


def test_a_bound_call_keeps_its_arrays_alive_and_reads_them_at_each_call(tmp_path: Path) -> None:
    x, y = np.array([0.0, 2.0, 3.0]), np.zeros(3)
    call = toy(tmp_path).bind("f", [x, np.ones(1)], [y, np.zeros((3, 3))])
    call()
    assert y[1] == 6.0
    x[1] = 5.0
    call()
    assert y[1] == 15.0


def test_a_second_load_does_not_compile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    toy(tmp_path)
    built = sorted(tmp_path.iterdir())
    assert sorted(each.suffix for each in built) == [".json", ".so"], "no temporary files are left"
    monkeypatch.setattr(building, "build", None)
    assert toy(tmp_path).backend == "c"


def test_identical_c_source_is_not_compiled_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    toy(tmp_path)
    monkeypatch.setattr(compiled, "_sources", lambda: b"a comment more")
    monkeypatch.setattr(subprocess, "run", None)
    assert toy(tmp_path).backend == "c"
    assert len(list(tmp_path.glob("*.so"))) == 1
    assert len(list(tmp_path.glob("*.json"))) == 2


def test_compiled_models_load_without_importing_casadi() -> None:
    """Covers every model that the daemon, its smoother or its explorer runs."""
    from palmd.model import extended, rollout, sensitivity

    models = (shape_map, extended, sensitivity, smoothing, rollout)
    assert all(model.library().backend == "c" for model in models)
    names = [model.__name__.rpartition(".")[2] for model in models]
    code = f"from palmd.model import {', '.join(names)}\n{'; '.join(f'{name}.library()' for name in names)}"
    check = "import sys; sys.exit(bool({'casadi', 'scipy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", f"{code}\n{check}"]).returncode == 0


def test_without_a_compiler_the_virtual_machine_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    without_a_compiler(monkeypatch, tmp_path)
    library = toy(tmp_path)
    assert library.backend == "vm"
    assert "install gcc" in caplog.text
    y = np.zeros(3)
    library.bind("f", [np.array([0.3, 1.7, -2.0]), np.array([0.9])], [y, np.zeros((3, 3))])()
    assert y[1] == pytest.approx(-3.4)
    x, y = np.arange(48.0).reshape(16, 3), np.zeros((16, 3))
    call = library.bind("f_block", [x, np.ones(1)], [y, np.zeros((16, 3, 3))])
    call(8)
    assert y[7, 1] == pytest.approx(22.0 * 23.0)
    assert not y[8:].any(), "only 8 columns were requested"
    call()
    assert y[15, 1] == pytest.approx(46.0 * 47.0)


def test_without_a_compiler_handwritten_c_is_refused_with_a_hint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    without_a_compiler(monkeypatch, tmp_path)
    by_hand = tmp_path / "by_hand.c"
    by_hand.write_text("int one(void) { return 1; }")
    with pytest.raises(compiled.NotCompiledError, match=r"toy cannot be compiled.*install gcc"):
        load("toy", lambda: [single(_function())], tmp_path / "cache", [str(by_hand)])
    assert not caplog.text
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    assert compiled.load_written("by_hand", by_hand) is None
    assert "by_hand runs slower, in Python: no C compiler" in caplog.text


@pytest.fixture
def wheel_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a wheel that contains the toy library, on a machine whose own cache is empty."""
    toy(tmp_path / "made")
    collect(
        (tmp_path / "made").glob("*.json"), ["SSE2"] if platform.machine() == "x86_64" else [], tmp_path / "kernels"
    )
    monkeypatch.setattr(compiled, "SHIPPED", tmp_path / "kernels")
    return tmp_path / "kernels"


def test_without_a_compiler_the_wheels_library_is_used(
    wheel_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    without_a_compiler(monkeypatch, tmp_path)
    monkeypatch.setattr(building, "on_the_vm", None)
    library = toy(tmp_path / "cache")
    assert library.backend == "c"
    assert library.path is not None
    assert library.path.parent == wheel_folder
    assert not (tmp_path / "cache").exists()
    assert not caplog.text


@pytest.mark.parametrize("why", ["other sources", "another processor", "damaged"])
def test_a_wheels_library_that_does_not_match_is_not_used(
    wheel_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    without_a_compiler(monkeypatch, tmp_path)
    if why == "other sources":
        monkeypatch.setattr(compiled, "_sources", lambda: b"another version")
    elif why == "another processor":
        (wheel_folder / compiled.NEEDS).write_text("SSE2 AVX9000")
    else:
        (victim,) = wheel_folder.glob("*.so")
        victim.write_bytes(victim.read_bytes()[:100])
    assert toy(tmp_path / "cache").backend == "vm"


def test_a_library_compiled_for_this_processor_is_preferred_to_the_wheels(
    wheel_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = toy(tmp_path / "cache")
    assert library.path is not None
    assert library.path.parent == tmp_path / "cache"
    monkeypatch.setenv("CC", str(script(tmp_path / "broken", "exit 1")))
    library = toy(tmp_path / "other")
    assert library.path is not None, "the compiler fails"
    assert library.path.parent == wheel_folder


@pytest.mark.skipif(platform.machine() != "x86_64", reason="names a processor of another kind")
def test_the_processor_named_in_cc_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = tmp_path / "calls"
    recording_compiler = script(tmp_path / "cc", f'echo "$*" >> {calls}; exec cc "$@"')
    monkeypatch.setenv("CC", f"{recording_compiler} -march=x86-64-v2")
    assert toy(tmp_path / "cache").path is not None
    compiling = [line for line in calls.read_text().splitlines() if " -c " in line]
    assert compiling
    assert all("-march=x86-64-v2" in line and "native" not in line for line in compiling)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('echo "disk full" >&2; exit 1', "disk full"),
        ("exit 1", "ended with status 1: no output"),
        ("exit 0", "wrote no library"),
        ("sleep 600 & sleep 600", "has not ended"),
    ],
)
def test_a_compiler_that_fails_or_hangs_is_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, text: str, why: str
) -> None:
    monkeypatch.setattr(compiler, "TRIAL_S", 1.0)
    monkeypatch.setenv("CC", str(script(tmp_path / "cc", text)))
    for _ in range(2):
        assert toy(tmp_path / "cache").backend == "vm"
    assert caplog.text.count(why) == 1


@pytest.fixture
def mounted(tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """Return a function that mounts a file system with these options; skip without permission to mount."""
    folders = []

    def mount(options: str) -> Path:
        folder = tmp_path / "mounted"
        folder.mkdir()
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], capture_output=True)
        if done.returncode:
            pytest.skip("no permission to mount a file system")
        folders.append(folder)
        return folder

    yield mount
    for folder in folders:
        subprocess.run(["umount", "-l", folder], check=True)


@pytest.mark.parametrize(("options", "why"), [("noexec", "cannot be loaded"), ("size=1m", "No space left")])
def test_a_cache_on_a_noexec_or_full_file_system_is_detected_before_compiling(
    mounted: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture, options: str, why: str,
) -> None:  # fmt: skip
    started = tmp_path / "started"
    monkeypatch.setenv("CC", str(script(tmp_path / "cc", f'echo "$*" >> {started}; exec cc "$@"')))
    cache = mounted(options) / "palmd"
    for name in ("one", "other"):
        assert toy(cache, name).backend == "vm"
    assert caplog.text.count(why) == 1
    assert "XDG_CACHE_HOME" in caplog.text
    if started.exists():
        assert " -c " not in started.read_text(), "only the trial is compiled"
    assert not list(cache.iterdir())


def test_a_library_that_can_no_longer_be_loaded_is_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """For example after the file system was remounted with noexec."""
    assert {toy(tmp_path, name).backend for name in ("one", "other")} == {"c"}

    def refused(path: str) -> None:
        raise OSError(f"{path}: failed to map segment from shared object")

    monkeypatch.setattr("ctypes.CDLL", refused)
    building._check_compiler.cache_clear()
    assert {toy(tmp_path, name).backend for name in ("one", "other")} == {"vm"}
    assert len(caplog.records) == 1
    assert "noexec" in caplog.text


def test_a_failed_compilation_is_not_repeated_at_each_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The compiler works on a short test program and fails on a library."""
    started, cache = tmp_path / "started", tmp_path / "palmd"
    text = (
        f'case "$*" in *" -c "*) echo >> {started}; echo "cc1: error: out of memory" >&2; exit 4;; esac; exec cc "$@"'
    )
    monkeypatch.setenv("CC", str(script(tmp_path / "cc", text)))
    monkeypatch.setenv("CACHE_DIRECTORY", str(cache))
    assert toy(cache).backend == "vm"
    tries = started.read_text()
    assert toy(cache).backend == "vm"
    assert started.read_text() == tries
    assert caplog.text.count("out of memory") == 2
    assert "`palmd doctor build` tries again" in caplog.text
    compiled.forget_failures()
    monkeypatch.setenv("CC", str(script(tmp_path / "cc", 'exec cc "$@"')))
    assert toy(cache).backend == "c"


def test_a_compiler_may_have_a_wrapper_and_flags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrapper = script(tmp_path / "my ccache", 'exec "$@"')
    monkeypatch.setenv("CC", f"'{wrapper}' cc -pipe")
    assert toy(tmp_path / "cache").backend == "c"


def test_unclosed_quotes_in_cc_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("CC", "gcc 'x")
    assert toy(tmp_path / "cache").backend == "vm"
    assert "no closing quotation" in caplog.text


def test_a_missing_compiler_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("CC", str(tmp_path / "nowhere"))
    assert toy(tmp_path / "cache").backend == "vm"
    assert "nowhere: No such file" in caplog.text


def test_a_library_with_a_wrong_hash_is_rebuilt(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    toy(tmp_path)
    (victim,) = tmp_path.glob("*.so")
    sound = victim.read_bytes()
    victim.unlink()  # do not overwrite it: this process has loaded it
    victim.write_bytes(sound[: len(sound) // 2])
    assert toy(tmp_path).backend == "c"
    assert "wrong hash" in caplog.text
    (note,) = tmp_path.glob("*.json")
    note.write_text(json.dumps({"sha256": 3}))
    assert toy(tmp_path).backend == "c"


def test_wrong_results_of_a_compiler_are_detected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    right = kernels._operations()
    monkeypatch.setattr(kernels, "_operations", lambda: right | {ca.OP_MUL: "{0} + {1}"})
    with pytest.raises(RuntimeError, match="compiled f differs from CasADi's virtual machine in output y"):
        toy(tmp_path)
    assert not list(tmp_path.glob("*.so"))


def test_an_unsupported_casadi_operation_raises(tmp_path: Path) -> None:
    x = ca.SX.sym("x")
    with pytest.raises(NotImplementedError, match="no C for CasADi's operation"):
        load("odd", lambda: [single(ca.Function("f", [x], [ca.erf(x)]))], tmp_path)


SHARED = np.zeros(3)


@pytest.mark.parametrize(
    ("name", "inputs", "outputs", "complaint"),
    [
        ("f", [np.zeros(2), np.zeros(1)], [np.zeros(3), np.zeros((3, 3))], "input x: needs 3"),
        ("f", [np.zeros(3, dtype=np.float32), np.zeros(1)], [np.zeros(3), np.zeros((3, 3))], "float32"),
        ("f", [np.zeros(6)[::2], np.zeros(1)], [np.zeros(3), np.zeros((3, 3))], "contiguous"),
        ("f", [np.zeros(3), np.zeros(1)], [np.zeros(3)], "takes 2 inputs and 2 outputs"),
        ("f", [SHARED, np.zeros(1)], [SHARED, np.zeros((3, 3))], "shares memory"),
        ("f_block", [np.zeros((5, 3)), np.zeros(1)], [np.zeros((5, 3)), np.zeros((5, 3, 3))], "multiple of 8 columns"),
    ],
)
def test_arrays_of_the_wrong_shape_are_refused(
    tmp_path: Path, name: str, inputs: list[np.ndarray], outputs: list[np.ndarray], complaint: str
) -> None:
    library = toy(tmp_path)
    with pytest.raises(ValueError, match=complaint):
        library.bind(name, inputs, outputs)


@pytest.mark.parametrize("name", ["predict", "update_s1"])
def test_a_single_filter_gives_identical_results_to_one_in_a_bank(name: str) -> None:
    library, random = shape_map.library(), np.random.default_rng(1)
    signature = library.signatures[name]
    columns = [random.uniform(0.02, 0.09, (LANES, size)) for _, size in signature.inputs[:-1]]
    last = random.uniform(0.02, 0.09, signature.inputs[-1][1])
    many = [np.zeros((LANES, size)) for _, size in signature.outputs]
    library.bind(f"{name}_block", [*columns, last], many)()
    for i in (0, 5):
        one = [np.zeros(size) for _, size in signature.outputs]
        library.bind(name, [*(each[i].copy() for each in columns), last], one)()
        assert all(a.tobytes() == b[i].tobytes() for a, b in zip(one, many, strict=True))
