"""Exact solutions on the canvas: all linkages that meet the targets, each with its figure or the reason that excludes it."""

import math
from dataclasses import replace
from typing import Any

from optlink.errors import InputError
from optlink.io import finite
from optlink.presentation.html.gallery import MOST
from optlink.problem.file import ProblemFile
from optlink.studio.design import Design, design_of
from optlink.studio.document import Document
from optlink.studio.dyads import started
from optlink.studio.picture import Picture
from optlink.tasks.exact import listing
from optlink.tasks.results.design import SynthesisResult
from optlink.tasks.results.exact import BY_TRANSMISSION, DEFECTS, counts
from optlink.tasks.search import mode_of


def offered(problem: ProblemFile) -> bool:
    """Return whether a problem has listed exact solutions."""
    return bool(problem.model.parts) and listing(problem) is not None


def document(result: SynthesisResult) -> dict[str, Any]:
    """Return exact solutions as data of the page, with the scenes of the first ones in motion."""
    listed = result.exact_solutions
    assert listed is not None
    model, files = result.problem.model, {mode_of(file): file for file in result.problem.variants()}
    points = dict.fromkeys(part.requirement.point for part in result.problem.spec.parts if part.pointed)
    items = []
    for one in listed.solutions[:MOST]:
        scene, file = None, files.get(one.assembly)
        if file is not None and one.crank_angle is not None:
            values = file.model.design({name: one.values[name] for name in model.free})
            shown = Design(file, values)
            try:
                scene = Picture(shown.machine, one.crank_angle, shown.speed).document()
            except (ArithmeticError, ValueError):  # it cannot be assembled there
                scene = None
        figure = math.degrees(one.transmission) if listed.ranked_by == BY_TRANSMISSION else one.figure
        reasons = [f"{cause}: {DEFECTS[cause]}" if cause in DEFECTS else cause for cause in one.reasons]
        items.append({"usable": one.usable, "figure": figure, "reasons": reasons, "scene": scene})
    return {
        "items": finite(items),
        "count": len(listed.solutions),
        "special": bool(listed.special),
        "usable": listed.usable,
        "sentence": counts(listed),
        "by": listed.ranked_by,
        "unit": listed.unit,
        "ways": ["total length", *(f"peak {what} of {name}" for name in points for what in ("velocity", "acceleration"))],
    }


def chosen(document: Document, result: SynthesisResult | None, index: Any) -> tuple[Document, Design]:
    """Return the document with a usable solution as the start of its search, and this solution.

    Raises
    ------
    InputError
        If there is no such solution, or it is not usable.
    """
    designs = () if result is None else result.designs
    if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(designs):
        raise InputError("no such usable solution", "List the solutions, and choose a usable one", key="chosen", value=index)
    assert result is not None
    best = designs[index]
    return started(document, design_of(replace(result, designs=(best, *(one for one in designs if one is not best)))))
