"""Translate scalar casadi expressions to Python source that numba compiles.

casadi differentiates, eliminates common subexpressions and orders the operations; here each of them becomes one assignment.
Numbers of the machine (lengths, masses, stiffnesses) become entries of an argument `c`, so all designs of a machine share one
source and one compilation; only small numbers that belong to the formulas (0, 1, 2, 1/2) and exponents are literals.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi
import numpy as np

from optlink.linkage.vector2d import Array

LITERALS = (0.0, 0.5, 1.0, 2.0)
"""Magnitudes of constants that stay literals: casadi creates them itself when it differentiates and simplifies."""

UNARY = ("acos", "asin", "atan", "ceil", "cos", "cosh", "exp", "floor", "log", "sin", "sinh", "sqrt", "tan", "tanh")
BINARY = ("atan2", "fmod", "hypot")
"""Functions of the module `math` that casadi has under the same name."""

OPERATIONS: dict[int, str] = {
    **{getattr(casadi, f"OP_{name.upper()}"): f"{name}({{0}})" for name in UNARY},
    **{getattr(casadi, f"OP_{name.upper()}"): f"{name}({{0}}, {{1}})" for name in BINARY},
    casadi.OP_ASSIGN: "{0}",
    casadi.OP_ADD: "{0} + {1}",
    casadi.OP_SUB: "{0} - {1}",
    casadi.OP_MUL: "{0} * {1}",
    casadi.OP_DIV: "{0} / {1}",
    casadi.OP_NEG: "-{0}",
    casadi.OP_POW: "{0} ** {1}",
    casadi.OP_SQ: "{0} * {0}",
    casadi.OP_TWICE: "2.0 * {0}",
    casadi.OP_INV: "1.0 / {0}",
    casadi.OP_FABS: "abs({0})",
    casadi.OP_SIGN: "1.0 if {0} > 0.0 else -1.0 if {0} < 0.0 else 0.0",
    casadi.OP_FMIN: "{0} if {0} < {1} else {1}",
    casadi.OP_FMAX: "{0} if {0} > {1} else {1}",
    casadi.OP_LT: "1.0 if {0} < {1} else 0.0",
    casadi.OP_LE: "1.0 if {0} <= {1} else 0.0",
    casadi.OP_EQ: "1.0 if {0} == {1} else 0.0",
    casadi.OP_NE: "1.0 if {0} != {1} else 0.0",
    casadi.OP_NOT: "1.0 if {0} == 0.0 else 0.0",
    casadi.OP_AND: "1.0 if {0} != 0.0 and {1} != 0.0 else 0.0",
    casadi.OP_OR: "1.0 if {0} != 0.0 or {1} != 0.0 else 0.0",
    casadi.OP_IF_ELSE_ZERO: "{1} if {0} != 0.0 else 0.0",
}
"""casadi operation -> Python expression of its operands."""

HEADER = f'''"""Equations of a machine with joint clearance, written by optlink for its compiled engine; safe to delete."""

from math import {", ".join(sorted(UNARY + BINARY))}

from numba import cfunc, types

_P = types.CPointer(types.float64)
_SIGNATURE = types.void(_P, _P, _P, _P)
_OPTIONS = {{"cache": True, "error_model": "numpy"}}
'''


class Unsupported(ValueError):
    """Error: an operation of casadi that has no counterpart in the compiled engine."""


def written(functions: Mapping[str, tuple[Sequence[Any], Sequence[Any]]]) -> tuple[str, Array]:
    """Return the source of a module, and the constants `c` of its functions, given by name as (inputs, outputs).

    The inputs are at most two vectors of symbols, x and p. The function `name(x, p, c, o)` writes the values of the outputs to
    `o`, one after another.

    Raises
    ------
    Unsupported
        An expression contains an operation without a counterpart.
    """
    constants: list[float] = []
    parts = [HEADER]
    for name, (inputs, outputs) in functions.items():
        lines = "\n".join(f"    {line}" for line in _lines(inputs, outputs, constants))
        parts.append(f"@cfunc(_SIGNATURE, **_OPTIONS)\ndef {name}(x, p, c, o):\n{lines}\n")
    return "\n\n".join(parts), np.array([*constants, 0.0])


def _lines(inputs: Sequence[Any], outputs: Sequence[Any], constants: list[float]) -> list[str]:
    """Return one assignment for each instruction; appends to the constants."""
    vector = casadi.densify(casadi.vertcat(*[casadi.vec(casadi.densify(output)) for output in outputs]))
    function = casadi.Function("f", list(inputs), [vector], {"cse": True})
    lines, values = [], {}
    for k in range(function.n_instructions()):
        code, to, sources = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        target, base = f"w{to[0]}", f"w{sources[0]}" if sources else ""
        if code == casadi.OP_INPUT:
            expression = f"{'xp'[sources[0]]}[{sources[1]}]"
        elif code == casadi.OP_OUTPUT:
            target, expression = f"o[{to[1]}]", base
        elif code == casadi.OP_CONST:
            values[to[0]] = value = float(function.instruction_constant(k))
            expression = repr(value)
            if abs(value) not in LITERALS:
                expression = f"c[{len(constants)}]"
                constants.append(value)
        elif code == casadi.OP_CONSTPOW:
            power = values[sources[1]]
            expression = f"{base} * sqrt({base})" if power == 1.5 else f"{base} ** {power!r}"
        elif code in OPERATIONS:
            expression = OPERATIONS[code].format(*(f"w{source}" for source in sources))
        else:
            names = [name for name in vars(casadi) if name.startswith("OP_") and getattr(casadi, name) == code]
            raise Unsupported(f"{' or '.join(names)} of casadi")
        lines.append(f"{target} = {expression}")
    return lines
