"""Options with one meaning, each stated once: functions take them as `Unpack[Execution]`, commands have their help from here."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypedDict, get_type_hints


class Execution(TypedDict, total=False):
    """Where independent pieces of work run; the result does not depend on it."""

    engine: Annotated[str, "local (default: processes of this computer) or dask."]
    workers: Annotated[int | None, "Number of processes. Default: all cores."]
    scheduler: Annotated[str | None, "With the engine dask: address of a running scheduler. Default: a cluster of this computer."]


class Checkpoints(TypedDict, total=False):
    """How far a long run is, and how one that was interrupted continues."""

    progress: Annotated[Callable[[float], None] | None, "Function of the completed fraction."]
    checkpoint: Annotated[
        Callable[[dict[str, Any]], None] | None, "Function of a JSON-compatible document of what is complete, for `resume`."
    ]
    resume: Annotated[
        Mapping[str, Any] | None,
        "Document of a checkpoint: the run continues from there, with results identical to those of an uninterrupted run.",
    ]


class ResumableExecution(Execution, Checkpoints, total=False):
    """Where the runs of a long series run, and how it continues: all of `optlink.Execution` and `Checkpoints`."""


def meaning(options: type[Any], name: str) -> str:
    """Return what an option is."""
    return str(get_type_hints(options, include_extras=True)[name].__metadata__[0])
