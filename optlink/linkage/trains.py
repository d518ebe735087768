"""Bodies that drives and couplings place, alone or several at once: their angles and slides solve linear equations.

A sun that drives a carrier through a planet determines the angles of both together, a motor on a carriage whose pinion rolls on a
fixed rack its slide. The coefficients are constant, so that Cramer's rule solves the equations for any number type; transposed,
they give the efforts of the drives and couplings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from optlink.linkage.bodies import Guide, Joint, Link
from optlink.linkage.elements import Element, Pose
from optlink.linkage.jet import as_jet
from optlink.linkage.vector2d import Value, minus, turn, turn_back, unit


@dataclass(frozen=True)
class Single:
    """A body that one joint connects with a body placed before it."""

    link: Link
    joint: Joint

    @property
    def guide(self) -> Guide | None:
        """The guide, if the joint is one."""
        return None if isinstance(self.joint, str) else self.joint

    @property
    def coordinate(self) -> Joint:
        """What drives and couplings determine: the angle of the body, by its name, or its slide, by the guide."""
        return self.guide or self.link.body

    def tilt(self, pose: Pose) -> Value:
        """Return the angle of a body in a guide relative to the other body of the guide [rad]."""
        assert self.guide is not None
        tilt = pose.size(self.guide.direction) + pose.size(self.guide.tilt)
        return tilt if self.link.body == self.guide.slider else -tilt

    def place(self, pose: Pose, coordinate: Value) -> None:
        """Add the body and its points to `pose`, from its angle [rad] or slide [m]."""
        link, guide = self.link, self.guide
        if guide is None:
            pin = str(self.joint)
            pose.turns[link.body] = coordinate
            pose.point(pin)
            pose.place(link, unit(coordinate), pin)
            return
        other = guide.other(link.body)
        (x, y), line = pose.line(guide, other)
        pose.turns[link.body] = pose.turned(other) + self.tilt(pose)
        if link.body == guide.slider:
            at = guide.at or link.start
            pose.points[at] = x + coordinate * line[0], y + coordinate * line[1]
            pose.place(link, turn(line, unit(pose.size(guide.tilt))), at)
            return
        axis = turn_back(line, unit(pose.size(guide.direction)))  # the line moves, and passes through a point of a placed body
        begin = turn(pose.local_line(guide, link.body)[0], axis)
        pose.points[link.start] = minus((x - coordinate * line[0], y - coordinate * line[1]), begin)
        pose.place(link, axis, link.start)


@dataclass(frozen=True)
class Train:
    """Bodies, in the order of placing, and as many drives and couplings, which determine their angles and slides together.

    `after`: the joint of the last group placed before them.
    """

    singles: tuple[Single, ...]
    elements: tuple[Element, ...]
    after: str = ""

    @property
    def coordinates(self) -> tuple[Joint, ...]:
        """The angles and slides to be determined."""
        return tuple(single.coordinate for single in self.singles)

    def rows(self, pose: Pose) -> list[dict[Joint, Value]]:
        """Return the coefficients of the unknown angles and slides in the equation of each element."""
        return [
            {joint: value for joint, value in self._terms(pose, element)[0].items() if joint in self.coordinates}
            for element in self.elements
        ]

    def _terms(self, pose: Pose, element: Element) -> tuple[dict[Joint, Value], Value]:
        """Return the coefficients of an equation and a constant; a body in a guide turns as the one that carries it."""
        own = {single.link.body: single for single in self.singles}
        terms: dict[Joint, Value] = {}
        constant: Value = 0.0
        for joint, value in element.terms(pose).items():
            while isinstance(joint, str) and joint in own and (guide := own[joint].guide):
                constant = constant + value * own[joint].tilt(pose)
                joint = guide.other(joint)
            terms[joint] = terms[joint] + value if joint in terms else value
        return terms, constant

    def solve(self, pose: Pose) -> None:
        """Add the bodies and their points to `pose`."""
        rows, unknown, right = self.rows(pose), self.coordinates, []
        for element in self.elements:
            terms, rest = self._terms(pose, element)
            for joint, value in terms.items():
                if joint not in unknown:
                    rest = rest + value * (pose.turned(joint) if isinstance(joint, str) else pose.slide(joint))
            right.append(element.value(pose) - rest)
        whole = determinant(rows, unknown)
        for single in self.singles:
            replaced = [{**row, single.coordinate: rest} for row, rest in zip(rows, right, strict=True)]
            single.place(pose, determinant(replaced, unknown) / whole)

    def efforts(self, pose: Pose, needed: Mapping[Joint, Value]) -> list[Value]:
        """Return the effort of each element from the moments [N m] and forces [N] along the coordinates that are needed."""
        rows = [{joint: as_jet(value).value for joint, value in row.items()} for row in self.rows(pose)]
        unknown = self.coordinates
        whole = determinant(rows, unknown)
        return [determinant([*rows[:k], needed, *rows[k + 1 :]], unknown) / whole for k in range(len(rows))]


def determinant(rows: Sequence[Mapping[Joint, Value]], columns: Sequence[Joint]) -> Value:
    """Return the determinant of rows of numbers by column, without those that are zero (P.-S. Laplace's expansion)."""
    if not columns:
        return 1.0
    total, sign = 0.0, 1.0
    for k, column in enumerate(columns):
        if column in rows[0]:
            total = total + sign * rows[0][column] * determinant(rows[1:], [*columns[:k], *columns[k + 1 :]])
        sign = -sign
    return total
