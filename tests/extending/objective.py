"""The angular velocity of a body over the cycle of a machine: `quantity = "turning"`, `of = "rocker"`."""

from optlink.extending import Array, Element, ElementTerm, MotionColumns, Moving, QuantityType, Reactions, Value, register

BODY = Element(lambda mechanism: mechanism.bodies, "no such body")


def signal(moving: Moving, reactions: Reactions, term: ElementTerm) -> tuple[Value, ...]:
    """Return the formula of the optimiser at one crank angle [rad/s]."""
    return (moving.state(str(term.of)).omega,)


def history(record: MotionColumns, term: ElementTerm) -> Array:
    """Return the column that the validator reads [rad/s]."""
    return record[f"{term.of}.omega_rad_s"]


register(QuantityType("turning", "angular velocity", ("peak", "rms", "largest", "least"), "body", BODY, signal, history))
