"""Choice of the integrator of a machine with joint clearance from the amount of requested work."""

import enum
from collections.abc import Mapping
from typing import Any

from optlink.clearance.control import ClosedLoop
from optlink.errors import InputError


class IntegratorKind(enum.StrEnum):
    """Integrator of machines with joint clearance."""

    AUTO = "auto"
    CVODES = "cvodes"
    COMPILED = "compiled"


WORTH = 6.0
"""Seconds of work of CVODES from which on the compiled integrator is faster even if everything must be compiled first ..."""

LOADED = 0.6
"""... and from which on it is faster if it only has to be loaded from the cache."""

REVOLUTION, ROW = 0.02, 2.5e-5
"""Seconds of CVODES for a revolution and for each of its rows, per joint with clearance (measured on the shipped machines)."""

INSTALL = 'Install it: pip install "optlink[fast]", or leave the integrator to optlink'


def installed() -> bool:
    """Return whether numba, which the compiled integrator needs, is installed, and supports the installed numpy."""
    try:
        import numba  # noqa: F401
    except ImportError:
        return False
    return True


def resumed(integrator: str, checkpoint: Mapping[str, Any] | None) -> str:
    """Return the requested integrator; for "auto" that of the checkpoint from which the work continues."""
    if checkpoint is None or integrator != IntegratorKind.AUTO:
        return integrator
    return str(checkpoint.get("integrator", IntegratorKind.CVODES))


def chosen(integrator: str, closed_loop: ClosedLoop, revolutions: float, *, cache: bool = False) -> IntegratorKind:
    """Return the requested integrator, or for "auto" the faster one for the revolutions of all runs of a machine.

    `cache`: whether what is compiled already counts; else the choice depends on the request alone, as it must where several
    processes or an interrupted run take part in one work.

    Raises
    ------
    InputError
        The integrator is unknown or not installed, or cannot compile this machine.
    """
    if integrator not in list(IntegratorKind):
        raise InputError("no such integrator", f"Take one of {', '.join(IntegratorKind)}", key="integrator", value=integrator)
    auto, equations = integrator == IntegratorKind.AUTO, closed_loop.equations
    if integrator == IntegratorKind.CVODES or (auto and closed_loop.integration.slow):
        return IntegratorKind.CVODES
    from optlink.clearance.compiled.machine import Unsupported, code_of, is_cached

    if auto:
        seconds = revolutions * len(equations.gaps) * (REVOLUTION + ROW * closed_loop.rows)
        worth = LOADED if cache and LOADED < seconds < WORTH and is_cached(equations) else WORTH
        if seconds < worth or not installed():
            return IntegratorKind.CVODES
    elif not installed():
        message = "numba is not installed, or does not support the installed numpy"
        raise InputError(message, INSTALL, key="integrator", value=integrator)
    try:
        code_of(equations)
    except Unsupported as error:
        if auto:
            return IntegratorKind.CVODES
        message = f"a formula of the machine cannot be compiled: {error}"
        raise InputError(message, "Take the integrator cvodes", key="integrator", value=integrator) from None
    return IntegratorKind.COMPILED
