"""Analyse thousands of designs of one machine in one call: selected columns of the analysis, in cache-sized blocks."""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.machine import Machine
from optlink.errors import InputError
from optlink.linkage.alignment import near_singular, positions_text
from optlink.linkage.continuation import continue_through_singularities
from optlink.linkage.extrema import extremes_of_rows
from optlink.linkage.motion import sweep
from optlink.linkage.stroke import reachable
from optlink.linkage.vector2d import TURN, Array, Value
from optlink.problem.arguments import typed
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import check_choice, check_range
from optlink.tasks.analyze import GRID, MAX_POINTS, chord_shares
from optlink.tasks.machine import check_repeats, crank_speed, machine_of

BLOCK_SIZE = 12_000
"""Positions per block: a few dozen intermediate arrays of this size fit in the processor's cache."""

LARGE_BATCH = 60_000
"""Positions per block of `batch_extremes`, whose refinement takes many short calls."""

MIN_SINE = 0.1
"""Least sine of every group (of a transmission angle 5.7 deg) above which a design is far from singular positions, also between
the samples."""


CHORD_TOLERANCE = 1e-9
"""Share of the largest force below which a difference of its least values is rounding error."""

SAMPLES = 360
"""Crank angles per revolution, at least, at which designs are examined for singular positions."""


class Columns(dict[str, Array]):
    """Columns by name, arrays (designs, points); `singular`: message by design index where the motion is not determined."""

    def __init__(self) -> None:
        super().__init__()
        self.singular: dict[int, str] = {}


@typed
def analyze_batch(
    problem: ProblemFile,
    designs: Mapping[str, ArrayLike],
    columns: Sequence[str] = ("input.torque_Nm",),
    points: int = 360,
    speed: float | None = None,
) -> Columns:
    """Analyse many designs of a machine at once and return selected columns.

    Parameters
    ----------
    problem : ProblemFile
        From `optlink.load`.
    designs : mapping of str to array (designs,) [SI]
        Values by the name of the dimension, for example {"coupler.length": [0.14, 0.15]}; `optlink show` lists the names. Other
        dimensions keep the value of the problem.
    columns : sequence of str
        Names as in `Analysis.columns`.
    points : int
        Number of crank angles per revolution, starting at `drive.start`; the last one lies one step before the full revolution. A
        machine whose motion or loads repeat after several revolutions has all those of the longest cycle of all designs.
    speed : float [rad/s], optional
        Crank speed. Default: that of the problem.

    Returns
    -------
    Columns
        Arrays (designs, points of all revolutions) by name. A value is NaN where the design cannot be assembled. All values of a
        design are NaN if a load acts in the slow stroke and the design has none, or if the motion is not determined beyond a
        singular position (`singular` contains the message). Apart from these arrays, memory does not grow with the number of
        designs.

    Raises
    ------
    InputError
        For unknown quantities or columns, arrays of different length, or values that are not finite.

    Examples
    --------
    >>> lengths = {"coupler.length": [0.14, 0.15, 0.16]}  # [m]
    >>> columns = optlink.analyze_batch(optlink.load("shaper"), lengths, ["input.torque_Nm"])
    >>> columns["input.torque_Nm"].shape
    (3, 360)
    """
    check_range("points", points, 1, MAX_POINTS)
    arrays = _read(problem, designs)
    count = len(next(iter(arrays.values())))
    drive = problem.model.drive
    direction = crank_speed(problem, speed)
    follows = problem.model.mechanism.follows
    given = machine_of(problem)
    check_repeats(problem, given)
    revolutions = math.lcm(_longest_cycle(problem, arrays) if follows else 1, given.revolutions or 1)
    angles = drive.start.value + np.copysign(TURN, direction) * np.arange(revolutions * points) / points
    available = MotionColumns(given.moving(angles[:1], direction)).columns
    for name in columns:
        check_choice("columns", name, available, "no such column", problem.file)
    result = Columns()
    result.update({name: np.empty((count, len(angles))) for name in columns})
    samples = angles if points >= SAMPLES else drive.start.value + TURN * np.arange(revolutions * SAMPLES) / SAMPLES
    step = 1 if follows else max(1, BLOCK_SIZE // points)
    for first in range(0, count, step):
        for part, defined in _by_slow_stroke(problem, arrays, np.arange(first, min(first + step, count)), single=follows):
            if not defined:
                for name in columns:
                    result[name][part] = np.nan
                continue
            machine = machine_of(problem, _designs(arrays, part, single=follows))
            record = MotionColumns(machine.moving(angles, direction))
            for name in columns:
                result[name][part] = record[name]
            result.singular |= _singular(machine, part, samples)
    for name in columns:
        result[name][list(result.singular)] = np.nan
    return result


def _singular(machine: Machine, part: NDArray[np.intp], angles: Array) -> dict[int, str]:
    """Return for designs whose motion is not determined, by index, the reason."""
    suspects = near_singular(sweep(machine.mechanism, machine.sizes, angles).pose, angles)
    reasons = {}
    for k in np.flatnonzero(suspects):
        sizes = {name: float(np.ravel(size)[k if np.size(size) > 1 else 0]) for name, size in machine.sizes.items()}
        singular = reachable(machine.mechanism, sizes).singular
        if singular:
            reasons[int(part[k])] = (
                f"singular position at crank angle {positions_text(singular)}: the motion beyond it is not determined"
            )
    return reasons


def _designs(arrays: Mapping[str, Array], part: NDArray[np.intp], *, single: bool) -> dict[str, Value]:
    """Return the quantities of a block of designs as arrays (designs, 1), or as numbers of its only design."""
    return {name: float(values[part[0]]) if single else values[part, None] for name, values in arrays.items()}


def _longest_cycle(problem: ProblemFile, arrays: Mapping[str, Array]) -> int:
    """Return the number of revolutions of the longest cycle of all designs."""
    model, count = problem.model, len(next(iter(arrays.values())))
    start, designs = model.drive.start.value, (_designs(arrays, np.array([k]), single=True) for k in range(count))
    turns = (continue_through_singularities(model.linkage, model.sizes(design), start).cycle / TURN for design in designs)
    return max(map(round, turns))


def _by_slow_stroke(
    problem: ProblemFile, arrays: Mapping[str, Array], part: NDArray[np.intp], *, single: bool
) -> Iterator[tuple[NDArray[np.intp], bool]]:
    """Group the designs of a block by the direction of their slow strokes, with whether every load that needs one has one."""
    if not any(load.by_pace for load in problem.model.loads.values()):
        yield part, True
        return
    senses = problem.model.slow_senses(_designs(arrays, part, single=single))
    senses = np.broadcast_to(senses, (len(senses), len(part)))
    keys, group = np.unique(senses, axis=1, return_inverse=True)
    for k, key in enumerate(keys.T):
        yield part[np.ravel(group) == k], bool(np.all(key != 0.0))


def batch_extremes(
    problem: ProblemFile, designs: Mapping[str, ArrayLike], columns: Sequence[str]
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """Return exact extremes of columns over the revolution for many designs at once, as those of `optlink.analyze`.

    The machine must have no loads that jump (`Machine.switching`) or have corners (`Machine.cornered`). Columns are those of
    `Analysis.columns` except angles of bodies, or `B.f_N` for the magnitude of a reaction.

    Returns
    -------
    extremes : mapping of str to array (designs, 2), of the least and the largest value
    clear : array (designs,) of bool
        Designs that are clear of singular positions, and have the least of each reaction beside its smallest sample. The
        extremes of the others are meaningless.
    """
    arrays = _read(problem, designs)
    count = len(next(iter(arrays.values())))
    drive = problem.model.drive
    direction, start = crank_speed(problem), drive.start.value
    given = machine_of(problem)
    check_repeats(problem, given)
    step, revolutions = TURN / GRID, given.revolutions or 1
    first_angle = min(start, start + math.copysign(TURN * revolutions, direction))
    grid = np.asarray(first_angle + step * np.arange(GRID * revolutions + 1), dtype=float)
    extremes = {name: np.full((count, 2), np.nan) for name in columns}
    clear = np.zeros(count, dtype=bool)
    portion = max(1, LARGE_BATCH // (len(grid) - 1))
    for first in range(0, count, portion):
        machine = machine_of(problem, {name: values[first : first + portion, None] for name, values in arrays.items()})
        moving = machine.moving(grid, direction)
        record = MotionColumns(moving)
        with np.errstate(all="ignore"):
            regular = [np.min(np.abs(record.full(sine)), axis=1) > MIN_SINE for sine in record.reactions.singularity.values()]
            regular.append(np.all(moving.motion.assembled, axis=1))
        regular += [np.all(np.isfinite(record[part]), axis=1) for name in columns for part in reaction_parts(name)]
        numbers = first + np.flatnonzero(np.all(regular, axis=0))
        clear[numbers] = True
        if numbers.size:
            batch_machine = machine_of(problem, {name: values[numbers, None] for name, values in arrays.items()})
            for name in columns:
                extremes[name][numbers] = extremes_of_rows(functools.partial(_column, batch_machine, direction, name), grid)
                if len(parts := reaction_parts(name)) == 2:
                    force = np.array([record[part][numbers - first] for part in parts])
                    clear[numbers] &= ~_smaller_elsewhere(force, extremes[name][numbers, 0])
    return extremes, clear


def _smaller_elsewhere(force: Array, least: Array) -> NDArray[np.bool_]:
    """Return the designs whose force (2, designs, n) almost vanishes between samples, but not beside its smallest one.

    Its least magnitude (designs,) then lies elsewhere than the refined minimum at that sample.
    """
    size, last = np.hypot(*force), force.shape[-1] - 1
    share = np.nan_to_num(np.clip(chord_shares(force), 0.0, 1.0))
    chord = np.hypot(*(force[..., :-1] + share * np.diff(force, axis=-1)))
    lowest, smallest = np.argmin(chord, axis=1), np.argmin(size[:, :last], axis=1)  # the last sample is the first one again
    at_smallest = (lowest == smallest) | (lowest == (smallest - 1) % last)
    return np.asarray(~at_smallest & (np.min(chord, axis=1) < least - CHORD_TOLERANCE * np.max(size, axis=1)))


def reaction_parts(name: str) -> tuple[str, ...]:
    """Return the columns whose root sum square is the named column: reaction components, else the column itself."""
    return (f"{name[:-4]}.fx_N", f"{name[:-4]}.fy_N") if name.endswith(".f_N") else (name,)


def _column(machine: Machine, speed: float, name: str, angles: Array) -> Array:
    """Return a column of a batch of designs at crank angles (1, n) or (designs, n)."""
    record = MotionColumns(machine.moving(angles, speed))
    values = [record[part] for part in reaction_parts(name)]
    return values[0] if len(values) == 1 else np.hypot(*values)


def _read(problem: ProblemFile, designs: Mapping[str, ArrayLike]) -> dict[str, Array]:
    quantities = problem.model.mechanism.quantities
    try:
        arrays = {name: np.atleast_1d(np.asarray(values, dtype=float)) for name, values in designs.items()}
    except (TypeError, ValueError) as error:
        raise InputError(f"not an array of numbers: {error}", "Give SI values by name", problem.file, "designs") from None
    if not arrays:
        raise InputError("no quantity is varied", f"Name one of: {', '.join(quantities)}", problem.file, "designs")
    sizes = {len(values) for values in arrays.values()}
    for name, values in arrays.items():
        check_choice("designs", name, quantities, "unknown quantity", problem.file)
        if values.ndim != 1 or len(sizes) > 1:
            raise InputError("one value per design is needed", "Give arrays of one length", problem.file, name)
        if not np.all(np.isfinite(values)) or (quantities[name].kind == "length" and np.any(values <= 0.0)):
            raise InputError("not a size", "Give finite values, lengths above zero", problem.file, name)
    return arrays
