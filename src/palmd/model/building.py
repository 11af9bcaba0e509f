"""Compile kernels into the cache and check them against CasADi's virtual machine, or run them on it. Needs CasADi."""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import (
    EXPORTED,
    FAILED,
    FLAGS,
    GENERATED,
    LANES,
    NATIVE,
    WRITTEN,
    Library,
    Run,
    Signature,
    cache_directory,
    key_of,
    note_of,
)
from palmd.model.compiler import COMPILE_S, CompilerError, check_compiler, command, remember_fault, run
from palmd.model.kernels import Kernel, source
from palmd.model.symbolic import ca

INPUT_SCALES = 1.0, 0.1, 0.01  # of the random inputs
LARGEST_OUTPUT = 1e5  # a larger output means that an intermediate angle may exceed the kernels' range and give NaN
TOLERANCE = 1e-9  # relative error, beyond the effect of rounding the inputs
INPUT_ROUNDING, ROUNDING_FACTOR = 4e-16, 100.0  # relative change of the inputs; how much of its effect is allowed


def build(name: str, kernels: Sequence[Kernel], written: Sequence[Path], note: Path, sources: bytes) -> bool:
    """Generate, compile and check the library `name`; write it and its `note` into the note's folder.

    `written`: handwritten C files. `sources`: hash input of all sources, for the note. A library that was already
    compiled from the same C is kept.

    Returns False when there is no compiler. Raises OSError or CompilerError when compiling fails, RuntimeError when the
    compiled code disagrees with CasADi's virtual machine.
    """
    compiler = command()
    if not compiler:
        return False
    try:
        note.parent.mkdir(parents=True, exist_ok=True)
        _check_compiler(tuple(compiler), note.parent)
    except (OSError, CompilerError):
        remember_fault(note.parent)
        raise
    with tempfile.TemporaryDirectory(dir=note.parent) as folder:
        files: dict[Path, Sequence[str]] = dict.fromkeys(written, WRITTEN)
        for columns in (False, True):
            text = source(kernels, columns=columns)
            if text:
                generated = Path(folder) / f"{'columns' if columns else 'single'}.c"
                generated.write_text(text, encoding="utf-8")
                files[generated] = GENERATED
        library = note.with_name(f"{name}-{key_of(b''.join(each.read_bytes() for each in files))}.so")
        if not (library.exists() and _passes_check(library, kernels)):
            try:
                _compile(compiler, files, kernels, library, Path(folder))
            except CompilerError as error:
                note.with_suffix(FAILED).write_text(str(error), encoding="utf-8")
                raise
        draft = Path(folder) / "note.json"
        draft.write_text(note_of(_signatures(kernels), library, sources), encoding="utf-8")
        draft.replace(note)
    return True


@cache
def _check_compiler(compiler: tuple[str, ...], folder: Path) -> None:
    check_compiler(compiler, folder)


def _compile(
    compiler: Sequence[str], files: Mapping[Path, Sequence[str]], kernels: Sequence[Kernel], library: Path, folder: Path
) -> None:
    """Compile each file with its own flags, link and check them, then move the result to `library`."""
    built = folder / "built.so"
    processor = () if any(word.startswith("-march=") for word in compiler) else (NATIVE,)
    base_command = [*compiler, *processor, *FLAGS, "-I", str(Path(__file__).parent)]
    objects = [str(folder / f"{each.stem}.o") for each in files]

    def run_compiler(*arguments: str) -> None:
        run([*base_command, *arguments], COMPILE_S)

    with ThreadPoolExecutor() as pool:  # two files of about the same length take most of the time
        list(pool.map(lambda each, made: run_compiler(*files[each], "-c", str(each), "-o", made), files, objects))
    run_compiler("-o", str(built), *objects, "-lm")
    _check_library(built, kernels)  # before it becomes visible to other processes
    built.replace(library)


def _passes_check(library: Path, kernels: Sequence[Kernel]) -> bool:
    try:
        _check_library(library, kernels)
    except (OSError, AttributeError, RuntimeError):
        return False
    return True


def _check_library(library: Path, kernels: Sequence[Kernel]) -> None:
    compiled = ctypes.CDLL(str(library))
    for kernel in kernels:
        check(kernel, compiled)


def check(kernel: Kernel, compiled: ctypes.CDLL) -> None:
    """Raise RuntimeError when the compiled code and the virtual machine disagree on random inputs."""
    random, vm = np.random.default_rng(0), kernel.on_the_vm
    for scale in INPUT_SCALES:
        inputs = [scale * random.uniform(0.2, 0.9, vm.numel_in(i)) for i in range(vm.n_in())]
        rounded = [each * (1.0 + INPUT_ROUNDING * random.choice([-1.0, 1.0], each.shape)) for each in inputs]
        outputs = [np.zeros(vm.numel_out(i)) for i in range(vm.n_out())]
        into, out = ((ctypes.c_void_p * len(each))(*(a.ctypes.data for a in each)) for each in (inputs, outputs))
        compiled[EXPORTED + kernel.name](into, out, ctypes.c_long(LANES if kernel.columns else 1))
        expected = _flat(vm, inputs)
        moderate = all(np.nanmax(np.abs(each), initial=0.0) < LARGEST_OUTPUT for each in expected)
        for index, (got, wanted, near) in enumerate(zip(outputs, expected, _flat(vm, rounded), strict=True)):
            with np.errstate(invalid="ignore", over="ignore"):
                allowed = TOLERANCE * (1.0 + np.abs(wanted)) + ROUNDING_FACTOR * np.nanmax(
                    np.abs(near - wanted), initial=0.0
                )
                wrong = np.isfinite(wanted) & ~(np.abs(got - wanted) <= allowed) & (np.isfinite(got) | moderate)
            if wrong.any():
                raise RuntimeError(
                    f"compiled {kernel.name} differs from CasADi's virtual machine in output {vm.name_out(index)} by "
                    f"{np.abs(got - wanted)[wrong].max():.3g}; delete the cache {cache_directory()} and retry"
                )


def _flat(vm: ca.Function, inputs: Sequence[FloatArray]) -> list[FloatArray]:
    arguments = [each.reshape(vm.size_in(i), order="F") for i, each in enumerate(inputs)]
    return [np.asarray(each).ravel(order="F") for each in vm.call(arguments)]


def _signatures(kernels: Sequence[Kernel]) -> dict[str, Signature]:
    def signature_of(kernel: Kernel) -> Signature:
        f = kernel.function
        return Signature(
            tuple((f.name_in(i), f.numel_in(i)) for i in range(f.n_in())),
            tuple((f.name_out(i), f.numel_out(i)) for i in range(f.n_out())),
            kernel.columns,
            kernel.shared,
        )

    return {kernel.name: signature_of(kernel) for kernel in kernels}


def on_the_vm(kernels: Sequence[Kernel]) -> Library:
    """Return the kernels as a `Library` that runs on CasADi's virtual machine."""
    by_name = {kernel.name: kernel for kernel in kernels}

    def runner(name: str, inputs: Sequence[FloatArray], outputs: Sequence[FloatArray]) -> Run:
        kernel, vm = by_name[name], by_name[name].on_the_vm
        if not kernel.columns:
            run = _buffered(vm, inputs, outputs)
            return lambda _columns: run()
        per_column = [i for i in range(len(inputs)) if i not in kernel.shared]
        columns = inputs[per_column[0]].size // kernel.function.numel_in(per_column[0])

        def part(array: FloatArray, at: int) -> FloatArray:
            size = array.size // columns
            return array.reshape(-1)[at * size : (at + LANES) * size]

        calls = [
            _buffered(
                vm,
                [part(each, at) if i in per_column else each for i, each in enumerate(inputs)],
                [part(each, at) for each in outputs],
            )
            for at in range(0, columns, LANES)
        ]

        def run_columns(wanted: int) -> None:
            for call in calls[: wanted // LANES]:
                call()

        return run_columns

    return Library(_signatures(kernels), "vm", runner)


def _buffered(vm: ca.Function, inputs: Sequence[FloatArray], outputs: Sequence[FloatArray]) -> Callable[[], None]:
    buffer, trigger = vm.buffer()
    for i, array in enumerate(inputs):
        buffer.set_arg(i, array.data)  # type: ignore[call-arg]  # the stub lacks the default argument
    for i, array in enumerate(outputs):
        buffer.set_res(i, array.data)  # type: ignore[call-arg]

    def run(_held: object = (buffer, inputs, outputs)) -> None:
        trigger()

    return run
