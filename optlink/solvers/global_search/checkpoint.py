"""Checkpoints of branch and bound: what an interrupted search needs to continue, with the same bound in the end."""

import json
import math
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from optlink.errors import InputError
from optlink.io import whole
from optlink.solvers.global_search.branch_and_bound import Boxes, BranchAndBound

FILE = "certificate-search.npz"
EVERY = 20.0  # seconds between two checkpoints
PARTS = ("low", "high", "test", "multipliers")
REMEDY = "Start again without --resume"


@dataclass
class Checkpoint:
    """The file of a search.

    Parameters
    ----------
    path : Path
    about : mapping
        What the search is about; one that continues must have the same.
    """

    path: Path
    about: Mapping[str, Any]
    written: float = field(default_factory=time.monotonic)

    def due(self) -> bool:
        """Return whether it is time to write."""
        return time.monotonic() - self.written > EVERY

    def write(self, searches: Sequence[BranchAndBound], design: Mapping[str, float]) -> None:
        """Write the state of the searches, one for each assembly mode, and the best design [SI].

        Parameters
        ----------
        searches : sequence of BranchAndBound
        design : mapping of str to float
        """
        arrays: dict[str, Any] = {}
        states = []
        for k, search in enumerate(searches):
            for name in ("open", "tiny"):
                boxes = getattr(search, name)
                arrays |= {f"{k}.{name}.{part}": getattr(boxes, part) for part in ("low", "high", "bound")}
            arrays |= {f"{k}.leaves.{part}": np.concatenate(parts) for part in PARTS if (parts := getattr(search.leaves, part))}
            states.append(
                {
                    "best": search.best if math.isfinite(search.best) else None,
                    "discarded": search.discarded if math.isfinite(search.discarded) else None,
                    "boxes": search.boxes,
                    "count": search.leaves.count,
                    "history": search.history,
                }
            )
        document = {**self.about, "design": dict(design), "searches": states}
        with whole(self.path) as temporary:
            np.savez(temporary, document=np.array(json.dumps(document)), **arrays)
        self.written = time.monotonic()

    def read(self, searches: Sequence[BranchAndBound]) -> dict[str, float]:
        """Restore the state of the searches; return the best design [SI].

        Parameters
        ----------
        searches : sequence of BranchAndBound

        Raises
        ------
        InputError
            If there is no checkpoint, it is damaged, or it belongs to another search.
        """
        try:
            with self.path.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            document = json.loads(str(arrays.pop("document")))
            other = next((name for name, value in self.about.items() if document.get(name) != value), None)
            if other is None:
                for k, (search, state) in enumerate(zip(searches, document["searches"], strict=True)):
                    _restore(search, state, {name: arrays.get(f"{k}.{name}") for name in _NAMES})
                return {str(name): float(value) for name, value in document["design"].items()}
        except FileNotFoundError:
            message = "there is no interrupted certificate in this folder"
            raise InputError(message, REMEDY, str(self.path.parent), "--resume") from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile):
            raise InputError("the checkpoint of the proof is damaged", REMEDY, str(self.path), "--resume") from None
        message = f"the interrupted proof is that of another command: its {other} is {document.get(other)!r}"
        raise InputError(message, f"{REMEDY}, or with {other} {self.about[other]!r}", str(self.path), "--resume")


_NAMES = [*(f"{name}.{part}" for name in ("open", "tiny") for part in ("low", "high", "bound")), *(f"leaves.{p}" for p in PARTS)]


def _restore(search: BranchAndBound, state: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    n = len(search.bounder.low)
    for name in ("open", "tiny"):
        low, high, bound = (np.asarray(arrays[f"{name}.{part}"], dtype=float) for part in ("low", "high", "bound"))
        if (
            low.shape != high.shape
            or low.shape != (len(bound), n)
            or not np.all(np.isfinite([*low.flat, *high.flat, *bound.flat]))
        ):
            raise ValueError(name)
        setattr(search, name, Boxes(low, high, bound))
    for part in PARTS:
        values = arrays[f"leaves.{part}"]
        setattr(search.leaves, part, [] if values is None else [values])
    search.leaves.count = int(state["count"])
    search.boxes = int(state["boxes"])
    search.best, search.discarded = (math.inf if state[name] is None else float(state[name]) for name in ("best", "discarded"))
    search.history = [(int(boxes), float(lower), float(best)) for boxes, lower, best in state["history"]]
