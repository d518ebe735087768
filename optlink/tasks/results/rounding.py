"""What a design with sizes on a grid has lost, and which size matters: a part of the result of a search."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from optlink.problem.document import Number
from optlink.units import percent

EXACT = 1e-9  # share of the rounded objective: an optimum below it is exact but for the digits of the computer
MANIFOLD = 10.0  # share lost beyond which it says nothing but that the optimum is nearly zero
TOLD = 0.01  # share lost from which the optimum is told beside it: it may be nearly zero


@dataclass(frozen=True)
class Influence:
    """What half a step of a size changes a limit by, in `unit`.

    `room`: half the width of a limit with two sides, the distance of the optimum from a `one_sided` one.
    """

    size: str
    limit: str
    change: Number
    room: Number
    unit: str
    one_sided: bool = False

    @property
    def share(self) -> float:
        """The change as a share of the room; infinite where there is none."""
        return self.change / self.room if self.room > 0.0 else math.inf if self.change > 0.0 else 0.0


@dataclass(frozen=True)
class Rounding:
    """How the sizes of a design came to lie on a grid.

    `steps`: step or stock of every rounded size, in words; `optimum` [SI] and `objective` without rounding; `naive`: the
    objective with the nearest values of the grid, `naive_valid`: whether that design is valid. `solved`: programmes solved;
    `whole`: whether the whole grid was searched, so that a better design on it needs another local optimum. `finer`: the number
    by which the steps must be divided, of those tried, where no design is valid; `needed`: the tolerances with which the nearest
    design would meet its limits.
    """

    steps: Mapping[str, str]
    optimum: Mapping[str, Number]
    objective: Number
    naive: Number | None
    naive_valid: bool
    solved: int
    whole: bool
    influences: tuple[Influence, ...] = ()
    finer: Number | None = None
    needed: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The grid in words: the step of all sizes, or that of each."""
        same = set(self.steps.values())
        return same.pop() if len(same) == 1 else "; ".join(f"{name} {step}" for name, step in self.steps.items())

    def loss(self, objective: float) -> float:
        """Return the increase of the objective [SI] by rounding as a share of the optimum; infinite for an exact one."""
        more = objective - self.objective
        return more / abs(self.objective) if abs(self.objective) > EXACT * abs(objective) else math.inf if more > 0.0 else 0.0

    def ended(self, objective: float, optimum: str) -> str:
        """Return how the search of the grid ended.

        Parameters
        ----------
        objective : float [SI]
            Of the best design; NaN without one.
        optimum : str
            The objective without rounding in words, which a loss of more than a hundredth is told with.
        """
        if math.isnan(objective):
            ways = [f"divide the steps by {self.finer:g}"] if self.finer else []
            if self.needed:
                ways.append("allow " + ", ".join(f"{name} {value}" for name, value in self.needed.items()))
            return f"no valid design was found on a grid of {self.text}" + (f"; {', or '.join(ways)}" if ways else "")
        found = "every part searched locally" if self.whole else "the grid was searched near the optimum, not all of it"
        share = self.loss(objective)
        digits = min(max(1 - math.floor(math.log10(abs(100.0 * share))), 0), 4) if share and math.isfinite(share) else 0
        of = f" of {optimum}" if share > TOLD else ""
        exact = optimum if math.isfinite(share) else "exact"
        lost = f"{percent(share, digits, signed=True)}{of} by rounding" if share <= MANIFOLD else f"{exact} without rounding"
        return f"grid of {self.text}, valid as built; {found}; {lost}"
