"""Results as documents: each writes everything that it holds, with the problem that it is about, and is read from that alone.

A document has the fields of the result under their names, and further entries, `shown`, which are computed from them:
a design in display units, a verdict in words. A field whose name such an entry takes stands under `state`. All is SI, or the unit
that ends the key; null where there is no finite value.
"""

from __future__ import annotations

import importlib
import json
import math
import re
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from operator import attrgetter
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Protocol, Self, TextIO, overload, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, PlainValidator, TypeAdapter, ValidationError, WithJsonSchema

from optlink.errors import InputError, UnknownName, nearest
from optlink.io import META, SUM, Frozen, Summary, checked, finite, head, keeping, with_check_sum, without
from optlink.problem.enclosed import enclosing
from optlink.problem.file import ProblemFile, read
from optlink.problem.upgrades import ADDED, VERSION_OF_SCHEMAS, upgraded
from optlink.version import VERSION

if TYPE_CHECKING:
    import pandas
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AGAIN = "Solve it again with this version, or use the version of optlink that wrote it"
HEAD = ("schema", "optlink", "problem", "title", "problem_hash", "overrides")
"""First entries of a document, which follow from its problem."""


def _array(value: Any) -> NDArray[np.float64]:
    if not isinstance(value, list) or not all(
        issubclass(kind, (int, float, NoneType)) and kind is not bool for kind in set(map(type, value))
    ):
        raise ValueError("this is not a list of numbers")
    return np.array(value, dtype=np.float64)  # None becomes NaN


def _rows(value: Any) -> NDArray[np.float64]:
    nested = isinstance(value, list) and bool(value) and all(isinstance(row, list) for row in value)
    return np.array([_array(row) for row in value]) if nested else _array(value)


def _equally_long(columns: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    if len({len(values) for values in columns.values()}) > 1:
        raise ValueError("its columns differ in length")
    return columns


_NUMBER: dict[str, Any] = {"anyOf": [{"type": "number"}, {"type": "null"}]}
Number = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value), WithJsonSchema(_NUMBER)]
"""A number, or null where it is not finite."""
Never = Annotated[float, BeforeValidator(lambda value: math.inf if value is None else value), WithJsonSchema(_NUMBER)]
"""A number, or null where it is infinite."""
_LIST = {"type": "array", "items": _NUMBER}
Column = Annotated[NDArray[np.float64], PlainValidator(_array), WithJsonSchema(_LIST)]
"""An array of numbers; null where one is not finite."""
Rows = Annotated[
    NDArray[np.float64], PlainValidator(_rows), WithJsonSchema({"anyOf": [_LIST, {"type": "array", "items": _LIST}]})
]
"""A column, or a table of equally long rows."""
Columns = Annotated[dict[str, Column], AfterValidator(_equally_long)]
"""A table: arrays of equal length by name."""


Source = str | Callable[[Any], Any]
"""An attribute of a result, or a function of it."""


def reports(module: str) -> Any:
    """Import a module of the reports, which are above the results and show every kind of them."""
    return importlib.import_module(f"optlink.presentation.{module}")


@runtime_checkable
class Result(Protocol):
    """What every result of optlink has, whatever else its class adds."""

    kind: ClassVar[str]
    """Kind of result, by which its view is found."""

    @property
    def problem(self) -> ProblemFile:
        """The problem that it is about."""

    @property
    def valid(self) -> bool:
        """Whether all checks of its kind pass: a command exits with code 0."""

    @property
    def status(self) -> str:
        """How it ended, in a word or a few."""

    @property
    def plots(self) -> tuple[str, ...]:
        """Names of the pictures that `plot` draws."""

    @overload
    def plot(self, *, ax: Axes | None = None, angle: float | None = None) -> Axes: ...
    @overload
    def plot(self, name: str) -> Figure: ...
    def plot(self, name: str | None = None, *, ax: Axes | None = None, angle: float | None = None) -> Figure | Axes:
        """Draw the linkage into axes of matplotlib, or a picture by its name.

        Parameters
        ----------
        name : str, optional
            One of `plots`. Default: the linkage.
        ax : Axes, optional
            Axes to draw the linkage into.
        angle : float [rad], optional
            Crank angle of the linkage.
        """

    def animate(self, frames: int = 48) -> FuncAnimation:
        """Return the linkage in motion, which a notebook shows."""

    def to_frame(self, name: str | None = None, *, units: str = "SI") -> pandas.DataFrame:
        """Return a table as a data frame of pandas.

        Parameters
        ----------
        name : str, optional
            Name of the table. Default: the first one.
        units : "SI" or "file"
            SI, or the units of the problem file.
        """

    def to_latex(
        self, buf: str | Path | TextIO | None = None, name: str | None = None, *, columns: Sequence[str] | None = None
    ) -> str:
        """Return a table for LaTeX.

        Parameters
        ----------
        buf : str, Path or TextIO, optional
            File to write it to as well.
        name : str, optional
            Name of a table of columns.
        columns : sequence of str, optional
            Names of the columns.
        """

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON document, with all of this."""

    def write(self, folder: str | Path, pictures: str = "png") -> list[Path]:
        """Write the files that `--out` writes.

        Parameters
        ----------
        folder : str or Path
            Made if it does not exist.
        pictures : str
            Format of the pictures: "png", "svg" or "pdf".
        """


class Renamed:
    """A member of a result that has another name now: it works, with a DeprecationWarning."""

    def __init__(self, successor: str) -> None:
        self.successor = successor

    def __set_name__(self, owner: type[Any], name: str) -> None:
        self.name = name

    def __get__(self, result: Any, owner: type[Any]) -> Any:
        if result is None:
            return self
        warnings.warn(f"{owner.__name__}.{self.name} is now {self.successor}", DeprecationWarning, stacklevel=2)
        return getattr(result, self.successor)


class Document(Summary):
    """Base class of results, dataclasses that write themselves as JSON documents and are read from them; see `Result`."""

    kind: ClassVar[str]
    """Name of the kind of result, in the schema of its documents."""
    shown: ClassVar[Mapping[str, Source]] = {}
    """Computed entries by key; one whose key ends in "?" is left out if it is None."""
    _stored: ClassVar[tuple[str, ...] | None] = None
    """Fields from which the others are computed again when it is read, see `_restored`. Default: all are stored."""

    meta: ClassVar[Mapping[str, Any]] = Frozen()
    """Notes of others: the key `meta` of the stored result from which it was read, which it has again when it is written."""

    problem: ProblemFile
    if TYPE_CHECKING:  # fields of some classes, properties of others

        @property
        def valid(self) -> bool:
            """See `Result`."""

        @property
        def status(self) -> str:
            """See `Result`."""

    def __str__(self) -> str:
        """Return what the command prints: for `print`."""
        printed: str = reports("interface").printed(self)
        return printed

    def _repr_html_(self) -> str | None:
        html: str | None = reports("html.notebook").notebook_html(self)
        return html

    @property
    def plots(self) -> tuple[str, ...]:
        """Names of the pictures that `plot` draws."""
        return tuple(reports("interface").figures(self))

    @overload
    def plot(self, *, ax: Axes | None = None, angle: float | None = None) -> Axes: ...
    @overload
    def plot(self, name: str) -> Figure: ...
    def plot(self, name: str | None = None, *, ax: Axes | None = None, angle: float | None = None) -> Figure | Axes:
        """Draw the linkage of the result with matplotlib, or by its name a picture with charts.

        Parameters
        ----------
        name : str, optional
            One of `plots`. Default: the linkage.
        ax : Axes, optional
            Axes to draw the linkage into. Default: those of a new figure.
        angle : float [rad], optional
            Crank angle of the linkage. Default: that at which the links cover each other least.

        Returns
        -------
        Figure or Axes
            The figure of a picture by name; the axes with the linkage, whose figure is `axes.figure`. `savefig(file)` writes it.

        Raises
        ------
        InputError
            If there is no picture of this name, no linkage that can be drawn in motion, or the crank cannot reach the angle.
        """
        drawn: Figure | Axes = reports("interface").plot(self, name, ax, angle)
        return drawn

    def animate(self, frames: int = 48) -> FuncAnimation:
        """Return the linkage of the result in motion: over a revolution, the range of the drive, or the time of a simulation.

        Parameters
        ----------
        frames : int
            Largest number of pictures.

        Returns
        -------
        FuncAnimation
            Shown by a notebook with buttons; `animation.save("motion.gif", writer="pillow")` writes it.

        Raises
        ------
        InputError
            If the result has no linkage that can be drawn in motion.
        """
        animation: FuncAnimation = reports("interface").animate(self, frames)
        return animation

    def write(self, folder: str | Path, pictures: str = "png") -> list[Path]:
        """Write what `--out` writes: result.json, which `optlink.read_result` reads, tables, the design, pictures.

        Parameters
        ----------
        folder : str or Path
            Made if it does not exist.
        pictures : str
            Format of the pictures: "png", "svg" or "pdf".

        Returns
        -------
        list of Path

        Raises
        ------
        InputError
            If the folder or a file cannot be written.
        """
        paths: list[Path] = reports("interface").write(self, Path(folder), pictures)
        return paths

    def to_frame(self, name: str | None = None, *, units: str = "SI") -> pandas.DataFrame:
        """Return a table of the result as a data frame of pandas, as `--out` writes it to CSV files.

        The unit of a column ends its name; `frame.attrs["units"]` has the unit of each column with one.

        Parameters
        ----------
        name : str, optional
            File name of the table without ending. Default: the first one.
        units : "SI" or "file"
            SI, or the unit that ends the name of a column; "file": the units that stand most often in the problem file; squares
            of angles remain in rad^2.

        Raises
        ------
        InputError
            If pandas is not installed, or there is no such table.
        """
        frame: pandas.DataFrame = reports("interface").to_frame(self, name, units)
        return frame

    def to_latex(
        self, buf: str | Path | TextIO | None = None, name: str | None = None, *, columns: Sequence[str] | None = None
    ) -> str:
        """Return a table of the result for LaTeX, which needs the package booktabs.

        Of a design these are its sizes, its objective and its active constraints, of other results a table of columns, in the
        units of the problem file.

        Parameters
        ----------
        buf : str, Path or TextIO, optional
            File to write it to as well.
        name : str, optional
            Name of a table of columns, as in `to_frame`. Default: that of the design, or the first one.
        columns : sequence of str, optional
            Names of the columns, as `to_frame` has them in SI or in the units of the file. Default: all.

        Raises
        ------
        InputError
            If there is no such table, or the file cannot be written.
        """
        text: str = reports("interface").to_latex(self, buf, name, columns)
        return text

    def to_dict(self) -> dict[str, Any]:
        """Return the result as a JSON document: SI, or the unit that ends the key; null where there is no finite value."""
        if self._stored is not None:
            state = {name: getattr(self, name) for name in self._stored}
        else:
            state = adapter(type(self)).dump_python(self, context={"problem": self.problem}, exclude={"problem"}, warnings=False)
        hidden = hidden_fields(type(self))
        about = head(self.schema(), self.problem, self.status) | {"valid": self.valid, "seed": getattr(self, "seed", None)}
        document = about | dict(entries(self)) | without(state, *hidden)
        if below := keeping(state, *hidden):
            document["state"] = below
        document["problem_file"] = stored_problem(self.problem)
        return with_check_sum(finite(document)) | ({META: finite(dict(self.meta))} if self.meta else {})

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], path: Path) -> Self:
        """Return the result that a document holds.

        Parameters
        ----------
        document : mapping
            From `to_dict`.
        path : Path
            File of the document, for errors.

        Raises
        ------
        InputError
            If the document was changed, or this version reads its problem differently.
        """
        content = checked(document)
        if content is None:
            raise InputError("the result was changed since it was written", AGAIN, str(path), SUM, document.get(SUM))
        meta = document.get(META, {})
        if not isinstance(meta, Mapping):
            raise InputError(
                "the notes of a result are an object", 'Write "meta": {"key": value}, or leave it out', str(path), META, meta
            )
        try:
            content = upgraded(content)
            problem = read_problem(content, path)
            values = content | content["state"] if hidden_fields(cls) else content
            lacking = set(ADDED.get(cls.kind, ())) - values.keys()
            result = cls._restored(problem, {name: values[name] for name in stored_fields(cls) if name not in lacking})
        except InputError:
            raise
        except (KeyError, TypeError, AttributeError, ValueError) as error:  # of another version, whatever its check sum
            message = f"this is not what version {VERSION} writes: it lacks or misreads {_place(error)}"
            raise InputError(message, AGAIN, str(path)) from None
        object.__setattr__(result, META, Frozen(meta))
        return result

    @classmethod
    def _restored(cls, problem: ProblemFile, values: Mapping[str, Any]) -> Self:
        """Return the result for the fields in a document."""
        result: Self = adapter(cls).validate_python({**values, "problem": problem}, context={"problem": problem})
        return result

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """Return the JSON schema of the documents: of their fields; computed entries may be anything."""
        whole = adapter(cls).json_schema(mode="serialization") if cls._stored is None else {}
        parts: dict[str, Any] = whole.get("properties", {name: {} for name in cls._stored or ()})
        hidden, added = hidden_fields(cls), ADDED.get(cls.kind, ())
        properties = {
            "schema": {"const": cls.schema()},
            **{name: {"type": "string"} for name in HEAD[1:5]},
            "overrides": {"type": "object"},
            "seed": {"anyOf": [{"type": "integer"}, {"type": "null"}]},
            "status": {"type": "string"},
            "valid": {"type": "boolean"},
            **{key.rstrip("?"): {} for key in cls.shown},
            **{name: part for name, part in parts.items() if name not in hidden and name != "problem"},
            **({"state": _object(keeping(parts, *hidden), added)} if hidden else {}),
            "problem_file": _object({key: {"type": "string"} for key in ("file", "toml")}),
            SUM: {"type": "string"},
            META: {"type": "object"},
        }
        optional = {META, *added, *(key.rstrip("?") for key in cls.shown if key.endswith("?"))}
        schema = {"title": cls.__name__, **_object(properties, optional), "$defs": whole.get("$defs", {})}
        return finite(schema)  # type: ignore[no-any-return]

    @classmethod
    def schema(cls) -> str:
        """Return the name of the schema."""
        return f"optlink/{cls.kind.replace(' ', '-')}/{VERSION_OF_SCHEMAS}"


class Tabled(Document):
    """Base class of results with columns, which `result["input.torque_Nm"]` returns by their names."""

    columns: Mapping[str, NDArray[np.float64]]

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        try:
            return self.columns[name]  # those of a damaged file refuse the name themselves
        except KeyError:
            raise UnknownName(f"no column {name}", nearest(str(name), self.columns)) from None


_ADAPTERS: dict[type[Any], TypeAdapter[Any]] = {}


def adapter(kind: type[Any]) -> TypeAdapter[Any]:
    """Return what reads and writes the fields of a dataclass; made once, since that takes time."""
    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]


def stored_fields(kind: Any) -> tuple[str, ...]:
    """Return the names of the fields in a document, without the problem."""
    return kind._stored or tuple(item.name for item in fields(kind) if item.init and item.name != "problem")


def hidden_fields(kind: Any) -> frozenset[str]:
    """Return the fields that stand under `state`: those whose names computed entries take, and those that are read alone."""
    return frozenset(kind._stored or set(stored_fields(kind)) & {*HEAD, *(key.rstrip("?") for key in kind.shown)})


def entries(item: Any) -> Iterator[tuple[str, Any]]:
    """Yield the computed entries of a result or of a part of it."""
    for key, source in type(item).shown.items():
        value = (attrgetter(source) if isinstance(source, str) else source)(item)
        if value is not None or not key.endswith("?"):
            yield key.rstrip("?"), plain(value)


def plain(value: Any) -> Any:
    """Return a value as tables and lists: of parts that have computed entries these, of others their fields."""
    if isinstance(getattr(type(value), "shown", None), Mapping):
        return dict(entries(value))
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, list | tuple) else value


def _object(properties: dict[str, Any], optional: Collection[str] = ()) -> dict[str, Any]:
    """Return the schema of an object with these keys; later versions may add others."""
    required = [name for name in properties if name not in optional]
    return {"type": "object", "properties": properties, "required": required}


def _place(error: Exception) -> str:
    """Return the key of a document at which its reading failed."""
    if isinstance(error, ValidationError):
        return ".".join(map(str, error.errors()[0]["loc"]))
    return str(error.args[0]) if isinstance(error, KeyError) else "an entry"


def stored_problem(problem: ProblemFile) -> dict[str, Any]:
    """Return a problem as a document contains it: its text with all changes, and with the files to which it refers."""
    tables, _ = enclosing(problem.raw, problem.folder, problem.files)
    return {"file": problem.file_name, "toml": "\n".join(_toml_lines(tables)) + "\n"}


def _toml_lines(table: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Yield the lines of a table in TOML with its keys in their order, on which that of design variables depends.

    Tables behind the last other value are sections, those before it stand in one line.
    """
    last = max((k for k, value in enumerate(table.values()) if not isinstance(value, Mapping)), default=-1)
    items = [(_toml_key(key), value) for key, value in table.items()]
    if not path:  # sections have no order
        items.sort(key=lambda item: isinstance(item[1], Mapping))
        last = sum(not isinstance(value, Mapping) for value in table.values()) - 1
    yield from (f"{key} = {_toml_value(value)}" for key, value in items[: last + 1])
    for key, value in items[last + 1 :]:
        yield f"\n[{path}{key}]"
        yield from _toml_lines(value, f"{path}{key}.")


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False)


def _toml_value(value: Any) -> str:
    """Return a value in one line."""
    import tomli_w

    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_toml_key(key)} = {_toml_value(item)}' for key, item in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml_value, value))}]"
    return tomli_w.dumps({"value": value}).removeprefix("value = ").rstrip("\n")


def read_problem(document: Mapping[str, Any], path: Path) -> ProblemFile:
    """Return the problem that a document contains.

    Raises
    ------
    InputError
        If this version reads it differently.
    """
    stored = document["problem_file"]
    try:
        problem = read(stored["toml"], document["problem"], stored["file"], Path())
    except InputError as error:
        remedy = "If it is a function of yours, define it before: run its cell"
        faults = [replace(fault, remedy=remedy) if (fault.key or "").endswith("quantity") else fault for fault in error.faults]
        raise InputError(faults) from None
    if problem.hash != document["problem_hash"]:
        message = f"version {document['optlink']} read its problem otherwise than version {VERSION}"
        raise InputError(message, AGAIN, str(path), "problem_hash", document["problem_hash"])
    return replace(problem, overrides=document["overrides"])


def read_document(path: Path) -> dict[str, Any]:
    """Read the JSON object of a result file.

    Raises
    ------
    InputError
        If the file cannot be read or is not a JSON object.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or "it is not a JSON document"
        remedy = "Give a stored result.json, the folder it is in, or a problem"
        raise InputError(f"cannot read a result: {reason}", remedy, str(path)) from None
    if not isinstance(document, dict):
        raise InputError("not a result of optlink", "Give a result.json that --out wrote", str(path))
    return document
