"""The angular velocity of a body over the cycle of a machine: `quantity = "turning"`, `of = "rocker"`."""

from optlink.extending import Element, QuantityType, register

BODY = Element(lambda mechanism: mechanism.bodies, "no such body")


def signal(moving, reactions, term):
    """Return the formula of the optimiser at one crank angle [rad/s]."""
    return (moving.state(term.of).omega,)


def history(record, term):
    """Return the column that the validator reads [rad/s]."""
    return record[f"{term.of}.omega_rad_s"]


register(QuantityType("turning", "angular velocity", ("peak", "rms", "largest", "least"), "body", BODY, signal, history))
