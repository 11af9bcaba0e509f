"""Generate C from CasADi functions: straight-line arithmetic for one column, or for many columns side by side (SIMD).

Each instruction of a function becomes one line on a `lane` (`lanes.h`): a double, or a vector register of them.
The result for a column depends neither on the columns beside it nor on the processor. Needs CasADi, so it is used for
building only; `model.compiled` loads the built libraries.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from palmd.model.compiled import EXPORTED, LANES
from palmd.model.symbolic import ca

PART = 200
"""Instructions per C function: compile time grows with the square of a function's live values."""

ABREAST, MOST_REGISTERS_ABREAST = 2, 2000
"""Vector registers of columns that run through one piece before the next, in kernels with at most that many registers.

A kernel's code exceeds the L1 instruction cache and would be fetched again for each vector register. With more columns
abreast, or in larger kernels, the work array exceeds the L1 data cache.
"""

_HEADER = Path(__file__).with_name("lanes.h")


@dataclass(frozen=True, slots=True)
class Kernel:
    """A function of dense inputs and outputs, to be compiled as `name`.

    columns: True if every input except the `shared` ones, and every output, holds one column after the other.
    """

    name: str
    function: ca.Function
    columns: bool = False
    shared: tuple[int, ...] = ()

    @property
    def on_the_vm(self) -> ca.Function:
        """The same function on CasADi's virtual machine; for a column kernel it takes `LANES` columns."""
        if not self.columns:
            return self.function
        return self.function.map(self.name, "serial", LANES, list(self.shared), [])


def densified(function: ca.Function) -> ca.Function:
    """Return the function with dense inputs and outputs, for plain arrays, and common subexpressions eliminated."""
    inputs = _inputs(function)
    outputs = ca.cse([ca.densify(out) for out in function.call(inputs)])
    return ca.Function(function.name(), inputs, outputs, function.name_in(), function.name_out())


def first_output(function: ca.Function, name: str) -> ca.Function:
    """Return the function `name` of the same inputs with the first output only."""
    inputs = _inputs(function)
    return ca.Function(name, inputs, [function(*inputs)[0]], function.name_in(), [function.name_out(0)])


def _inputs(function: ca.Function) -> list[ca.SX]:
    return [ca.SX.sym(function.name_in(i), *function.size_in(i)) for i in range(function.n_in())]


def single(function: ca.Function) -> Kernel:
    """Return the function as a kernel of one column."""
    return Kernel(function.name(), densified(function))


def of_columns(function: ca.Function, name: str, shared: Iterable[str]) -> Kernel:
    """Return the function as a column kernel `name`; all columns share the inputs named in `shared`."""
    return Kernel(name, densified(function), True, tuple(function.index_in(each) for each in shared))


def source(kernels: Sequence[Kernel], *, columns: bool) -> str:
    """Return the C of the column kernels, or of the others if not `columns`; empty if there are none.

    Each becomes `void kernel_NAME(const double *const *in, double *const *out, long columns)`.
    """
    bodies = [_functions(kernel) for kernel in kernels if kernel.columns == columns]
    if not bodies:
        return ""
    return f"#define LANES {LANES if columns else 1}\n" + _HEADER.read_text(encoding="utf-8") + "\n".join(bodies)


@cache
def _operations() -> dict[int, str]:
    """Return the C expression of each CasADi operation that palmd's models use."""
    return {
        ca.OP_ASSIGN: "{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}",
        ca.OP_DIV: "{0} / {1}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {0}",
        ca.OP_INV: "1.0 / {0}", ca.OP_SQRT: "root({0})", ca.OP_EXP: "exp_({0})", ca.OP_LOG: "log_({0})",
        ca.OP_FABS: "abs_({0})", ca.OP_FLOOR: "floor_({0})", ca.OP_FMIN: "min_({0}, {1})", ca.OP_FMAX: "max_({0}, {1})",
        ca.OP_LT: "truth(TEST({0} < {1}))", ca.OP_LE: "truth(TEST({0} <= {1}))",
        ca.OP_EQ: "truth(TEST({0} == {1}))", ca.OP_NE: "truth(TEST({0} != {1}))",
        ca.OP_SIGN: "truth(TEST({0} > 0.0)) - truth(TEST({0} < 0.0))",
        ca.OP_NOT: "not_({0})", ca.OP_AND: "and_({0}, {1})", ca.OP_OR: "or_({0}, {1})",
        ca.OP_IF_ELSE_ZERO: "if_else_zero({0}, {1})", ca.OP_TAN: "EACH(tan, {0})", ca.OP_ATAN: "atan_({0})",
        ca.OP_ATAN2: "EACH2(atan2, {0}, {1})", ca.OP_POW: "EACH2(pow, {0}, {1})",
        ca.OP_CONSTPOW: "EACH2(pow, {0}, {1})", ca.OP_TANH: "EACH(tanh, {0})",
        ca.OP_LOG1P: "EACH(log1p, {0})",
    }  # fmt: skip


def _functions(kernel: Kernel) -> str:
    """Return the C of one kernel: pieces of at most `PART` instructions, and the function that calls them in order."""
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
    if kernel.columns and size <= MOST_REGISTERS_ABREAST:
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
    """A range of instructions; `kept`: those whose value a later part reads from the work array."""

    instructions: range
    kept: frozenset[int]


def _parts(f: ca.Function) -> list[_CodePart]:
    n = f.n_instructions()
    written: dict[int, int] = {}  # register → instruction that wrote it last
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
    variables: dict[int, str] = {}  # virtual machine's register → C variable in this part
    sines: dict[str, str] = {}  # angle → suffix of the variables with its sine and cosine

    def value_of(register: int) -> str:
        if register not in variables:
            variables[register] = f"w{register}"
            lines.append(f"const lane w{register} = w[{register}];")
        return variables[register]

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
            if angle not in sines:
                sines[angle] = value
                lines.append(f"lane s{value}, c{value}; sin_cos({angle}, &s{value}, &c{value});")
            value = ("s" if operation == ca.OP_SIN else "c") + sines[angle]
        else:
            if operation not in _operations():
                raise NotImplementedError(f"{kernel.name}: no C for CasADi's operation {operation}")
            lines.append(f"const lane {value} = {_operations()[operation].format(*map(value_of, of))};")
        variables[into[0]] = value
        if k in part.kept:
            lines.append(f"w[{into[0]}] = {value};")
    return lines


def _number(value: float) -> str:
    return f"({value!r})" if abs(value) != float("inf") else ("INFINITY" if value > 0 else "(-INFINITY)")
