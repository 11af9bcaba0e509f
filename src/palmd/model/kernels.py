"""CasADi functions as C of palmd's own: straight lines of arithmetic, for one column or for many side by side.

Each instruction of a function becomes one line on a `lane` (`lanes.h`): a double, or a register full of them.
What a kernel gives for a column does not depend on which others stand beside it, nor on the processor. Needs CasADi, so
it is for building alone; `model.compiled` loads what is built.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from palmd.model.compiled import EXPORTED, LANES
from palmd.model.symbolic import ca

PART = 200
"""Instructions in one piece: compilers take time by the square of what they must hold in registers at once."""

ABREAST, NEAR = 2, 2000
"""Registers full of columns that go through a piece before the next one, in kernels of so many registers at most.

A kernel's code is longer than the nearest memory for it, so that else it is fetched anew for each; what is kept of more
columns, or by larger kernels, is longer than that for numbers.
"""

_HEADER = Path(__file__).with_name("lanes.h")


@dataclass(frozen=True, slots=True)
class Kernel:
    """A function of dense inputs and outputs, to be compiled as `name`.

    Of columns: every input but the `shared` ones, and every output, holds one column after the other.
    """

    name: str
    function: ca.Function
    columns: bool = False
    shared: tuple[int, ...] = ()

    @property
    def on_the_vm(self) -> ca.Function:
        """The same on CasADi's virtual machine; of columns for `LANES` of them."""
        if not self.columns:
            return self.function
        return self.function.map(self.name, "serial", LANES, list(self.shared), [])


def densified(function: ca.Function) -> ca.Function:
    """The same function with dense inputs and outputs, so that plain arrays can hold them; shared terms once."""
    inputs = [ca.SX.sym(function.name_in(i), *function.size_in(i)) for i in range(function.n_in())]
    outputs = ca.cse([ca.densify(out) for out in function.call(inputs)])
    return ca.Function(function.name(), inputs, outputs, function.name_in(), function.name_out())


def single(function: ca.Function) -> Kernel:
    """The function as a kernel of one column."""
    return Kernel(function.name(), densified(function))


def of_columns(function: ca.Function, name: str, shared: Iterable[str]) -> Kernel:
    """The function as a kernel `name` of columns, which have the inputs called `shared` in common."""
    return Kernel(name, densified(function), True, tuple(function.index_in(each) for each in shared))


def source(kernels: Sequence[Kernel], *, columns: bool) -> str:
    """C of those of the kernels that are of columns, or of those that are not; empty when there are none.

    Each becomes `void kernel_NAME(const double *const *in, double *const *out, long columns)`.
    """
    bodies = [_functions(kernel) for kernel in kernels if kernel.columns == columns]
    if not bodies:
        return ""
    return f"#define LANES {LANES if columns else 1}\n" + _HEADER.read_text(encoding="utf-8") + "\n".join(bodies)


@cache
def _operations() -> dict[int, str]:
    """C of each of CasADi's operations, as far as palmd's models need them."""
    return {
        ca.OP_ASSIGN: "{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}",
        ca.OP_DIV: "{0} / {1}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {0}",
        ca.OP_INV: "1.0 / {0}", ca.OP_SQRT: "root({0})", ca.OP_EXP: "exp_({0})", ca.OP_LOG: "log_({0})",
        ca.OP_FABS: "abs_({0})", ca.OP_FLOOR: "floor_({0})", ca.OP_FMIN: "min_({0}, {1})", ca.OP_FMAX: "max_({0}, {1})",
        ca.OP_LT: "truth(TEST({0} < {1}))", ca.OP_LE: "truth(TEST({0} <= {1}))",
        ca.OP_EQ: "truth(TEST({0} == {1}))", ca.OP_NE: "truth(TEST({0} != {1}))",
        ca.OP_SIGN: "truth(TEST({0} > 0.0)) - truth(TEST({0} < 0.0))",
        ca.OP_NOT: "not_({0})", ca.OP_AND: "and_({0}, {1})", ca.OP_OR: "or_({0}, {1})",
        ca.OP_IF_ELSE_ZERO: "if_else_zero({0}, {1})", ca.OP_TAN: "EACH(tan, {0})", ca.OP_ATAN: "EACH(atan, {0})",
        ca.OP_ATAN2: "EACH2(atan2, {0}, {1})", ca.OP_POW: "EACH2(pow, {0}, {1})",
        ca.OP_CONSTPOW: "EACH2(pow, {0}, {1})", ca.OP_TANH: "EACH(tanh, {0})",
        ca.OP_LOG1P: "EACH(log1p, {0})",
    }  # fmt: skip


def _functions(kernel: Kernel) -> str:
    """C of one kernel: pieces that compilers can take, and what calls them one after the other."""
    f, parts = kernel.function, _parts(kernel.function)
    names = [f"part_{kernel.name}_{number}" for number in range(len(parts))]
    head = "const double *const *in, double *const *out, long at, lane *w"
    pieces = [
        f"static __attribute__((noinline)) void {name}({head}) {{\n  (void)in, (void)out, (void)at, (void)w;\n  "
        + "\n  ".join(_lines(kernel, part))
        + "\n}\n"
        for name, part in zip(names, parts, strict=True)
    ]
    size = max(f.sz_w(), 1)
    abreast, call = 1, "{}(in, out, at, w);"
    if kernel.columns and size <= NEAR:
        abreast, loop = ABREAST, f"for (long i = 0; i < {ABREAST} && at + i * WIDE < columns; i++)"
        call = f"{loop} {{}}(in, out, at + i * WIDE, w + i * {size});"
    step = "WIDE" if abreast == 1 else f"{abreast} * WIDE"
    calls = "\n    ".join(map(call.format, names))
    return "".join(pieces) + (
        f"void {EXPORTED}{kernel.name}(const double *const *in, double *const *out, long columns) {{\n"
        f"  lane w[{abreast * size}];\n"
        f"  for (long at = 0; at < columns; at += {step}) {{\n    {calls}\n  }}\n}}\n"
    )


@dataclass(frozen=True, slots=True)
class _CodePart:
    """Some instructions: `kept` are those whose value a later part needs, in its register of the work array."""

    instructions: range
    kept: frozenset[int]


def _parts(f: ca.Function) -> list[_CodePart]:
    n = f.n_instructions()
    written: dict[int, int] = {}  # by which instruction each register was
    kept: set[int] = set()
    for k in range(n):
        operation = f.instruction_id(k)
        if operation not in (ca.OP_INPUT, ca.OP_CONST):
            kept.update(written[i] for i in f.instruction_input(k) if written[i] // PART != k // PART)
        if operation != ca.OP_OUTPUT:
            written[f.instruction_output(k)[0]] = k
    ranges = [range(first, min(first + PART, n)) for first in range(0, n, PART)]
    return [_CodePart(each, frozenset(k for k in each if k in kept)) for each in ranges]


def _lines(kernel: Kernel, part: _CodePart) -> list[str]:
    f = kernel.function
    lines: list[str] = []
    held: dict[int, str] = {}  # by the virtual machine's registers: the names of their values in this part
    waves: dict[str, str] = {}  # of which angles sine and cosine are known

    def value_of(register: int) -> str:
        if register not in held:
            held[register] = f"w{register}"
            lines.append(f"const lane w{register} = w[{register}];")
        return held[register]

    for k in part.instructions:
        operation, into, of = f.instruction_id(k), f.instruction_output(k), f.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            n = f.numel_out(into[0])
            lines.append(f"scatter(out[{into[0]}] + at * {n} + {into[1]}, {n}, {value_of(of[0])});")
            continue
        value = f"v{k}"
        if operation == ca.OP_CONST:
            lines.append(f"const lane {value} = EVERY({_number(f.instruction_constant(k))});")
        elif operation == ca.OP_INPUT:
            which, index = of
            if kernel.columns and which not in kernel.shared:
                n = f.numel_in(which)
                lines.append(f"const lane {value} = gather(in[{which}] + at * {n} + {index}, {n});")
            else:
                lines.append(f"const lane {value} = EVERY(in[{which}][{index}]);")
        elif operation in (ca.OP_SIN, ca.OP_COS):
            angle = value_of(of[0])
            if angle not in waves:
                waves[angle] = value
                lines.append(f"lane s{value}, c{value}; sin_cos({angle}, &s{value}, &c{value});")
            value = ("s" if operation == ca.OP_SIN else "c") + waves[angle]
        else:
            if operation not in _operations():
                raise NotImplementedError(f"{kernel.name}: no C for CasADi's operation {operation}")
            lines.append(f"const lane {value} = {_operations()[operation].format(*map(value_of, of))};")
        held[into[0]] = value
        if k in part.kept:
            lines.append(f"w[{into[0]}] = {value};")
    return lines


def _number(value: float) -> str:
    return f"({value!r})" if abs(value) != float("inf") else ("INFINITY" if value > 0 else "(-INFINITY)")
