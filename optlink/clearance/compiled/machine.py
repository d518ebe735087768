"""Equations of one machine as machine code, kept on the disk: source, cache folder, and the functions that numba compiled."""

import contextlib
import hashlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi
import numpy as np

from optlink.clearance.equations import Equations
from optlink.linkage.vector2d import Array

# Translate scalar casadi expressions to Python source that numba compiles.
#
# casadi differentiates, eliminates common subexpressions and orders the operations; here each of them becomes one assignment.
# Numbers of the machine (lengths, masses, stiffnesses) become entries of an argument `c`, so all designs of a machine share one
# source and one compilation; only small numbers that belong to the formulas (0, 1, 2, 1/2) and exponents are literals.

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


FOLDER = "OPTLINK_CACHE"
"""Environment variable with the cache folder; default: that of the user."""

FUNCTIONS = ("rhs", "gaps", "watch", "project")
"""Compiled functions of a machine."""

STAMP = 1_000_000_000
"""Modification time of every source file: numba's cache compares it, and processes may write the same file."""


def cache_folder() -> Path:
    """Return the folder of the sources and of what numba compiled from them; it may be deleted at any time."""
    if os.environ.get(FOLDER):
        return Path(os.environ[FOLDER])
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "optlink" / "compiled"


@dataclass(frozen=True)
class MachineCode:
    """Equations of a machine for the compiled engine: source of FUNCTIONS, and their argument `c`."""

    text: str
    constants: Array

    @cached_property
    def addresses(self) -> tuple[int, ...]:
        """Addresses of the compiled functions; the first use compiles them or reads the cache."""
        module = _module(self.text, _key(self.text))
        return tuple(getattr(module, name).address for name in FUNCTIONS)


def code_of(equations: Equations) -> MachineCode:
    """Return the equations as source and constants.

    Raises
    ------
    Unsupported
        An operation has no counterpart in the compiled engine.
    """
    x, p = equations.x, casadi.vertcat(equations.further, equations.command, equations.entered, equations.modes)
    depth, rate, _, normal, normal_rate, _, torque, torque_rate = equations.watched
    outputs = equations.rates, [depth, rate], [normal, normal_rate, torque, torque_rate], [_projection(equations)]
    return MachineCode(*written({name: ([x, p], values) for name, values in zip(FUNCTIONS, outputs, strict=True)}))


def engine() -> Any:
    """Return the module `motion`, imported from the cache folder: numba's cache then knows all that it is compiled from."""
    return _module(*_engine_source())


def _engine_source() -> tuple[str, str]:
    """Return the source of the engine and its key, which depends on all that it is compiled from."""
    here = Path(__file__).parent
    text = (here / "motion.py").read_text(encoding="utf-8")
    return text, _key(text)


def is_cached(equations: Equations) -> bool:
    """Return whether the machine code of equations and that of the engine are on the disk, without importing numba."""
    folder = cache_folder() / "__pycache__"
    if not folder.is_dir():
        return False
    try:
        keys = {_engine_source()[1]: ("advance",), _key(code_of(equations).text): FUNCTIONS}
    except (Unsupported, metadata.PackageNotFoundError):
        return False
    return all(any(folder.glob(f"optlink_{key}.{name}-*.nbi")) for key, names in keys.items() for name in names)


def _key(text: str) -> str:
    """Hash of a source, and of the versions of Python, SciPy and numba."""
    content = "\n".join([text, sys.version, *map(metadata.version, ("scipy", "numba"))])
    return hashlib.sha256(content.encode()).hexdigest()[:24]


def _projection(equations: Equations) -> Any:
    """The state on the closing joints nearest to a state, as in `Integration`: the crank stays, least changes otherwise."""
    if not equations.closing:
        return equations.x
    n, crank = equations.size, equations.tree.driven
    _, residual, grip = equations.closed
    joints = casadi.Function("joints", equations.closed[:1], [residual, grip])
    q, v = equations.x[:n], equations.x[n:]

    def least(matrix: Any, right: Any) -> Any:
        free = casadi.SX(casadi.densify(matrix))
        free[:, crank] = 0.0
        return free.T @ casadi.solve(free @ free.T, right)

    for _ in range(2):
        residuals, matrix = joints(q)
        q = q - least(matrix, residuals)
    matrix = joints(q)[1]
    return casadi.vertcat(q, v - least(matrix, matrix @ v))


@lru_cache(maxsize=64)
def _module(text: str, key: str) -> ModuleType:
    """Import the source from the cache folder, where numba keeps the machine code beside it."""
    name = f"optlink_{key}"
    path = _stored(text, f"{name}.py")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _stored(text: str, name: str) -> Path:
    """Write a source file unless it is there; other processes may do the same at the same time."""
    user = str(os.getuid()) if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    for folder in (cache_folder(), Path(tempfile.gettempdir()) / f"optlink-{user}"):
        path = folder / name
        with contextlib.suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not path.exists() or path.read_text(encoding="utf-8") != text:
                _replace(path, text)
            return path
    raise OSError(f"neither {cache_folder()} nor the temporary folder can be written")


def _replace(path: Path, text: str) -> None:
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
        os.utime(temporary, (STAMP, STAMP))
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
