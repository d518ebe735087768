"""Four-bars for a hand-drawn curve: a path problem of its points, and the best designs of a short search."""

import contextlib
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from optlink.errors import InputError, Status
from optlink.io import finite
from optlink.linkage.vector2d import Array
from optlink.problem.file import ProblemFile
from optlink.problem.machine.model import FORMAT
from optlink.studio.design import UNVERIFIED, Design
from optlink.studio.document import Document, from_text
from optlink.studio.picture import Picture
from optlink.synthesis.batch_search import Candidate, Searcher
from optlink.tasks.results.design import LinkageDesign
from optlink.tasks.results.fit import FAIR
from optlink.tasks.search import DesignCollection, Polisher
from optlink.validation import validate as validate_path

MAX_CURVE_POINTS = 10_000  # points of a curve
POINTS = 16  # target points along it
MAX_LINK, MIN_LINK = 4.0, 0.05  # largest and least length of a link, as a share of the size of the curve
TIME_LIMIT = 4.5  # of the search
SHOWN_DESIGNS = 4  # designs
MAX_COARSE = 12  # candidates of the first round of which valid ones are shown before they are refined
MIN_SIZE = 1e-3  # mm
ROUNDS = 12
ARM_REACH, ARM = 2.0, 1.8  # distance of the pivot of an arm from the middle of a curve, length of the arm, in radii of the curve


def curve_problem(points: Any, *, closed: bool) -> Document:
    """Return a path problem for points [x, y] in mm; a closed curve leads back to its first point.

    Raises
    ------
    InputError
        If there are too few or too many points, or they do not differ.
    """
    if not isinstance(points, list) or not 3 <= len(points) <= MAX_CURVE_POINTS:
        raise InputError("a curve has from 3 to 10,000 points", "Draw it again", key="draw")
    try:
        line = np.array(points, dtype=float)
    except (TypeError, ValueError):
        line = np.zeros(0)
    if line.ndim != 2 or line.shape[1] != 2 or not np.all(np.abs(line) <= 1e6):
        raise InputError("a point of a curve has two coordinates of at most 1e6 mm", "Draw it again", key="draw")
    places = np.round(_along(line, closed=closed), 6)
    size, centre = float(np.max(np.ptp(places, axis=0))), places.mean(axis=0)
    if not size > MIN_SIZE:
        raise InputError("the curve is smaller than 0.001 mm", "Draw a larger one", key="draw")
    far, least = f"{MAX_LINK * size:.4g}", f"{MIN_LINK * size:.4g}"
    sides = [f'{{ bounds = ["{c - MAX_LINK * size:.6g} mm", "{c + MAX_LINK * size:.6g} mm"] }}' for c in centre]
    rows = ",\n".join(f'    ["{x!r} mm", "{y!r} mm"]' for x, y in places.tolist())
    links = "\n".join(f'{name} = {{ bounds = ["{least} mm", "{far} mm"] }}' for name in ("crank", "coupler", "rocker", "frame"))
    text = f'''format = {FORMAT}
title = "A drawn curve"

# A four-bar whose coupler point P passes these points in order, at free crank angles.
[mechanism]
type = "four-bar"
{links}
points = {{ P = [{{ bounds = ["-{far} mm", "{far} mm"] }}, {{ bounds = ["-{far} mm", "{far} mm"] }}] }}
pivot = [{sides[0]}, {sides[1]}]
direction = {{ bounds = ["-180 deg", "180 deg"] }}
assembly = "either"

[requirement]
kind = "path"
point = "P"
closed = {str(closed).lower()}
points = [
{rows},
]

[limits]
transmission_angle = ["20 deg", "160 deg"]
link_ratio = [0.05, 20.0]
'''
    return from_text(text, "drawn-curve")


def six_bar_problem(four_bar: LinkageDesign) -> Document:
    """Return the path problem of a four-bar for a Stephenson six-bar: its search starts with the curve of the four-bar."""
    stated, values = four_bar.problem.raw["requirement"], four_bar.values
    places = 1e3 * four_bar.measured.generated
    size, centre = float(np.max(np.ptp(places, axis=0))), places.mean(axis=0)
    far = MAX_LINK * size

    def free(start: float, low: float, high: float) -> str:
        return f'{{ start = "{start:.6g} mm", bounds = ["{low:.6g} mm", "{high:.6g} mm"] }}'

    def length(start: float) -> str:
        return f"length = {free(start, MIN_LINK * size, far)}"

    def pair(at: Any, middle: Any = (0.0, 0.0)) -> str:
        return f"[{', '.join(free(start, m - far, m + far) for start, m in zip(at, middle, strict=True))}]"

    first = 1e3 * np.array([values["A.x"], values["A.y"]])
    second = first + 1e3 * values["frame"] * np.array([math.cos(values["direction"]), math.sin(values["direction"])])
    traced = np.array([at for at in _item(four_bar)["curve"] if at is not None])
    middle = 0.5 * (traced.min(axis=0) + traced.max(axis=0))
    radius = float(np.max(np.hypot(*(traced - middle).T)))
    away = middle - 0.5 * (first + second)
    third = middle + ARM_REACH * radius * away / (math.hypot(*away) or 1.0)  # link and arm reach every point of the curve
    arm = min(ARM * radius, far)
    carried = 1e3 * np.array([values["P.along"], values["P.across"]])
    crank, coupler, rocker = (length(1e3 * values[name]) for name in ("crank", "coupler", "rocker"))
    rows = ",\n".join(f'    ["{x}", "{y}"]' for x, y in stated["points"])
    text = f'''format = {FORMAT}
title = "A drawn curve, with a six-bar"

# The coupler of the four-bar A-B-C-D carries the joint E of a link, which an arm guides. The point P of this link
# passes these points in order, at free crank angles. The search starts with P in E: the curve of the four-bar.
[mechanism.ground]
A = {pair(first, centre)}
D = {pair(second, centre)}
F = {pair(third, centre)}

[mechanism.links]
crank = {{ joints = ["A", "B"], {crank} }}
coupler = {{ joints = ["B", "C"], {coupler}, points = {{ E = {pair(carried)} }} }}
rocker = {{ joints = ["D", "C"], {rocker} }}
link = {{ joints = ["E", "G"], {length(arm)}, points = {{ P = {pair((0.0, 0.0))} }} }}
arm = {{ joints = ["F", "G"], {length(arm)} }}

[mechanism.assembly]
C = "{four_bar.assembly} of B-D"
G = "left of E-F"

[requirement]
kind = "path"
point = "P"
closed = {str(stated["closed"]).lower()}
points = [
{rows},
]

[limits]
transmission_angle = ["20 deg", "160 deg"]
'''
    return from_text(text, "drawn-curve")


def _along(line: Array, *, closed: bool) -> Array:
    """Return evenly spaced points along a polyline; of a closed one the first is not repeated."""
    if closed:
        line = np.vstack([line, line[:1]])
    steps = np.hypot(*np.diff(line, axis=0).T)
    distinct = np.concatenate([[True], steps > 0.0])
    line, at = line[distinct], np.concatenate([[0.0], np.cumsum(steps[steps > 0.0])])
    if len(line) < 2:
        return line
    places = np.linspace(0.0, at[-1], POINTS, endpoint=not closed)
    return np.column_stack([np.interp(places, at, line[:, k]) for k in (0, 1)])


class _TimeExceeded(Exception):
    """The time limit of a search is exceeded."""


class _TimedPolisher(Polisher):
    """A polisher that starts only refinements that will probably finish in the time `left` [s], and passes valid ones on."""

    def __init__(self, files: list[ProblemFile], left: Callable[[], float], valid: Callable[[LinkageDesign], None]) -> None:
        super().__init__(files, "ipopt")
        self.left, self.valid, self._longest = left, valid, 0.0

    def polish(self, candidate: Candidate, *, near: bool = False) -> LinkageDesign:
        begun = self.left()
        if begun <= self._longest:
            raise _TimeExceeded
        design = super().polish(candidate, near=near)
        self._longest = max(self._longest, begun - self.left())
        if design.valid:
            self.valid(design)
        return design


class CurveSearch:
    """A search of four-bars for a drawn curve: first coarse candidates, then refined ones, until its time [s] is over."""

    def __init__(self, document: Document, seconds: float = TIME_LIMIT) -> None:
        self.document, self.begun, self._limit = document, time.perf_counter(), seconds
        self._files = document.problem.variants()
        self._searcher = Searcher([file.spec for file in self._files], 0)
        self._polisher = _TimedPolisher(self._files, lambda: seconds - self._seconds, self._first)
        self._collection = DesignCollection(self._polisher, SHOWN_DESIGNS)
        self._coarse: list[tuple[LinkageDesign, Candidate]] = []
        self.designs: list[LinkageDesign] = []
        self._show: Callable[[bool], None] = lambda done: None

    def run(self, show: Callable[[bool], None]) -> None:
        """Search; call `show` with whether the search is over, whenever there are better designs."""
        self._show = show
        coarse = self._searcher.coarse()
        self._add_coarse(coarse, 1)
        self._better()
        with contextlib.suppress(_TimeExceeded):  # a slow machine: no design yet
            for candidate in () if self.designs else coarse[:1]:
                self._polisher.polish(candidate)  # shown if it is valid
        for number in range(ROUNDS):
            begun = self._seconds
            candidates = self._searcher.advance()
            if number == 0:
                self._add_coarse(candidates.candidates, SHOWN_DESIGNS)
                self._better()
            try:
                self._collection.add(candidates)
            except _TimeExceeded:
                break
            if 2.0 * self._seconds - begun > self._limit:
                break
            self._better()
        self._better(done=True)

    def _first(self, design: LinkageDesign) -> None:
        if not self.designs:
            self.designs = [design]
            self._show(False)

    @property
    def _seconds(self) -> float:
        return time.perf_counter() - self.begun

    def _add_coarse(self, candidates: list[Candidate], count: int) -> None:
        """Add some distinct valid candidates before their refinement; the first ones of a list are its best."""
        self._coarse = []
        for candidate in candidates[:MAX_COARSE]:
            design = self._rated(candidate)
            if design.valid and not any(design.alike(known) for known, _ in self._coarse):
                self._coarse.append((design, candidate))
                if len(self._coarse) == count:
                    return

    def _rated(self, candidate: Candidate) -> LinkageDesign:
        """Return a candidate, validated."""
        file, batch = self._files[candidate.variant], self._searcher.batches[candidate.variant]
        task = file.spec
        scaled = zip(batch.names, batch.origin, batch.scale, candidate.x, strict=True)
        values = task.design({name: float(origin + scale * x) for name, origin, scale, x in scaled})
        checked = validate_path(task, values, candidate.t)
        return LinkageDesign(file, values, candidate.t, checked.objective, Status.NOT_SEARCHED, checked)

    def _better(self, *, done: bool = False) -> None:
        """Show the best designs, those of the optimiser before coarse ones, if they have changed."""
        before, best = self.designs, list(self._collection.designs)
        best += [design for design, _ in self._coarse if not any(design.alike(known) for known in best)]
        self.designs = sorted(best, key=_largest_error)[:SHOWN_DESIGNS] or before
        if self.designs and (done or self.designs != before):
            self._show(done)

    def message(self, ident: int, *, done: bool) -> dict[str, Any]:
        """Return the designs as a message that answers a request."""
        items = [_item(design) for design in self.designs]
        fit = self.designs[0].fit if done and items else None
        poor = fit is not None and _largest_error(self.designs[0]) > FAIR * fit.size
        return {"type": "candidates", "id": ident, "done": done, "seconds": round(self._seconds, 3), "items": items, "poor": poor}

    def six_bar(self) -> Document:
        """Return the problem of a six-bar for the curve.

        Raises
        ------
        InputError
            If no four-bar was found.
        """
        if not self.designs:
            raise InputError("there is no four-bar to extend", "Draw the curve again", key="candidate")
        return six_bar_problem(self.designs[0])

    def design(self, index: Any) -> Design:
        """Return one of the designs.

        Raises
        ------
        InputError
            If there is none with this number.
        """
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(self.designs):
            raise InputError("no such candidate", "Draw the curve again", key="candidate", value=index)
        found = self.designs[index]
        candidate = next((candidate for design, candidate in self._coarse if design is found), None)
        if candidate is not None:
            refined = Polisher.polish(self._polisher, candidate, near=True)
            found = refined if refined.valid else found
        return Design(found.problem, found.values, UNVERIFIED, found.objective, found.solution, found.crank_angles)


def _largest_error(design: LinkageDesign) -> float:
    """Return the largest distance [m] of a target point from the coupler point: the error that is shown."""
    return float(np.max(design.measured.distances))


def _item(design: LinkageDesign) -> dict[str, Any]:
    displayed = Design(design.problem, design.values, crank_angles=design.crank_angles)
    scene = Picture(displayed.machine, displayed.start, displayed.speed).document()
    quantities = design.task.quantities.items()
    sizes = {name: design.values[name] * q.display[0] for name, q in quantities}
    item = {"error": 1e3 * _largest_error(design), "unit": "mm", "valid": design.valid, "design": sizes}
    return {**finite(item), "curve": scene["points"][design.task.requirement.point], "scene": scene}
