"""Equations of one machine as machine code, kept on the disk: source, cache folder, and the functions that numba compiled."""

import contextlib
import hashlib
import importlib.util
import os
import sys
import tempfile
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi

from optlink.clearance.compiled.source import Unsupported, written
from optlink.clearance.equations import Equations
from optlink.linkage.vector2d import Array

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
    parts = [(here / f"{name}.py").read_text(encoding="utf-8") for name in ("motion", "maxima", "switches", "dop853")]
    return parts[0], _key("".join(parts))


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
