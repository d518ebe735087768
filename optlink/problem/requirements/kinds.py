"""The kinds of requirement: one class per kind."""

import functools
import operator
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Discriminator, Tag

from optlink.problem.requirements.base import DEFAULT_KIND, Requirement
from optlink.problem.requirements.laws import FunctionRequirement
from optlink.problem.requirements.points import MotionRequirement, PathRequirement
from optlink.problem.requirements.values import DwellRequirement, PositionRequirement, StrokeRequirement, TransmissionRequirement

_KINDS: tuple[type[Requirement], ...] = (
    FunctionRequirement,
    PathRequirement,
    MotionRequirement,
    TransmissionRequirement,
    DwellRequirement,
    PositionRequirement,
    StrokeRequirement,
)
REQUIREMENTS = {kind.__annotations__["kind"].__args__[0]: kind for kind in _KINDS}
"""Classes of requirements by their kind."""


def _kind_of(raw: object) -> str:
    return str(raw.get("kind", DEFAULT_KIND)) if isinstance(raw, Mapping) else getattr(raw, "kind", DEFAULT_KIND)


if TYPE_CHECKING:
    AnyRequirement = Any  # one of these classes
else:
    _tagged = [Annotated[requirement, Tag(kind)] for kind, requirement in REQUIREMENTS.items()]
    AnyRequirement = Annotated[functools.reduce(operator.or_, _tagged), Discriminator(_kind_of)]


def lacks(kind: str, key: str) -> tuple[str, str] | None:
    """Return message and remedy for a key that a kind of requirement does not have, but others have; None for any other key."""
    others = [other for other, requirement in REQUIREMENTS.items() if key in requirement.model_fields]
    return (f"a {kind} has no {key}", f'Leave it out, or write kind = "{others[0]}"') if others else None
