"""Forces and torques that terms name, over the positions of a machine: convex in the masses and stiffnesses that are added."""

from typing import Any

import numpy as np

from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.inverse import reactions, required_wrench
from optlink.dynamics.machine import Machine
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.cycle.terms import Term
from optlink.problem.machine.balance import BalanceSection
from optlink.units import KINDS


def amounts(record: MotionColumns, term: Term) -> Array:
    """Return the force or torque of a term at the positions that count, (positions, parts); the parts of a force are x and y."""
    moving, signal = record.moving, term.nature.signal
    assert signal is not None
    acting = reactions(moving, required_wrench(moving, inertia=False)) if term.static else record.reactions
    values = np.stack([record.full(part) for part in signal(moving, acting, term)], axis=-1)
    if term.over is None:
        return values
    low, high = term.over.bounds
    turned = np.mod(np.asarray(moving.motion.crank_angle, dtype=float) - low, TURN)
    return np.asarray(values[(turned <= high - low + 1e-9) | (turned >= TURN - 1e-9)])


def value(term: Term, values: Array) -> float:
    """Return the root mean square or the largest magnitude of amounts (positions, parts)."""
    squares = np.sum(values * values, axis=1)
    return float(np.sqrt(np.mean(squares) if term.how == "rms" else np.max(squares)))


def unit_of(term: Term) -> str:
    """Return the display unit of a term."""
    return KINDS[term.nature.kind].display.replace("*", " ")


def measured(machine: Machine, section: BalanceSection) -> list[Term]:
    """Return all terms that are measured, as root mean squares: shaking force and moment, torque, every reaction."""
    terms: list[dict[str, Any]] = [{"quantity": name} for name in ("shaking force", "shaking moment", "torque")]
    for point, bodies in machine.mechanism.pins.items():
        terms += [{"quantity": "reaction", "of": point, "on": body} for body in (bodies if len(bodies) > 2 else (None,))]
    terms += [{"quantity": "guide force", "of": guide.name} for guide in machine.mechanism.guides]
    return [section.term(Term.model_validate({**term, "measure": "rms"})) for term in terms]
