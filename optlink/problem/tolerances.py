"""Tolerances of dimensions: input from a problem file or the command line, and the resulting deviations."""

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.linkage.vector2d import Array, Value
from optlink.problem.base_model import in_folder
from optlink.problem.mechanism import DyadsSection, FourBarSection
from optlink.problem.quantity import Quantity, Unusable, below, check_keys, check_name, is_number, nearest
from optlink.problem.targets.target_points import enclosed, read_columns, split_enclosed
from optlink.units import parse, plain

NORMAL = "normal"
CONTACT, MEASURED = "contact", "measured"
SIGMAS = 3.0  # standard deviations of a normal distribution within its tolerance
CLEARANCE = ".clearance"
LARGEST = 0.5  # largest tolerance as a share of its length
KEYS = ("tolerance", "distribution", "cost")
EXAMPLE = 'Write for example coupler="0.1 mm", coupler="0.1 mm uniform" or coupler="parts.csv"'


# --- distributions -----------------------------------------------------------------------------------------------------


def _normal(share: Array) -> Array:
    from scipy.special import ndtri

    return np.asarray(ndtri(share), dtype=float) / SIGMAS


def _triangular(share: Array) -> Array:
    low = np.sqrt(2.0 * np.minimum(share, 0.5)) - 1.0
    return np.asarray(np.where(share < 0.5, low, 1.0 - np.sqrt(2.0 * np.minimum(1.0 - share, 0.5))), dtype=float)


@dataclass(frozen=True)
class Distribution:
    """A distribution with a tolerance of 1 and mean 0: its standard deviation and its quantile function."""

    sigma: float
    quantile: Callable[[Array], Array]


SHAPES: Mapping[str, Distribution] = {
    NORMAL: Distribution(1.0 / SIGMAS, _normal),
    "uniform": Distribution(1.0 / math.sqrt(3.0), lambda share: 2.0 * share - 1.0),
    "triangular": Distribution(1.0 / math.sqrt(6.0), _triangular),
    CONTACT: Distribution(1.0 / math.sqrt(2.0), lambda share: -np.cos(np.pi * share)),
}
"""Distributions by name. Contact: component along a link of a clearance with the journal in contact in a random direction."""

CHOICES = tuple(name for name in SHAPES if name != CONTACT)


@dataclass(frozen=True)
class Deviation:
    """Deviation of a dimension from its nominal value.

    `name` for display, `size` the quantity of the linkage to which it is added; `kind` "length" or "angle"; `tolerance` [SI]: the
    deviation lies within +- tolerance (normal distribution: three sigma). `values` (parts,) [SI]: measured deviations, in place
    of a distribution. `cost`: coefficient of the cost cost/t of a tolerance t.
    """

    name: str
    size: str
    kind: str
    tolerance: Any
    shape: str = NORMAL
    values: tuple[float, ...] = field(default=(), repr=False)
    cost: float = 1.0

    @cached_property
    def _sorted(self) -> Array:
        return np.sort(np.asarray(self.values, dtype=float))

    @property
    def mean(self) -> float:
        """Mean deviation [SI]."""
        return float(np.mean(self._sorted)) if self.values else 0.0

    @property
    def sigma(self) -> Any:
        """Standard deviation [SI]."""
        return float(np.std(self._sorted)) if self.values else SHAPES[self.shape].sigma * self.tolerance

    @property
    def ends(self) -> tuple[Any, Any]:
        """Least and largest deviation [SI] of the worst case."""
        return (float(self._sorted[0]), float(self._sorted[-1])) if self.values else (-self.tolerance, self.tolerance)

    def at(self, share: Array) -> Array:
        """Return quantiles of the deviation [SI] for shares; for measured ones, one of the measured values."""
        if self.values:
            place = np.minimum((share * len(self.values)).astype(int), len(self.values) - 1)
            return np.asarray(self._sorted[place], dtype=float)
        return np.asarray(self.tolerance * SHAPES[self.shape].quantile(share), dtype=float)


# --- tolerances as specified -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ToleranceEntry:
    """Tolerance of one dimension as specified: `text` with a unit, or a CSV file in `folder`; `shape` of the distribution.

    `content`: of an enclosed file, see `read_file`.
    """

    text: str
    shape: str | None = None
    cost: float = 1.0
    folder: Path = field(default=Path(), compare=False)
    content: str = field(default="", compare=False)

    def __str__(self) -> str:
        words = [self.text if self.measured else f"±{self.text}", self.shape or ""]
        return " ".join(filter(None, words)) + (f", cost {self.cost:g}" if self.cost != 1.0 else "")

    @property
    def measured(self) -> bool:
        """Whether the deviations are measured ones."""
        return self.text.lower().endswith(".csv")

    @property
    def source(self) -> str:
        """The text as in the file: with the content of an enclosed file."""
        return enclosed(self.text, self.content) if self.content else self.text

    @property
    def raw(self) -> dict[str, Any]:
        """Table for a problem file in any folder."""
        beside = self.measured and not self.content
        raw: dict[str, Any] = {"tolerance": str((self.folder / self.text).resolve()) if beside else self.source}
        return raw | ({"distribution": self.shape} if self.shape else {}) | ({"cost": self.cost} if self.cost != 1.0 else {})


def read_tolerance(raw: object, folder: Path) -> ToleranceEntry:
    """Read "0.1 mm", "0.1 mm uniform", "parts.csv" or { tolerance, distribution, cost }; the unit is not checked.

    Raises
    ------
    Unusable
    """
    if isinstance(raw, dict):
        check_keys(raw, KEYS)
        if "tolerance" not in raw:
            raise Unusable("this key is missing", 'Add tolerance = "0.1 mm"', "tolerance")
        if not isinstance(raw["tolerance"], str):
            raise Unusable("expected a tolerance with its unit", 'Write tolerance = "0.1 mm"', "tolerance", raw["tolerance"])
        entry = read_tolerance(raw["tolerance"], folder)
        shape, cost = raw.get("distribution", entry.shape), raw.get("cost", 1.0)
        if shape is not None and entry.measured:
            raise Unusable("measured deviations are a distribution themselves", "Leave it out", "distribution", shape)
        if shape is not None:
            check_name(shape, CHOICES, "unknown distribution", "distribution")
        if not is_number(cost) or not 0.0 < cost < math.inf:
            raise Unusable("a cost coefficient must be a number above zero", "Write cost = 2", "cost", cost)
        return replace(entry, shape=shape, cost=float(cost))
    if not isinstance(raw, str):
        remedy = f'Write "0.1 mm", "0.1 mm uniform", "parts.csv" or {{ {", ".join(f"{key} = ..." for key in KEYS)} }}'
        raise Unusable("expected a tolerance with its unit", remedy, "", raw)
    text = raw.strip().strip("\"'").strip()
    name, content = split_enclosed(raw)
    if content and ToleranceEntry(name).measured:
        return ToleranceEntry(name, content=content)
    quantity, _, word = text.rpartition(" ")
    numbered = any(letter.isdigit() for letter in quantity)
    if numbered and word.isalpha() and plain(quantity.strip())[-1:].isalpha():  # a unit and a distribution after the number
        check_name(word, CHOICES, "unknown distribution")
        return ToleranceEntry(quantity.strip(), word)
    entry = ToleranceEntry(text)
    return replace(entry, folder=folder) if entry.measured else entry


def flattened(table: Mapping[str, Any], keys: Collection[str], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield entries by full name: TOML reads D.x = "..." as a table D with an entry x, and "D.x" = "..." as one name.

    Parameters
    ----------
    keys : collection of str
        Keys of an entry that is a table itself.
    """
    for key, entry in table.items():
        if isinstance(entry, dict) and entry and not set(keys) & set(entry):
            yield from flattened(entry, keys, f"{above}{key}.")
        else:
            yield f"{above}{key}", entry


def by_name(raw: object, section: str, keys: Collection[str]) -> dict[str, Any]:
    """Return the entries of a section by the names of sizes, each given once; see `flattened`."""
    if not isinstance(raw, dict):
        raise Unusable("expected a table", f"Begin it with [{section}]", "", raw)
    entries: dict[str, Any] = {}
    for name, entry in flattened(raw, keys):
        if name in entries:
            raise Unusable("a size is given twice", "Give each once", name)
        entries[name] = entry
    return entries


def _read_table(raw: object, folder: Path) -> dict[str, ToleranceEntry]:
    entries: dict[str, ToleranceEntry] = {}
    for name, entry in by_name(raw, "tolerances", KEYS).items():
        with below(name, entry):
            entries[name] = read_tolerance(entry, folder)
    return entries


Tolerances = Annotated[dict[str, Any], in_folder(_read_table)]
"""Tolerances by the name of the dimension (`ToleranceEntry`)."""


def with_tolerance(table: dict[str, Any], name: str, value: object) -> None:
    """Assign a tolerance in a [tolerances] table, in place; None removes it.

    Distribution and cost are kept unless the new value specifies its own.
    """
    before: Any = None
    for other, entry in list(flattened(table, KEYS)):
        if other == name:
            before = entry
            remove(table, name)
    if value is None:
        return
    if before is not None and isinstance(value, str):
        try:
            old, new = read_tolerance(before, Path()), read_tolerance(value, Path())
        except Unusable:  # reported when the whole file is read
            table[name] = value
            return
        shape = new.shape or (None if new.measured else old.shape)
        inherited = ({"distribution": shape} if shape else {}) | ({"cost": old.cost} if old.cost != 1.0 else {})
        value = {"tolerance": new.text, **inherited} if inherited else new.text
    table[name] = value


def remove(table: dict[str, Any], name: str) -> None:
    """Remove an entry, whatever the nesting of its name."""
    if name in table:
        del table[name]
        return
    for cut, letter in enumerate(name):
        if letter == "." and isinstance(table.get(name[:cut]), dict):
            remove(table[name[:cut]], name[cut + 1 :])
            if not table[name[:cut]]:
                del table[name[:cut]]


# --- deviations of a linkage -------------------------------------------------------------------------------------------


def with_deviating_pivots(section: FourBarSection | DyadsSection, mechanism: Mechanism) -> tuple[Mechanism, dict[str, float]]:
    """Return the linkage with pivots that can deviate, and the values of these coordinates [m].

    A four-bar without a defined frame pose has its pivots in the origin and on the x axis.
    """
    if not isinstance(section, FourBarSection) or section.placed:
        return mechanism, {}
    pivots = {"A": ("A.x", "A.y"), "D": ("frame", "D.y")}
    return replace(mechanism, ground=pivots), {"A.x": 0.0, "A.y": 0.0, "D.y": 0.0}


def deviations(
    entries: Mapping[str, ToleranceEntry],
    mechanism: Mechanism,
    quantities: Mapping[str, Quantity],
    sizes: Mapping[str, float],
    shape: str = NORMAL,
    output: str = "",
) -> tuple[Deviation, ...]:
    """Return the deviations of dimensions, pivots and clearances of a linkage from `with_deviating_pivots`.

    `sizes`: every dimension of the mechanism [m, rad]; `shape`: the default distribution; `output`: the body (its angle), or
    "P.x", "P.y" of a point, on which clearances have an effect.

    Raises
    ------
    Unusable
        whose key is the name of the dimension.
    """
    pins = {f"{pin}{CLEARANCE}": pin for pin in mechanism.pins}
    result: list[Deviation] = []
    for name, entry in entries.items():
        size = "frame" if name == "D.x" and "D.y" in sizes and "D.x" not in sizes else name
        if name in pins:
            size = _stretched(mechanism, name, pins[name], output)
        elif size not in sizes:
            raise Unusable("unknown dimension", nearest(name, [*sizes, *pins]), name)
        if any(name == other.name or (size == other.size and name not in pins and other.name not in pins) for other in result):
            raise Unusable("a tolerance is given twice", "Give each once", name)
        quantity = quantities.get(size)
        kind = "length" if quantity is None or quantity.in_metres else quantity.kind
        result.append(_deviation(entry, name, size, kind, CONTACT if name in pins else shape))
        low, _ = result[-1].ends
        if quantity is not None and quantity.kind == "length" and -low > LARGEST * sizes[size]:
            raise Unusable("more than half of the dimension itself", "Check its unit", name, entry.text)
    return tuple(result)


def _deviation(entry: ToleranceEntry, name: str, size: str, kind: str, shape: str) -> Deviation:
    if entry.measured:
        try:
            (values,) = read_columns({"csv": entry.source}, entry.folder, {name: "coordinate" if kind == "length" else kind})
        except Unusable as error:
            remedy = error.remedy.replace("the problem file", "the working folder") if entry.folder == Path() else error.remedy
            raise Unusable(error.message, remedy, name, entry.text if error.value is None else error.value) from None
        return Deviation(name, size, kind, max(map(abs, values)), MEASURED, tuple(values), entry.cost)
    with below(name, entry.text):
        value, _ = parse(entry.text, kind)
    if not value > 0.0:
        raise Unusable("a tolerance must be positive; it applies to both sides", EXAMPLE, name, entry.text)
    return Deviation(name, size, kind, value, entry.shape or shape, cost=entry.cost)


def _stretched(mechanism: Mechanism, name: str, pin: str, output: str) -> str:
    """Return the length that the clearance of a pin changes: that of a link which transmits force along its line only.

    By virtual work an output answers to a displacement at a pin as the pin is loaded by a force or torque on the output. The pin
    is one of the link, or of bodies in series with it that only torques load, such as the crank.
    """
    point = output.rpartition(".")[0]
    joined = {b: {p for p, owners in mechanism.pins.items() if b in owners} for b in mechanism.bodies}
    sliding = {body for guide in mechanism.guides for body in guide.bodies}

    def lengths(at: str, without: str = "") -> Iterator[str]:
        for body in mechanism.pins[at] if len(mechanism.pins[at]) == 2 else ():
            if body in (FRAME, without) or body in sliding or len(joined[body]) != 2:
                continue
            link, loaded = mechanism.bodies[body], body in mechanism.owners.get(point, ())
            ends = joined[body] == {link.start, link.end} and (not loaded or point in joined[body])
            if ends and body not in (mechanism.crank.body, output) and isinstance(link.length, str):
                yield link.length
            elif not loaded:
                yield from lengths(next(p for p in joined[body] if p != at), body)

    length = next(lengths(pin), None)
    if length is None:
        message = f"the effect of this clearance{f' on {output}' if output else ''} is not that of the length of one link"
        raise Unusable(message, "Leave it out; `optlink simulate` moves machines with joint clearance", name)
    return length


# Robust objectives: an error with its scatter, as standard deviations, worst case or expected value.
#
# To first order, a deviation d of a dimension changes the error by its derivative times d; the derivatives are those of the
# linkage. An error of one component has the exact scatter of this model. Of a vector, such as the distance of a point from its
# target, the expected square is exact too; its length with scatter is an upper bound by the triangle inequality, the length of
# the mean error plus the root of the sum of the variances of all components, or plus the sum of the lengths of the worst
# changes.

MAX_SIGMAS = 100.0  # standard deviations
WORST, EXPECTED = "worst case", "expected value"
SQUARES, MAXIMUM = ("sum of squares", "rms"), ("max",)  # measures for the expected value, and for the others
SMOOTHED = 1e-8  # of the scale of an error; a programme has sqrt(s^2 + SMOOTHED^2) for |s|, smooth where the scatter s vanishes
_SIGMAS = re.compile(r"([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?) *sigma")
_REMEDY = f'Write robust = "3 sigma" or "{WORST}" with measure = "max", or "{EXPECTED}" with squares'


@dataclass(frozen=True)
class Robust:
    """Robustness: `sigmas` standard deviations or the worst case added to each error, or the expected square of the error."""

    text: str
    sigmas: float = 0.0

    def __str__(self) -> str:
        return self.text

    @property
    def measures(self) -> tuple[str, ...]:
        """Measures that can be combined with it."""
        return SQUARES if self.text == EXPECTED else MAXIMUM

    @property
    def band(self) -> str:
        """Name of the band drawn around an error."""
        return "1 sigma" if self.text == EXPECTED else self.text

    def named(self, measure: str) -> str:
        """Return the name of the robust measure for display."""
        if self.text != EXPECTED:
            return f"{measure} with {self.text}"
        return "root of the expected mean square" if measure == "rms" else f"expected {measure}"


def read_robust(raw: object) -> Robust | None:
    """Read "3 sigma", "worst case" or "expected value".

    Raises
    ------
    Unusable
    """
    if raw is None:
        return None
    text = raw.strip() if isinstance(raw, str) else ""
    if text in (WORST, EXPECTED):
        return Robust(text)
    match = _SIGMAS.fullmatch(text)
    if match is None:
        raise Unusable("this does not state how tolerances are taken into account", _REMEDY)
    sigmas = float(match[1])
    if not 0.0 <= sigmas <= MAX_SIGMAS:
        raise Unusable("out of range", f'Give 0 to {MAX_SIGMAS:g} standard deviations, such as "3 sigma"')
    return Robust(f"{sigmas:g} sigma", sigmas)


Robustness = Annotated[Robust | None, BeforeValidator(read_robust)]


def residuals(
    robust: Robust | None,
    deviations: Sequence[Deviation],
    errors: Sequence[Value],
    slopes: Sequence[Sequence[Value]],
    smoothed: Value = 0.0,
    *,
    separate: bool = False,
) -> list[Value]:
    """Return the residuals at one position, elementwise: the error, or the error with its scatter.

    Parameters
    ----------
    robust : Robust or None
        None: the nominal error only.
    deviations : sequence of Deviation
        Of dimensions; their tolerances may be symbols.
    errors : sequence of float, array or symbol [SI]
        Components of the nominal error.
    slopes : sequence of sequences of float, array or symbol
        For each component the derivatives [1/SI] with respect to the dimension of every deviation.
    smoothed : float or symbol [SI]
        See `SMOOTHED`; 0: none.
    separate : bool
        Whether every component is an error of its own, not one of a vector.

    Returns
    -------
    list [SI]
        Without robustness the error. For sigmas or the worst case of one component, the upper and the lower end of the error
        band: the larger of their magnitudes is that of the mean error plus the scatter; of a vector, the components of its mean
        and its scatter. For the expected value, the mean error and the standard deviation due to every dimension, whose squares
        add up to the expected square of the error.
    """
    if robust is None:
        return list(errors)
    worst = robust.text == WORST
    means = [0.5 * (d.ends[0] + d.ends[1]) if worst else d.mean for d in deviations]
    sizes = [0.5 * (d.ends[1] - d.ends[0]) if worst else d.sigma for d in deviations]
    middle = [error + sum(m * by for m, by in zip(means, own, strict=True)) for error, own in zip(errors, slopes, strict=True)]
    parts = [[size * by for size, by in zip(sizes, own, strict=True)] for own in slopes]
    if robust.text == EXPECTED:
        return [*middle, *(part for own in zip(*parts, strict=True) for part in own)]

    def spread(components: Sequence[Sequence[Value]]) -> Value:
        squares = [sum(part * part for part in own) for own in zip(*components, strict=True)]  # of every deviation
        if worst:
            return sum(np.sqrt(square + smoothed * smoothed) for square in squares)
        return robust.sigmas * np.sqrt(sum(squares) + smoothed * smoothed)

    if separate or len(errors) == 1:
        bands = [(mean, spread([own])) for mean, own in zip(middle, parts, strict=True)]
        return [end for mean, by in bands for end in (mean + by, mean - by)]
    return [*middle, spread(parts)]


def check_robust(robust: Robust | None, measure: str, tolerance_count: int) -> None:
    """Check that the robustness measure is compatible with that of the requirement and that tolerances are defined.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    if robust is None:
        return
    if not tolerance_count:
        remedy = 'Add the section [tolerances], for example coupler = "0.1 mm"'
        raise Unusable("a robust design needs tolerances", remedy, "requirement.robust", robust.text)
    if measure not in robust.measures:
        other = f'robust = "{EXPECTED}"' if measure in SQUARES else 'robust = "3 sigma"'
        message = f'"{robust.text}" is not compatible with measure = "{measure}"'
        raise Unusable(message, f'Write measure = "{robust.measures[0]}", or {other}', "requirement.robust", robust.text)


def sizes_of(parts: Sequence[Value]) -> Value:
    """Return the largest magnitude of the upper and lower end of an error band; elementwise on arrays."""
    return np.max([np.abs(part) for part in parts], axis=0)
