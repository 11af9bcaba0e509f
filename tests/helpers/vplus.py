"""The subset of V+ that palmd's controller program uses, translated to Python, to find errors and to run it.

A file is translated program by program. As on a controller, reals have single precision, arguments are passed by
reference, and reading an unset variable is an error. Two operators whose precedence in V+ may be unexpected must be
separated by parentheses. Robot, line and task functions are handled by `rim`.
"""

import re
import struct

NAME_MAX = 15
LINE_MAX = 80
RIM = {
    "ALTER", "ALTOFF", "ALTON", "ATTACH", "BRAKE", "CLEAR.EVENT", "CPON", "DECOMPOSE", "DETACH", "DURATION", "EXECUTE",
    "FSET", "HALT", "HERE", "MOVES", "REACTE", "SELECT", "SET", "SET.EVENT", "SPEED", "TYPE", "WAIT", "WAIT.EVENT",
    "WRITE",
}  # fmt: skip
FUNCTIONS = {"ABS": abs, "INT": int, "SQRT": lambda x: x**0.5, "$CHR": lambda x: chr(int(x))}
HARDWARE = {"ERROR", "GETC", "IOSTAT", "STATE", "SWITCH", "TASK", "$ERROR"}
_WORDS = """
above abs accel align alter any appro asc atan2 attach auto base below brake break call calls case clear close
coarse cos decompose defined delay depart dest detach device distance do drive duration dx dy dz else enable
end error execute exit fine flip for fract frame free get global goto halt hand here hour id identical if
ignore inrange int inverse iostat last latch lefty len local lock max mc min mod move moves next noflip not
null of off on open or outside parameter pause pi pos power proceed prompt random react read ready relax
release reset return righty robot run rx ry rz scale select set shift sig sign signal sin single size speed
spin sqr sqrt state status step stop switch tas task then time timer to tool tps trans true type until val
value wait while window write xor
"""
KEYWORDS = set(_WORDS.split())
"""Reserved words of V+ in any case; no variable may have such a name."""

_TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d+)?)|'(?P<code>.)|\"(?P<text>[^\"]*)\"|(?P<name>\$?[a-z][a-z0-9_.]*)"
    r"|(?P<word>\$?[A-Z][A-Z0-9.]*)|(?P<sign>==|<>|=<|>=|[-+*/()\[\],<>]))"
)
_KIND = {
    "+": "sum", "-": "sum", "*": "product", "/": "product", "==": "relation", "<>": "relation", "=<": "relation",
    ">=": "relation", "<": "relation", ">": "relation", "AND": "and", "OR": "or", "BAND": "band", "BXOR": "bxor",
}  # fmt: skip


class VPlusError(Exception):
    """Error in a program's text."""


def single(value):
    """The value in single precision, as a controller stores it."""
    return value if isinstance(value, str) else struct.unpack("f", struct.pack("f", value))[0]


def code_of(line):
    """A line without its comment, which begins with a semicolon outside quotes."""
    found = re.match(r"(?:'.|\"[^\"]*\"|[^;'\"])*", line)
    return found[0].strip()


class Expression:
    """One expression, token by token; `names` resolves each variable."""

    def __init__(self, text, names):
        self._names, self._at = names, 0
        self._tokens = []
        position = 0
        while text[position:].strip():
            found = _TOKEN.match(text, position)
            if found is None:
                raise VPlusError(f"cannot read {text[position:]!r}")
            self._tokens.append((found.lastgroup, found[found.lastgroup]))
            position = found.end()

    @property
    def _next(self):
        return self._tokens[self._at] if self._at < len(self._tokens) else (None, None)

    def _take(self, wanted=None):
        kind, value = self._next
        if kind is None or (wanted is not None and value != wanted):
            raise VPlusError(f"expected {wanted or 'more'}, found {value!r}")
        self._at += 1
        return kind, value

    def whole(self):
        """The whole expression as Python."""
        python = self._chain()
        if self._next[0] is not None:
            raise VPlusError(f"{self._next[1]!r} is too much")
        return python

    def list(self):
        """Comma-separated expressions as Python."""
        found = [self._chain()]
        while self._next[1] == ",":
            self._take()
            found.append(self._chain())
        if self._next[0] is not None:
            raise VPlusError(f"{self._next[1]!r} is too much")
        return found

    def _chain(self):
        operands, operators = [self._operand()], []
        while self._next[1] in _KIND and self._next[0] in ("sign", "word"):
            operators.append(self._take()[1])
            operands.append(self._operand())
        kinds = [_KIND[supervisor] for supervisor in operators]
        plain = set(kinds) <= {"sum", "product", "relation"} and kinds.count("relation") <= 1
        if len(set(kinds)) > 1 and not plain:
            raise VPlusError(f"{' '.join(operators)} need parentheses")
        if "relation" in kinds:
            at = kinds.index("relation")
            sign = {"==": "==", "<>": "!=", "=<": "<="}.get(operators[at], operators[at])
            left = self._joined(operands[: at + 1], operators[:at])
            right = self._joined(operands[at + 1 :], operators[at + 1 :])
            return f"(-1 if {left} {sign} {right} else 0)"
        return self._joined(operands, operators)

    @staticmethod
    def _joined(operands, operators):
        match operators[:1]:
            case ["AND"] | ["OR"]:
                word = f" {operators[0].lower()} "
                return f"(-1 if {word.join(f'({each}) != 0' for each in operands)} else 0)"
            case ["BAND"] | ["BXOR"]:
                sign = {"BAND": " & ", "BXOR": " ^ "}[operators[0]]
                return f"({sign.join(f'int({each})' for each in operands)})"
        return "(" + operands[0] + "".join(f" {o} {x}" for o, x in zip(operators, operands[1:], strict=True)) + ")"

    def _operand(self):
        kind, value = self._take()
        match kind, value:
            case "number", _:
                return value
            case "code", _:
                return str(ord(value))
            case "text", _:
                return repr(value)
            case "sign", "-":
                return f"(-{self._operand()})"
            case "sign", "(":
                inner = self._chain()
                self._take(")")
                return f"({inner})"
            case "word", "NOT":
                return f"(-1 if {self._operand()} == 0 else 0)"
            case "word", "TRUE" | "FALSE":
                return "-1" if value == "TRUE" else "0"
            case "word", "POWER":
                return "'POWER'"
            case "word", _ if value in FUNCTIONS or value in HARDWARE:
                return f"f[{value!r}]({self._arguments()})"
            case "name", _:
                return "{}[{}]".format(*self._place(value))
        raise VPlusError(f"{value!r} is no operand")

    def _arguments(self):
        self._take("(")
        found = [self._chain()]
        while self._next[1] == ",":
            self._take()
            found.append(self._chain())
        self._take(")")
        return ", ".join(found)

    def _place(self, name):
        index = None
        if self._next[1] == "[":
            self._take()
            index = self._chain()
            self._take("]")
        return self._names.place(name, index)

    def reference(self):
        """Reference to its value: the variable itself, or a copy."""
        kind, value = self._next
        if kind == "name":
            self._at += 1
            container, key = self._place(value)
            if self._next[0] is None:
                return f"({container}, {key})"
            self._at = 0
        return f"([{self.whole()}], 0)"

    def target(self):
        """Container and key of the variable."""
        kind, value = self._take()
        if kind != "name":
            raise VPlusError(f"{value!r} is no variable")
        return self._place(value)


class Names:
    """A program's parameters and automatic variables; all others are global and begin with `pd.`."""

    def __init__(self, parameters):
        self.parameters, self.automatic = list(parameters), set()
        self.read_or_set = set()
        self.declare(())

    def declare(self, names):
        """Declares further automatic variables."""
        names = list(names)
        self.automatic |= set(names)
        taken = KEYWORDS & {name.removeprefix("$") for name in (*self.parameters, *names)}
        if taken:
            raise VPlusError(f"{', '.join(taken)} is a reserved word of V+")

    def place(self, name, index):
        if len(name.removeprefix("$")) > NAME_MAX:
            raise VPlusError(f"{name} has more than {NAME_MAX} characters")
        key = repr(name) if index is None else f"({name!r}, int({index}))"
        if name in self.parameters:
            return f"p[{self.parameters.index(name)}][0]", f"p[{self.parameters.index(name)}][1]"
        if name in self.automatic:
            return "a", key
        if not name.removeprefix("$").startswith("pd."):
            raise VPlusError(f"{name} is neither declared nor global")
        self.read_or_set.add(name)
        return "g", key


class Program:
    """One `.PROGRAM` to `.END`, translated."""

    def __init__(self, head, lines):
        found = re.fullmatch(r"\.PROGRAM ([a-z][a-z0-9.]*)\((.*)\)", head)
        if found is None:
            raise VPlusError(f"{head!r} is not a program head")
        self.name = found[1]
        self.parameters = [each.strip() for each in found[2].split(",") if each.strip()]
        self.names = Names(self.parameters)
        self.calls = []
        self.assigned = set()
        self._python = ["def program(p, g, f, call, rim, single):", "    a = {}"]
        self._blocks, self._cases, self._fresh = [], 0, False
        if len(self.name) > NAME_MAX:
            raise VPlusError(f"{self.name} has more than {NAME_MAX} characters")
        for number, line in lines:
            try:
                if code := code_of(line):
                    self._statement(code)
            except VPlusError as error:
                raise VPlusError(f"line {number}, {line.strip()}: {error}") from None
        if self._blocks:
            raise VPlusError(f"{self.name}: {self._blocks[-1]} has no END")
        scope = {}
        exec(compile("\n".join(self._python), self.name, "exec"), scope)
        self.run = scope["program"]

    def _emit(self, python):
        self._python.append("    " * (1 + len(self._blocks)) + python)

    def _opens(self, python, block):
        self._emit(python)
        self._blocks.append(block)
        self._emit("pass")

    def _value(self, text):
        return Expression(text, self.names).whole()

    def _statement(self, code):
        word = re.match(r"[A-Z.]+|", code)[0]
        match word:
            case "AUTO":
                self.names.declare(each.strip().partition("[")[0] for each in code[5:].split(","))
            case "IF" if code.endswith(" THEN"):
                self._opens(f"if {self._value(code[3:-5])} != 0:", "IF")
            case "ELSE" if self._blocks[-1:] == ["IF"]:
                self._blocks.pop()
                self._opens("else:", "ELSE")
            case "WHILE" if code.endswith(" DO"):
                self._opens(f"while {self._value(code[6:-3])} != 0:", "WHILE")
            case "FOR":
                self._for(code)
            case "CASE" if code.endswith(" OF"):
                self._cases += 1
                self._emit(f"case{self._cases} = {self._value(code[5:-3])}")
                self._opens("if False:", f"CASE {self._cases}")
            case "VALUE" | "ANY" if self._blocks and self._blocks[-1].startswith("CASE"):
                self._value_of_case(code)
            case "END" if self._blocks:
                self._blocks.pop()
            case "CALL":
                self._call(code)
            case "RETURN":
                self._emit("return")
            case "ALTER" | "WRITE":
                text = code.removesuffix(", /N").partition(" " if word == "ALTER" else ") ")[2]
                self._emit(f"rim({word!r}, [{', '.join(Expression(text, self.names).list())}])")
            case _ if word in RIM:
                self._emit(f"rim({word!r}, {code!r})")
            case "":
                self._assign(code)
            case _:
                raise VPlusError("not a statement here")

    def _assign(self, code):
        found = re.fullmatch(r"(.+?)\s=\s(.+)", code)
        if found is None:
            raise VPlusError("not a statement")
        container, key = Expression(found[1], self.names).target()
        self.assigned.add(found[1].partition("[")[0])
        self._emit(f"{container}[{key}] = single({self._value(found[2])})")

    def _for(self, code):
        found = re.fullmatch(r"FOR ([a-z]+) = (.+) TO (.+)", code)
        if found is None or found[1] not in self.names.automatic:
            raise VPlusError("not a loop over an automatic variable")
        first, last = self._value(found[2]), self._value(found[3])
        self._opens(f"for a[{found[1]!r}] in range(int({first}), int({last}) + 1):", "FOR")

    def _value_of_case(self, code):
        block = self._blocks.pop()
        if code == "ANY":
            self._opens("else:", block)
        elif code.endswith(":"):
            values = ", ".join(Expression(code[6:-1], self.names).list())
            self._opens(f"elif case{block[5:]} in ({values},):", block)
        else:
            raise VPlusError("a VALUE ends with a colon")

    def _call(self, code):
        found = re.fullmatch(r"CALL ([a-z][a-z0-9.]*)(?:\((.*)\))?", code)
        if found is None:
            raise VPlusError("not a call")
        texts = _split(found[2] or "")
        self.calls.append((found[1], len(texts)))
        references = [Expression(text, self.names).reference() for text in texts]
        self._emit(f"call({found[1]!r}, [{', '.join(references)}])")


def _split(text):
    """Splits at commas outside brackets and quotes."""
    parts = re.findall(r"(?:'.|\"[^\"]*\"|\[[^\]]*\]|\((?:[^()]|\([^()]*\))*\)|[^,])+", text)
    return [part.strip() for part in parts]


class Module:
    """All programs of a file and their shared globals. `functions` answers for robot, line and tasks."""

    def __init__(self, text, functions=None, rim=None):
        self.programs, self.globals = {}, {}
        self._functions = FUNCTIONS | (functions or {})
        self._rim = rim
        head, lines = None, []
        for number, line in enumerate(text.splitlines(), 1):
            if len(line) > LINE_MAX:
                raise VPlusError(f"line {number} has more than {LINE_MAX} characters")
            if line.startswith(".PROGRAM") and head is None:
                head, lines = code_of(line), []
            elif line.startswith(".END") and head is not None:
                program = Program(head, lines)
                if program.name in self.programs:
                    raise VPlusError(f"line {number}: {program.name} is there twice")
                self.programs[program.name] = program
                head = None
            elif head is None or line.startswith("."):
                raise VPlusError(f"line {number} stands between programs")
            else:
                lines.append((number, line))
        if head is not None:
            raise VPlusError(f"{head} has no .END")
        self._check()

    def _check(self):
        assigned = set().union(*(program.assigned for program in self.programs.values()))
        for program in self.programs.values():
            for name, count in program.calls:
                if name not in self.programs:
                    raise VPlusError(f"{program.name} calls {name}, which does not exist")
                if count != len(self.programs[name].parameters):
                    raise VPlusError(f"{program.name} calls {name} with {count} arguments")
            # ATTACH sets a logical unit's number, HERE or SET a location
            never = program.names.read_or_set - assigned - {"pd.lun", "pd.here", "pd.nom"}
            if never:
                raise VPlusError(f"{program.name} reads {', '.join(sorted(never))}, which nothing sets")

    def call(self, name, arguments=()):
        """Runs a program; arguments are references (container, key)."""
        self.programs[name].run(arguments, self.globals, self._functions, self.call, self._rim, single)

    def value(self, name, *arguments):
        """Runs a program on these values; returns the final value of its last argument."""
        cells = [[argument] for argument in arguments]
        self.call(name, [(cell, 0) for cell in cells])
        return cells[-1][0]
