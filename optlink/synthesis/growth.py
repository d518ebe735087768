"""Starting points of a six-bar from designs of the four-bar that it contains.

In a Stephenson III six-bar the traced point follows the coupler curve of its four-bar if it lies in the joint with the coupler.
In a Watt I six-bar it does so if the second dyad and the two bodies that carry it form a parallelogram: a pantograph then
enlarges the coupler curve about the pivot of the rocker. A design of the four-bar thus gives a design of the six-bar, whose
remaining dimensions are random.

References
----------
E. A. Dijksman, Motion geometry of mechanisms, Cambridge University Press (1976), on pantographs and Watt's six-bar.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.errors import InputError
from optlink.linkage.dyads import RRR
from optlink.linkage.fourbar import InnerFourBar, inner_four_bars
from optlink.linkage.mechanism import FRAME, Link, Mechanism, Pose
from optlink.linkage.vector2d import Array, unit
from optlink.optimization.courses import limit_courses
from optlink.optimization.terms import rows as limit_rows
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.limits import Reach
from optlink.synthesis import batch_search
from optlink.synthesis.batch import Batch

# Constants of the designs that repeat the curve of a four-bar.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
SAMPLES = 6000  # random choices of the remaining dimensions, per four-bar design and combination of assembly modes
COARSE, ALONG, FINE = 10, 73, 1441  # crank angles at which limits are evaluated: of all, of possible and of preselected designs
MEASURED = 10  # preselected designs, as a multiple of those returned
CURVE_ROUNDING = 1e-6  # of the size of the curve: rounding difference of the two curves
ENLARGED = (math.log(0.4), math.log(2.5))  # logarithms of the pantograph ratio
NEARBY = {"length": (math.log(0.5), math.log(10.0)), "coordinate": (0.0, math.log(8.0))}  # log ranges of other dimensions
AROUND = 0.15  # rad: standard deviation of the rotation of the parallelogram sides from those of the four-bar

Complex = NDArray[np.complex128]
Values = dict[str, Array]


@dataclass(frozen=True)
class ContainedFourBar:
    """A four-bar within a linkage.

    `file` is the problem of the four-bar alone, with the same limits. `coincident` are points (body, point, joint) that must lie
    in a joint of their body, from the traced point on; for a pantograph `arms` are the links attached to coupler and rocker.
    """

    file: ProblemFile
    loop: InnerFourBar
    coincident: tuple[tuple[str, str, str], ...] = ()
    arms: tuple[Link, Link] | None = None


def contained_four_bar(problem: ProblemFile) -> ContainedFourBar | None:
    """Return the four-bar whose coupler curve the point of a path problem of a linkage of dyads can trace, or None."""
    task = problem.spec
    if task.requirement.kind != "path" or "links" not in problem.raw["mechanism"] or task.linkage.limits is not None:
        return None
    mechanism, point = task.linkage, task.point
    for loop in inner_four_bars(mechanism):
        if task.body in (loop.coupler.body, loop.rocker.body, loop.crank.body) and len(mechanism.groups) == 1:
            return None  # it is the four-bar itself
        chain = _chain(mechanism, task.body, point, loop)
        if chain is not None:
            traced = chain[-1][2] if chain else point
            part = _part(problem, loop, traced, None)
            return None if part is None else ContainedFourBar(part, loop, chain)
        arms = _pantograph(task, loop)
        if arms is not None:
            part = _part(problem, loop, point, _reach(task, arms[1]))
            return None if part is None else ContainedFourBar(part, loop, (), arms)
    return None


def _chain(
    mechanism: Mechanism, body: str, point: str, loop: InnerFourBar, seen: tuple[str, ...] = ()
) -> tuple[tuple[str, str, str], ...] | None:
    """Return the points that must coincide with joints so that the point becomes a coupler point; None where impossible."""
    if body == loop.coupler.body:
        return () if (body, point) in mechanism.marks and point not in (loop.joint, loop.pin) else None
    if body in (loop.crank.body, loop.rocker.body):
        return None
    for joint, bodies in mechanism.pins.items():
        if body not in bodies or (joint != point and (body, point) not in mechanism.marks):
            continue
        for other in bodies:
            if other in (FRAME, body, *seen):
                continue
            rest = _chain(mechanism, other, joint, loop, (*seen, body))
            if rest is not None:
                return ((body, point, joint), *rest)
    return None


def _pantograph(task: DesignProblem, loop: InnerFourBar) -> tuple[Link, Link] | None:
    """Return the links from coupler and rocker to their common joint if they can be the parallelogram of a pantograph."""
    mechanism = task.linkage
    quantities = task.quantities
    lengths = [str(link.length) for link in (loop.crank, loop.coupler, loop.rocker)]
    if not loop.plain or not all(quantities[name].free for name in (*lengths, *loop.ground)):
        return None  # a four-bar of fixed size cannot be scaled
    for group in mechanism.groups:
        if not isinstance(group, RRR) or group is loop.group:
            continue
        for (arm, e), (leg, f) in (pair := tuple(zip(group.links, group.outer, strict=True)), pair[::-1]):
            marked = (loop.coupler.body, e) in mechanism.marks and (loop.rocker.body, f) in mechanism.marks
            whole = {arm.start, arm.end} == {e, group.joint} and {leg.start, leg.end} == {f, group.joint}
            if leg.body == task.body and (leg.body, task.point) in mechanism.marks and marked and whole:
                return arm, leg
    return None


def _reach(task: DesignProblem, leg: Link) -> float:
    """Return the largest distance [m] of the point from the pin of its link that its bounds and the coupler length allow."""
    mark = task.linkage.marks[leg.body, task.point]
    extents = [max(map(abs, task.quantities[str(name)].bounds)) for name in (mark.along, mark.across)]
    return min(math.hypot(*extents) + 2.0 * task.size, 1e3 * task.size)


def _part(problem: ProblemFile, loop: InnerFourBar, point: str, reach: float | None) -> ProblemFile | None:
    """Return the problem of the four-bar alone, None if its dimensions follow from those of other links.

    `reach` bounds the coordinates [m] of a point that is new on the coupler.
    """
    kept = {loop.pin, loop.joint, loop.crank.start, loop.ground_pin, point}
    kinds = ("title", "source", "about", "requirement", "requirements", "limits", "drive")
    raw: dict[str, Any] = copy.deepcopy({key: value for key, value in problem.raw.items() if key in kinds})
    listed = raw.pop("requirements", ())
    path = next((each for each in listed if each.get("kind") == "path"), None) or raw["requirement"]
    raw["requirement"] = {key: value for key, value in path.items() if key not in ("name", "tolerance", "weight", "scale")}
    raw["limits"] = _own_limits(raw.get("limits", {}), loop, kept)
    whole = problem.raw["mechanism"]
    links = {link.body: copy.deepcopy(whole["links"][link.body]) for link in (loop.crank, loop.coupler, loop.rocker)}
    for link in links.values():
        link["points"] = {name: place for name, place in link.get("points", {}).items() if name in kept}
    if reach is not None:
        links[loop.coupler.body]["points"][point] = [{"bounds": [f"{-1e3 * reach!r} mm", f"{1e3 * reach!r} mm"]}] * 2
    raw["requirement"]["point"] = point
    raw["mechanism"] = {
        "type": "dyads",
        "ground": {name: place for name, place in whole["ground"].items() if name in kept},
        "links": links,
        "assembly": {loop.joint: whole["assembly"][loop.joint]},
    }
    try:
        return problem.with_tables(raw)
    except InputError:
        return None


def _own_limits(limits: dict[str, Any], loop: InnerFourBar, kept: set[str]) -> dict[str, Any]:
    """Return the limits of the four-bar alone: not those of points and joints that it lacks, nor of quantities of the machine."""
    own: dict[str, Any] = {}
    for key, limit in limits.items():
        if not isinstance(limit, dict):
            own[key] = limit
        elif key in ("transmission_angle", "pressure_angle"):
            own[key] = {name: value for name, value in limit.items() if name in ("min", "max", "exactly", loop.joint)}
        elif "quantity" not in limit and limit.get("of", loop.joint) in kept:
            own[key] = limit
    return {key: limit for key, limit in own.items() if limit != {}}


def grow_from_four_bar(
    part: ContainedFourBar, batch: Batch, values: Mapping[str, float], t: Array, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return designs x and crank angles t of the linkage whose point repeats the curve of a four-bar design, within all limits.

    `part.file` has the definite assembly mode of the four-bar design, of which `values` [m, rad] are all quantities and `t`
    (points,) [rad] the crank angles; `batch` is the linkage with definite assembly modes. There are at most `count` designs,
    those with the largest slack of their limits first.
    """
    x = batch_search.random_designs(batch, SAMPLES, rng)
    for i, name in enumerate(batch.names):  # relative to the size of the curve, independent of the bounds
        kind, near = batch.problem.quantities[name].kind, slice(SAMPLES // 4, SAMPLES)
        if kind in NEARBY:
            size = np.exp(rng.uniform(*NEARBY[kind], SAMPLES))
            x[near, i] = (size if kind == "length" else size * rng.standard_normal(SAMPLES))[near]
    x = np.clip(x, batch.low, batch.high)
    sizes = batch.values(x)
    for name, value in values.items():
        if name in sizes:
            sizes[name] = np.full((SAMPLES, 1), value)
    angles = np.tile(t, (SAMPLES, 1))
    if part.arms is None:
        mechanism = batch.problem.linkage
        for body, point, joint in reversed(part.coincident):
            if point != joint:
                _place(mechanism, sizes, body, point, _local(mechanism, sizes, body, joint))
    else:
        name = f"{part.loop.coupler.body}.{batch.problem.requirement.point}"
        traced = complex(values[f"{name}.along"], values[f"{name}.across"])
        angles = angles - _enlarge(part.loop, part.arms, traced, batch, sizes, rng)
    x = np.concatenate([(sizes[name] - batch.origin[i]) / batch.scale[i] for i, name in enumerate(batch.names)], axis=1)
    inside = np.all((x >= batch.low - 1e-12) & (x <= batch.high + 1e-12), axis=1)
    known = batch.problem.complete({name: sizes[name] for name in batch.names})
    for name in batch.problem.quantities:
        if name not in batch.names:
            inside &= np.abs(sizes[name] - known[name])[:, 0] <= 1e-12
    x, angles = np.clip(x[inside], batch.low, batch.high), angles[inside]
    same = _apart(part.file, values, t, batch, x, angles) <= CURVE_ROUNDING  # not the other assembly mode
    x, angles = x[same], angles[same]
    possible = _slack(batch, x, angles, COARSE) > -CURVE_ROUNDING
    x, angles = x[possible], angles[possible]
    for along, most in ((ALONG, MEASURED * count), (FINE, count)):
        slack = _slack(batch, x, angles, along)
        order = np.argsort(-slack, kind="stable")[:most]
        order = order[slack[order] > -CURVE_ROUNDING]  # limits of the four-bar itself may be active
        x, angles = x[order], angles[order]
    return x, angles


def _apart(part: ProblemFile, values: Mapping[str, float], t: Array, batch: Batch, x: Array, angles: Array) -> Array:
    """Return the largest distance (designs,) of the traced points from those of the four-bar, relative to the curve size."""
    small, task = part.spec, batch.problem
    with np.errstate(all="ignore"):
        px, py = small.linkage.pose(values, unit(t)).point(small.point)
        qx, qy = task.linkage.pose(batch.values(x), unit(batch.crank_angles(x, angles))).point(task.point)
        far = np.max(np.hypot(qx - px, qy - py), axis=1) / task.size
    return np.where(np.isfinite(far), far, np.inf)


def _slack(batch: Batch, x: Array, angles: Array, along: int) -> Array:
    """Return the least slack (designs,) of the limits at `along` crank angles, in the units of the rows; negative if violated."""
    task, values, at = batch.problem, batch.values(x), batch.crank_angles(x, angles)
    shares, angles = np.linspace(0.0, 1.0, along), at.T[..., None]
    slacks = [-np.max(course.heights(values, angles, shares), axis=(0, 2)) for course in limit_courses(task)]
    span = at[:, -1:] - at[:, :1]
    for row in limit_rows(task, values, Reach(at[:, :1], span, np.sign(span)), task.size):
        slacks += [np.minimum(row.value - row.low, row.high - row.value)[:, 0]]
    return np.asarray(np.min(slacks, axis=0))


def _local(mechanism: Mechanism, sizes: Mapping[str, Any], body: str, point: str) -> Complex:
    """Return the body coordinates (designs, 1) [m] of a point."""
    along, across = Pose(mechanism, sizes).local(body, point)
    return np.asarray(np.zeros((SAMPLES, 1), dtype=complex) + along + 1j * across)


def _enlarge(
    loop: InnerFourBar, arms: tuple[Link, Link], traced: complex, batch: Batch, sizes: Values, rng: np.random.Generator
) -> Array:
    """Make the four-bar the driver of a pantograph that restores its curve; return the rotation (designs, 1) [rad].

    With O the rocker pivot and J its joint with the coupler, F = O + s (J - O) on the rocker and E on the coupler, the
    parallelogram J-E-G-F leads P = F + v u along O + s (Q - O), where u is the coupler direction and Q = J + v u / s its point.
    `sizes` is changed in place.
    """
    mechanism, point = batch.problem.linkage, batch.problem.point
    arm, leg = arms
    free = 1.0 if batch.free_timing else 0.0
    turned = free * AROUND * rng.standard_normal((SAMPLES, 1)) * (rng.random((SAMPLES, 1)) < 0.5)
    ratio = np.exp(rng.uniform(*ENLARGED, (SAMPLES, 1)))
    s = ratio * np.exp(1j * turned)
    a, o = (sizes[f"{name}.x"] + 1j * sizes[f"{name}.y"] for name in (loop.crank.start, loop.ground_pin))
    moved = o + (a - o) / s
    sizes[f"{loop.crank.start}.x"], sizes[f"{loop.crank.start}.y"] = moved.real, moved.imag
    for link in (loop.crank, loop.coupler, loop.rocker):
        sizes[str(link.length)] = sizes[str(link.length)] / ratio
    joint, pin = (_local(mechanism, sizes, loop.coupler.body, name) for name in (loop.joint, loop.pin))
    j, pivot = (_local(mechanism, sizes, loop.rocker.body, name) for name in (loop.joint, loop.ground_pin))
    side = (pin - joint) / np.abs(pin - joint) * (s - 1.0) / np.abs(s - 1.0)  # parallel to the four-bar's: the same angles
    skew = AROUND * rng.standard_normal((SAMPLES, 1)) * ((turned != 0.0) | (rng.random((SAMPLES, 1)) < 0.5))  # none: limits hold
    side = side * np.where(rng.random((SAMPLES, 1)) < 0.5, -1.0, 1.0) * np.exp(1j * skew)
    side = side * np.abs(pin - joint) * np.exp(rng.uniform(math.log(0.2), math.log(5.0), (SAMPLES, 1)))
    f = pivot + s * (j - pivot)
    [common] = {arm.start, arm.end} & {leg.start, leg.end}
    e_name, f_name = (link.end if link.start == common else link.start for link in arms)
    for body, name, place in ((loop.coupler.body, e_name, joint + side), (loop.rocker.body, f_name, f)):
        _place(mechanism, sizes, body, name, place)
    sizes[str(leg.length)], sizes[str(arm.length)] = np.abs(side), np.abs(f - j)
    v = s * (traced / ratio - joint) * np.abs(side) / side  # in axes along F-G
    _place(mechanism, sizes, leg.body, point, v if leg.start == f_name else np.abs(side) - v)
    return turned


def _place(mechanism: Mechanism, sizes: dict[str, Array], body: str, point: str, at: NDArray[np.complex128]) -> None:
    """Set the coordinates of a point on its body."""
    mark = mechanism.marks[body, point]
    sizes[str(mark.along)], sizes[str(mark.across)] = at.real, at.imag
