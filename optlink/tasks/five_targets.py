"""All linkages that meet five targets exactly: poses, timed points, or points of a function, each judged."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Status
from optlink.io import keeping
from optlink.linkage.bodies import FRAME, Guide, Link
from optlink.linkage.dyads import RRP
from optlink.linkage.fourbar import InnerFourBar
from optlink.linkage.mechanism import Arm, Mechanism
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.requirements.base import MARK, START, pose_angles
from optlink.problem.terms import Goal
from optlink.synthesis.families import three_points
from optlink.synthesis.five_poses import ONE_CENTRE, POSES, TRANSLATED, FourBarSolution, couplers, dyads, moved, timed_paths
from optlink.synthesis.four_poses import Positions
from optlink.tasks.results.design import LinkageDesign
from optlink.tasks.results.exact import BY_TRANSMISSION, ExactSolution, ExactSolutions
from optlink.tasks.search import mode_of
from optlink.units import KINDS, factor
from optlink.validation import validate
from optlink.validation.timing import in_first_cycle

THREE = 3
CONDITIONS = 10  # of five poses with free timing or five timed points, on as many design variables of a four-bar
OTHER_START = 1e-6  # rad or m; of the start of a linkage from the one given, which differs by half a turn otherwise
TRIALS = ((0.3, 0.5), (1.1, -0.4))  # starts [rad], crank and output, with which a law must rise by the same
GRASHOF, TURNS, BOUNDED = "Grashof: ", "crank turns ", " within its bounds"  # names of checks
CRANKS = ("crank-rocker", "double-crank")  # whose cranks turn fully, the first by default


@dataclass(frozen=True)
class SliderCrank:
    """Crank, rod and guide of a slider-crank, with the pins of the rod at crank and slider; `side` as that of the dyad."""

    crank: Link
    coupler: Link
    pin: str
    joint: str
    guide: Guide
    side: int

    @property
    def names(self) -> tuple[str, str, str]:
        """Names of the lengths of crank and rod, and of the offset of the guide."""
        return str(self.crank.length), str(self.coupler.length), str(self.guide.offset)


def slider_crank(linkage: Mechanism) -> SliderCrank | None:
    """Return the slider-crank that a linkage is; None for any other, or if the guide does not count from the crank pivot."""
    group, crank = linkage.groups[0], linkage.crank
    if len(linkage.groups) > 1 or linkage.drives or linkage.limits is not None or not isinstance(group, RRP):
        return None
    pin, guide = group.outer
    plain = crank.end == pin and {group.first.start, group.first.end} == {pin, group.inner}
    placed = (guide.on, guide.through, guide.tilt) == (FRAME, crank.start, 0.0) and guide.at in ("", group.inner)
    return SliderCrank(crank, group.first, pin, group.inner, guide, group.side) if plain and placed else None


def loop_of(task: DesignProblem) -> InnerFourBar | SliderCrank | None:
    """Return the four-bar or the slider-crank that the linkage of a problem is; None for others."""
    return task.four_bar or slider_crank(task.linkage)


@dataclass(frozen=True)
class _Found:
    """A solution, with its validated design and the number of its assembly mode among the files, if it has no defect."""

    solution: ExactSolution
    variant: int
    design: LinkageDesign | None


class FiveTargets:
    """The exact solutions of a problem with definite assembly modes in `files`; see `applies`."""

    def __init__(self, files: Sequence[ProblemFile], goal: Goal | None = None) -> None:
        self.files, self.task = files, files[0].spec
        self.goal = goal
        self.goals = self.task.goals if goal is None else (goal,)
        self.counts, pairs = self._solved()
        self.found = sorted(
            (found for pair in pairs if (found := self._judged(pair)) is not None),
            key=lambda one: (len(one.solution.reasons), self._rank(one.solution)),
        )

    def _rank(self, solution: ExactSolution) -> float:
        """Return the number by which solutions are sorted, the least one first."""
        if not self.goals:
            return -solution.transmission
        return math.inf if solution.figure is None else self._sense * solution.figure

    @property
    def _sense(self) -> float:
        """-1 if the quantity by which they are ranked is maximised."""
        return -1.0 if self._ranked is not None and self._ranked.sense == "maximise" else 1.0

    @property
    def _ranked(self) -> Goal | None:
        """The only quantity by which they are ranked; None without one, and for a weighted sum."""
        return self.goals[0] if self.goal is not None or (self.goals and self.task.single) else None

    @property
    def _words(self) -> str:
        if not self.goals:
            return BY_TRANSMISSION
        return "objective" if self._ranked is None else self._ranked.words

    @cached_property
    def _unit(self) -> str:
        """Display unit of the quantity by which they are ranked."""
        kind = "" if self._ranked is None else self.task.kind(self._ranked)
        return KINDS[kind].display if kind else ""

    def _figure(self, design: LinkageDesign) -> float | None:
        """Return the quantity of a design by which it is ranked, in its unit; None without one, or if it is undefined."""
        if not self.goals:
            return None
        value = design.objective
        if self._ranked is not None:
            value = math.nan if design.cycle is None else design.cycle.figure(self._ranked)
            value /= factor(self._unit, self.task.kind(self._ranked)) if self._unit else 1.0
        return value if math.isfinite(value) else None

    def _solved(self) -> tuple[ExactSolutions, Sequence[FourBarSolution]]:
        """Return the numbers of roots, and the four-bars that they make, each with the link that is its crank."""
        task = self.task
        places = places_of(task)
        pairs: Sequence[FourBarSolution]
        if task.law_given:
            kind = "five points of a function"
            found, pairs = couplers(task.law.offsets, rises(task), slides=task.slides)
        elif task.requirement.kind == "path":
            assert task.data.offsets is not None
            kind, (found, pairs) = "five timed points", timed_paths(places, task.data.offsets)
        else:
            angles = np.unwrap(pose_angles(task.data.columns))
            kind, found = "five poses", dyads(places, angles)
            links = [dyad for dyad in found.real if dyad.kind == "RR"]
            pairs = [FourBarSolution(a, b, places, angles) for a in links for b in links if a is not b]
        frame = task.law_given and not task.slides and bool(found.real)
        sliders = sum(dyad.kind != "RR" for dyad in found.real) + frame
        certified, either = sum(dyad.certified for dyad in found.real), task.requirement.kind == "motion"
        linkage = "four-bar" if task.four_bar else "slider-crank"
        special = in_words(task, found.special)
        return ExactSolutions(kind, len(found.real), certified, found.complex, sliders, special, either, (), linkage), pairs

    @property
    def summary(self) -> ExactSolutions:
        """All solutions as data."""
        found = replace(self.counts, solutions=tuple(one.solution for one in self.found))
        if not self.goals:
            return found
        return replace(found, ranked_by=self._words, unit=self._unit)

    @property
    def usable(self) -> list[tuple[int, LinkageDesign]]:
        """Designs that pass all checks with the numbers of their assembly modes, the best one first."""
        return [(one.variant, one.design) for one in self.found if one.solution.usable and one.design is not None]

    def _judged(self, pair: FourBarSolution) -> _Found | None:
        """Return a four-bar as a solution of the problem, with all reasons that exclude it."""
        task = self.task
        found = positions_of(pair)
        crank, coupler, rocker = found.pin - found.pivot, found.joint - found.pin, found.joint - found.fixed
        slides, side = found.slides, int(found.side)
        sizes = np.array([np.abs(each).max() for each in (crank, coupler, crank if slides else rocker)])
        if np.min(sizes) <= 1e-9 * np.max(sizes):
            return None
        transmission = float(np.min(np.arcsin(np.clip(np.abs(found.sines), 0.0, 1.0))))
        values, datum = {name: float(value) for name, value in quantities_of(task, found).items()}, task.linkage.datum
        phi = np.angle(crank) - (values[datum] if isinstance(datum, str) else datum)
        reasons = list(pair.defects)
        loops = [loop_of(file.spec) for file in self.files]
        variant = next((k for k, loop in enumerate(loops) if loop is not None and loop.side == side), None)
        words = ("forward", "backward") if slides else ("left", "right")
        mode = words[side < 0] if variant is None else mode_of(self.files[variant])
        certified = pair.crank.certified and pair.follower.certified
        design, figure, error = None, None, None
        if not reasons:
            reasons += _other_starts(task, values)
        if not reasons and variant is None:
            reasons.append(f'assembly: it needs "{mode}"')
        if not reasons and variant is not None:
            design = self._design(variant, values, phi)
            values = design.values
            reasons += _failures(design)
            if not reasons and not task.goals and not design.exact:
                reasons.append("rounding: small errors of its sizes move it off the targets")
            transmission = transmission if reasons else design.least_transmission
            figure, error = self._figure(design), design.largest_between if task.law_given else None
        shown = keeping(values, *task.quantities)
        solution = ExactSolution(shown, mode, transmission, certified, tuple(reasons), figure, float(phi[0]), error)
        return _Found(solution, variant or 0, design)

    def _design(self, variant: int, values: Mapping[str, float], phi: Array) -> LinkageDesign:
        """Return a four-bar as a validated design."""
        file = self.files[variant]
        task = file.spec
        full = task.design({name: values[name] for name in task.free})
        if task.data.offsets is None:
            way = min((1.0, -1.0), key=lambda sign: float(np.sum(np.mod(sign * np.diff(phi), TURN))))
            angles = in_first_cycle(task, phi[0] + way * np.concatenate([[0.0], np.cumsum(np.mod(way * np.diff(phi), TURN))]))
        else:
            angles = task.crank_angles(full, None)
        checked = validate(task, full, angles)
        return LinkageDesign(file, full, angles, checked.objective, Status.NOT_SEARCHED, checked)


def in_words(task: DesignProblem, special: str) -> str:
    """Return a sentence about special poses in the words of a problem, whose body need not be one of the linkage."""
    if not special or task.requirement.kind == "motion":
        return special
    if task.law_given:
        known = {
            TRANSLATED: "the output turns as the crank does, as that of any parallelogram",
            ONE_CENTRE: "the output does not move",
        }
        return known.get(special, f"of the output as seen from the crank: {special}")
    known = {
        TRANSLATED: "the crank does not turn between the points",
        ONE_CENTRE: "the points lie on a circle, about whose centre they turn as the crank does: a crank alone passes them",
    }
    return known.get(special, f"of a body that turns with the crank, with the points as its places: {special}")


class ThreePoints(FiveTargets):
    """The only linkage of three points of a function with given start angles; see `given_starts`."""

    def _solved(self) -> tuple[ExactSolutions, Sequence[FourBarSolution]]:
        """Return the number of solutions of three linear equations, and the linkage that they make."""
        task, slides, begin = self.task, self.task.slides, self.task.design({})
        inputs, outputs = (np.asarray(part) for part in (task.law.offsets, rises(task)))
        turned = frame_direction(task)
        outputs = outputs + begin[task.base_name] - turned * (not slides)
        found = three_points(inputs + begin[task.start_name] - turned, outputs, slides=slides)
        kind, linkage = "three points of a function from given starts", "four-bar" if task.four_bar else "slider-crank"
        special = "" if found else "no linkage of finite lengths, or infinitely many"
        count = int(found is not None)
        counts = ExactSolutions(kind, count, count, 0, 0, special, False, (), linkage, 1, "solutions")
        return counts, [] if found is None else [moved(found, inputs, outputs, slides=slides)]


def frame_direction(task: DesignProblem) -> float:
    """Return the direction [rad] from which the angles of a linkage by itself count: that of its frame or guide."""
    loop, values = loop_of(task), task.design({})
    direction = loop.guide.direction if isinstance(loop, SliderCrank) else task.frame_angle or 0.0
    return float(values[direction] if isinstance(direction, str) else direction)


def places_of(task: DesignProblem) -> NDArray[np.complex128]:
    """Return the target points [m] as complex numbers x + iy."""
    columns = task.data.columns
    return columns[:, 0] + 1j * columns[:, 1]


def alone(task: DesignProblem, count: int) -> bool:
    """Return whether a problem has one requirement, of a number of targets."""
    return len(task.parts) == 1 and not task.requirements and task.robust is None and len(task.data.columns) == count


def marked(task: DesignProblem) -> bool:
    """Return whether a problem is one of a four-bar, whose coupler has the point."""
    loop = task.four_bar
    return loop is not None and (loop.coupler.body, task.point) in task.linkage.marks


def _other_starts(task: DesignProblem, values: Mapping[str, float]) -> Iterator[str]:
    """Yield how a linkage begins elsewhere than at given start angles, by half a turn if a length would be negative."""
    for name in (task.start_name, task.base_name) if task.law_given else ():
        if name not in task.free and name in task.quantities:
            given, wrong = task.quantities[name], values[name] - task.quantities[name].value
            wrong = math.remainder(wrong, TURN) if given.kind == "angle" else wrong
            if abs(wrong) > OTHER_START:
                unit = given.display[1]
                stated = f"{values[name] / given.si_per_unit:.4g} {unit}, allowed {given.value / given.si_per_unit:.4g}"
                yield f"outside your bounds: {name} {stated}"


def _failures(design: LinkageDesign) -> Iterator[str]:
    """Yield the checks that a design fails, as reasons; without those that only follow from a crank that does not turn."""
    task = design.task
    for check in design.validation.failures:
        stated = f"{check.value:.4g} {check.unit}".rstrip()
        if check.name.startswith(GRASHOF):
            kind, asked = check.name.removeprefix(GRASHOF), CRANKS[task.limits.crank == "double-crank"]
            if kind.startswith(asked):
                yield f"crank: turns fully by a difference of lengths of {stated} only, required {check.limit}"
            elif kind.startswith(CRANKS):
                yield f"crank: turns fully, but it is that of a {kind}; a {asked} is required"
            else:
                yield f"crank: does not turn fully ({kind})"
        elif check.name.startswith(TURNS):
            yield f"rotation: the crank does not turn {check.name.removeprefix(TURNS)}"
        elif check.name.endswith(BOUNDED):
            yield f"outside your bounds: {check.name.removesuffix(BOUNDED)} {stated}, allowed {check.limit}"
        elif not math.isnan(check.value):
            yield f"{check.name}: {stated}, required {check.limit}"


def applies(task: DesignProblem) -> bool:
    """Return whether a problem has finitely many exact solutions that are cheap to find: see `determined`."""
    return determined(task, POSES)


def determined(task: DesignProblem, count: int) -> bool:
    """Return whether a problem has a number of targets, of which five determine a linkage, and leaves all its dimensions free.

    It is one of a four-bar: poses with free timing, points that are timed from a free start, or points of a law of the rocker
    with free start angles. A slider-crank has such a law of its slide.
    """
    loop = loop_of(task)
    if loop is None or not alone(task, count):
        return False
    if task.law_given:
        return prescribed(task) and {task.start_name, task.base_name, *loop.names} <= set(task.free)
    timed = {"motion": "free", "path": "from start"}.get(task.requirement.kind)
    posed = task.requirement.kind == "path" or bool(task.target_points.posed.all())
    again = task.requirement.kind == "path" and task.meets_again
    return timed == task.timing and posed and marked(task) and len(task.free) >= CONDITIONS and not again


def given_starts(task: DesignProblem) -> bool:
    """Return whether three points of a function with given start angles determine the lengths of a linkage."""
    loop = loop_of(task)
    if loop is None or not alone(task, THREE) or not task.law_given or not prescribed(task):
        return False
    starts, names, free = {task.start_name, task.base_name}, set(loop.names), set(task.free)
    return starts <= task.quantities.keys() - free and names <= free <= names | {getattr(loop, "frame_length", "")}


def prescribed(task: DesignProblem) -> bool:
    """Return whether a law prescribes the same rise of the rocker, or of the slide of a slider-crank, whatever the start is."""
    guides = {guide.name for guide in task.linkage.guides}
    suitable = (
        task.requirement.task(task) == "function"
        if task.four_bar
        else task.requirement.kind == "function" and task.output in guides
    )
    if not suitable or task.everywhere:
        return False
    return np.allclose(_rises(task, *TRIALS[0]), _rises(task, *TRIALS[1]), rtol=0.0, atol=1e-12)


def rises(task: DesignProblem) -> Array:
    """Return the rise of the output [rad or m] that a law prescribes at its positions, see `prescribed`."""
    return _rises(task, *TRIALS[0])


def _rises(task: DesignProblem, start: float, base: float) -> Array:
    """Return the prescribed output [rad] of a law at its positions, above the output at the start."""
    return task.prescribed_outputs({**task.design({}), task.start_name: start, task.base_name: base}) - base


def _joint(part: Array) -> complex:
    """Return homogeneous coordinates as a complex number, of a point at infinity the direction to it."""
    return complex(*part[:2]) / (part[2] or float(np.hypot(*part[:2])))


def positions_of(pair: FourBarSolution) -> Positions:
    """Return the joints of a linkage at all positions."""
    rotation = np.exp(1j * (pair.angles - pair.angles[0]))
    pins, joints = (pair.places + rotation * (_joint(dyad.point) - pair.places[0]) for dyad in (pair.crank, pair.follower))
    pivot, fixed = (np.asarray(_joint(dyad.pivot)) for dyad in (pair.crank, pair.follower))
    return Positions(pins, joints, pivot, fixed, pair.places, float(pair.angles[0]), pair.follower.slider)


def quantities_of(task: DesignProblem, found: Positions) -> dict[str, Array]:
    """Return the quantities [SI] of linkages by their names, arrays; those of a law have the frame of the file.

    A linkage of a law has its crank pivot at the origin, and its frame or its guide along x.
    """
    loop, values, law = loop_of(task), task.design({}), task.law_given
    pin, joint, pivot, far = found.pin[..., 0], found.joint[..., 0], found.pivot, found.fixed
    crank, coupler = pin - pivot, joint - pin
    named: dict[object, Any]
    if isinstance(loop, SliderCrank):
        named = dict(zip(loop.names, (np.abs(crank), np.abs(coupler), (joint - pivot).imag), strict=True))
        start, out = np.angle(crank) + frame_direction(task), (joint - pivot).real
    else:
        assert loop is not None
        size = float(loop.frame(values)[0]) if law else 1.0
        frame, lengths = far - pivot, (np.abs(crank), np.abs(coupler), np.abs(joint - far))
        named = dict(zip(loop.names, (size * each for each in lengths), strict=True))
        for place, at in zip(loop.pivots, (pivot, far), strict=True):
            if isinstance(place, Arm):
                named |= {place.length: size * np.abs(frame), place.direction: np.angle(frame)}
            elif not law:
                named |= {place[0]: at.real, place[1]: at.imag}
        if loop.frame_length:
            named[loop.frame_length] = size * np.abs(frame)
        datum, backwards = task.linkage.datum, loop.coupler.start != loop.pin
        start, out = np.angle(crank) - (named[datum] if isinstance(datum, str) else datum), np.angle(joint - far)
        mark = task.linkage.marks.get((loop.coupler.body, task.point))
        if mark is not None and found.places is not None:
            z = found.places[0] - pin
            with np.errstate(all="ignore"):
                z = ((coupler - z) if backwards else z) / coupler * np.abs(coupler)  # from C along C -> B, or from B along B -> C
            named |= {mark.along: z.real, mark.across: z.imag}
        if MARK in task.quantities:
            named[MARK] = found.begin - np.angle(-coupler if backwards else coupler)
    if START in task.quantities and task.data.offsets is not None:
        named[START] = start - float(task.data.offsets[0])
    if law:
        named |= {task.start_name: start - float(task.law.offsets[0]), task.base_name: out - float(rises(task)[0])}
    names = {name: value for name, value in named.items() if isinstance(name, str)}
    return {name: _within(task, name, value) for name, value in {**values, **names}.items()}


def _within(task: DesignProblem, name: str, value: Array) -> Array:
    """Return values, of a periodic angle those within its bounds."""
    quantity = task.quantities.get(name)
    if quantity is None or quantity.kind != "angle" or not task.is_periodic(name):
        return value
    low, high = quantity.bounds if quantity.free else (quantity.value - math.pi, quantity.value + math.pi)
    middle = 0.5 * (low + high)
    return middle + np.remainder(value - middle + math.pi, TURN) - math.pi
