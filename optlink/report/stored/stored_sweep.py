"""Reading of a stored parameter sweep with its table."""

import csv
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from optlink.errors import InputError
from optlink.execution.store import TABLE
from optlink.problem.base_model import AGAIN, LARGEST, Contradiction
from optlink.problem.file import ProblemFile
from optlink.studies.grid import Axis, AxisRecord, Grid
from optlink.studies.sweep import CHANGED, TEXT, Sweep, SweepRecord
from optlink.studies.sweep_task import OPTIMISE

FLAGS = ("valid", CHANGED)


def read(record: SweepRecord, file: ProblemFile, result_file: Path) -> Sweep:
    """Read the table of a stored sweep, beside its file or otherwise where the record locates it.

    Parameters
    ----------
    file : ProblemFile
        The problem of the study.
    result_file : Path
        File of the record.

    Raises
    ------
    InputError
        If the table is missing or belongs to another sweep.
    Contradiction
        If the record does not fit its table.
    """
    path = result_file.parent / TABLE
    path = path if path.is_file() or record.table is None else Path(record.table)
    names, count = record.columns, record.points
    try:
        with path.open(encoding="utf-8", newline="") as table_file:
            rows = csv.reader(table_file)
            head = next(rows, [])
            columns = list(zip(*rows, strict=True))
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "its rows differ in length"
        raise InputError(f"cannot read the table of the sweep: {reason}", AGAIN, str(path)) from None
    if tuple(head) != names or len(columns) != len(names) or len(columns[0]) != count:
        raise InputError("the table is not that of this sweep", AGAIN, str(path))
    table = dict(zip(names, map(list, columns), strict=True))
    for name in names:
        if name not in TEXT + FLAGS:
            _check_numbers(path, name, table[name])
    grid = Grid(tuple(_axis(one, k, table) for k, one in enumerate(record.axes)))
    if grid.count != count:
        raise Contradiction("axes", f"their values make {grid.count} points, the table has {count}")
    if record.mode == OPTIMISE and not any(name.startswith("objective") for name in names):
        raise Contradiction("columns", "there is no objective")
    shown = [axis.column for axis in grid.axes] + [name for name in names if name.startswith("objective")]
    if record.best is not None and (lacking := [name for name in shown if name not in record.best]):
        raise Contradiction("best", f"it has no {lacking[0]}")
    return record.build(
        Sweep,
        problem=file,
        grid=grid,
        path=path,
        valid=table["valid"].count("true"),
        statuses=Counter(table.get("status", [])),
        searched=record.searched_points or 0,
        changed=record.active_set_changes or 0,
        changes=record.changes or (),
    )


def _check_numbers(path: Path, name: str, texts: list[str]) -> None:
    for row, text in enumerate(texts):
        try:
            sound = not abs(float(text or "nan")) > LARGEST
        except ValueError:
            sound = False
        if not sound:
            raise InputError(f"row {row + 1} of the table contains no number", AGAIN, str(path), name, text)


def _axis(record: AxisRecord, k: int, table: Mapping[str, list[str]]) -> Axis:
    axis = Axis(record.key, record.unit, ())
    values = tuple(dict.fromkeys(float(text) for text in table.get(axis.column, [])))
    if len(values) != record.values:
        raise Contradiction(f"axes[{k}].values", f"the table has {len(values)} values of it", record.values)
    return Axis(axis.key, axis.unit, values)
