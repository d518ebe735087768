"""The numbers of a problem [SI] in the file of a certificate: all that its check needs, without the problem file."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from optlink.linkage.dyad_types import JointedDyad
from optlink.linkage.mechanism import Arm, Guide, Link, Mechanism
from optlink.linkage.vector2d import Array
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.interval import Interval
from optlink.problem.limits import limits_in_file
from optlink.problem.quantity_keys import quantity_key
from optlink.problem.targets.function import Function
from optlink.problem.targets.law import Law, SlideExpression, Table

if TYPE_CHECKING:
    pass

Numbers = dict[str, Any]


def numbers_of(problem: ProblemFile, peaks: Array) -> Numbers:
    """Return the numbers of a problem with a lower bound over boxes, without its assembly modes, as plain data.

    `peaks`: see `Certificate`.
    """
    model: Any = problem.model
    quantities = {
        name: {"value": quantity.value, "low": quantity.bounds[0], "high": quantity.bounds[1], "free": quantity.free}
        for name, quantity in model.quantities.items()
        if name not in model.links
    }
    numbers: Numbers = {
        "measure": model.measure,
        "quantities": quantities,
        **({"links": [_link(model, name) for name in model.links]} if model.links else {}),
        "linkage": {"four_bar": model.four_bar is not None, **_linkage(model.linkage)},
        "limits": _limits(model),
    }
    numbers |= _of_law(model) if model.task == "function" else _of_positions(model)
    return numbers | {"offsets": [*numbers["offsets"], *peaks.tolist()]}


def _link(model: DesignProblem, name: str) -> Numbers:
    """Return a linked quantity: its expression as operations on a stack, and its bounds."""
    link, quantity = model.links[name], model.quantities[name]
    terms: dict[str, list[Any]] = {text: ["number", number] for text, number in link.numbers.items()}
    terms |= {text: ["name", of] for text, of in link.names.items()}
    steps = [terms[what] if kind == "name" else [kind, what] for kind, what in link.expression.program]
    limited = quantity.low is not None or (quantity.kind == "length" and not link.positive)
    bounds = quantity.bounds if limited else (-math.inf, math.inf)
    return {"name": name, "key": quantity_key(model, name), "steps": steps, **_sides(bounds)}


def _linkage(linkage: Mechanism) -> Numbers:
    guides = dict.fromkeys((*linkage.guides, *(guide for group in linkage.groups for guide in group.prismatic)))
    dyads = []
    for group in linkage.groups:
        assert isinstance(group, JointedDyad)
        outer = [joint.name if isinstance(joint, Guide) else joint for joint in group.outer]
        members = [_body(linkage, link) for link in group.links]
        dyads.append({"kind": group.kind, "bodies": members, "outer": outer, "inner": group.joint})
    return {
        "datum": linkage.datum,
        "ground": {
            name: {"from": place.origin, "length": place.length, "direction": place.direction}
            if isinstance(place, Arm)
            else list(place)
            for name, place in linkage.ground.items()
        },
        "crank": _body(linkage, linkage.crank),
        "dyads": dyads,
        "guides": {guide.name: _guide(linkage, guide) for guide in guides},
    }


def _body(linkage: Mechanism, link: Link) -> Numbers:
    points = {point.name: [point.along, point.across] for point in linkage.points if point.body == link.body}
    return {"name": link.body, "start": link.start, "end": link.end, "length": link.length, "points": points}


def _guide(linkage: Mechanism, guide: Guide) -> Numbers:
    return {
        "slider": guide.slider,
        "on": guide.on,
        "at": guide.at or linkage.bodies[guide.slider].start,
        "through": guide.through if isinstance(guide.through, str) else list(guide.through),
        "direction": guide.direction,
        "offset": guide.offset,
        "tilt": guide.tilt,
    }


def _of_law(model: DesignProblem) -> Numbers:
    """Return the requirement of a motion law of a four-bar; `names`, if they are others, are those of the angles at the start."""
    names = [model.start_name, model.base_name]
    return {
        "kind": "law",
        "offsets": model.law.offsets.tolist(),
        "span": model.span,
        **_EMPTY,
        "start": model.dead_centre,
        "law": _law(model.law),
        "output": model.output,
        **({} if names == ["phi0", "psi0"] else {"names": names}),
    }


_EMPTY: Numbers = {
    **{"start": None, "law": None, "output": "", "slides": False, "point": "", "body": "", "radian": 1.0},
    **{"targets": [], "roots": [], "tolerances": []},
}


def _of_positions(model: DesignProblem) -> Numbers:
    """Return the requirement of a problem with prescribed crank angles."""
    data, requirement = model.data, model.requirement
    assert data.offsets is not None
    numbers = {
        "kind": requirement.family,
        "offsets": data.offsets.tolist(),
        "span": float(data.offsets[-1] - data.offsets[0]),
        **_EMPTY,
    }
    if model.law_given:
        return numbers | {"law": _law(model.law), "output": model.output, "slides": model.slides}
    if not model.pointed:
        return numbers
    return numbers | {
        "point": requirement.point,
        "body": model.body,
        "radian": model.radian,
        "targets": data.columns.tolist(),
        "roots": data.roots.tolist(),
        "tolerances": [finite(value) for value in data.tolerances],
    }


def _law(law: Law) -> Numbers:
    source = law.source
    if isinstance(source, Table):
        return {"kind": "table", "tabulated": np.asarray(law.tabulated).tolist(), "from_start": source.from_start}
    if isinstance(source, Function):
        least, largest = source.ends
        sizes = {"low": source.low, "high": source.high, "input": source.input, "output": source.output}
        return {"kind": "function", "text": source.expression.text, **sizes, "least": least, "largest": largest}
    expression, unit = (source.expression, source.size) if isinstance(source, SlideExpression) else (source, 1.0)
    return {"kind": "expression", "text": expression.text, "unit": unit}


def _limits(model: DesignProblem) -> Numbers:
    limits = model.limits
    transmission = {
        joint: limit for joint in (group.joint for group in model.linkage.groups) if (limit := limits.transmission_at(joint))
    }
    region = getattr(limits, "pivots", None)  # of path synthesis
    pivots = None if region is None else {axis: _interval(getattr(region, axis)) for axis in "xy"}
    return {
        "crank": limits.crank,
        "alignment": limits.alignment.value,
        "length_margin": limits.length_margin,
        "over": limits.transmission_range,
        "transmission": {joint: vars(limit) for joint, limit in transmission.items()},
        "further": [
            {"name": term.name, **_sides(interval.bounds), "stroke": getattr(interval, "stroke", None)}
            for term, interval in limits_in_file(limits)
        ],
        "pivots": pivots,
    }


def _interval(interval: Interval | None) -> list[float | None]:
    return [None, None] if interval is None else list(_sides(interval.bounds).values())


def _sides(bounds: tuple[float, float]) -> dict[str, float | None]:
    return {"low": finite(bounds[0]), "high": finite(bounds[1])}


def finite(value: float) -> float | None:
    """Return a number as JSON can contain it: null if it is infinite."""
    return float(value) if math.isfinite(value) else None
