"""The points that a path shall pass through, or the poses of a body: a list, a CSV file, a drawing (SVG), or expressions in t."""

from __future__ import annotations

from pathlib import Path

from optlink.problem.quantity import Unusable, nearest
from optlink.problem.targets.curves import expressed
from optlink.problem.targets.point_table import listed, reduced, tabled
from optlink.problem.targets.svg_path import drawn
from optlink.problem.targets.target_points import DEFAULT_POINTS, MAX_POINTS, Wanted, asked_count, closed

_FORMS = (
    'Write [["20 mm", "25 mm"], ...], { csv = "curve.csv" }, { svg = "drawing.svg" } '
    'or { x = "20*cos(t)", y = "10*sin(t)", unit = "mm", t = [0, "2*pi"] }'
)


_KEYS = {
    "csv": ("csv", "points"),
    "svg": ("svg", "path", "unit", "points"),
    "x": ("x", "y", "unit", "t", "points", "spacing"),
}


def read_points(raw: object, folder: Path) -> Wanted:
    """Read points or poses as a problem file states them: a list, a CSV file, a shape of an SVG file, or expressions in t.

    A listed point is kept as it is listed, up to `MAX_POINTS` of them; more are reduced evenly by arc length or, where something
    is stated of each point, evenly by rows. A closed curve that is sampled or reduced by arc length does not repeat its first
    point at the end. SVG's y axis points down and ours up, so y changes its sign; the origin stays that of the drawing.

    Parameters
    ----------
    raw : what the file states
    folder : of the file, which names of other files are relative to

    Raises
    ------
    Unusable
        naming the key below the present one that is to blame.
    """
    if isinstance(raw, Wanted):
        return raw
    if isinstance(raw, list | tuple):
        return reduced(listed(raw), None)
    if not isinstance(raw, dict):
        raise Unusable("points are a list or a table", _FORMS, "", raw)
    forms = [form for form, keys in (("csv", ("csv",)), ("svg", ("svg",)), ("x", ("x", "y"))) if any(key in raw for key in keys)]
    if not forms:
        known = {name for form in _KEYS.values() for name in form}
        for key in raw:
            if key not in known:
                raise Unusable("unknown key", nearest(str(key), sorted(known)), str(key))
        raise Unusable("nothing says where the points are", _FORMS, "", raw)
    if len(forms) > 1:
        raise Unusable(f"the points are given twice, by {' and by '.join(forms)}", "Keep one of them", forms[1], raw[forms[1]])
    for key in raw:
        if key not in _KEYS[forms[0]]:
            raise Unusable("unknown key", nearest(str(key), _KEYS[forms[0]]), str(key))
    if forms == ["csv"]:
        count = asked_count(raw) if "points" in raw else None
        return reduced(tabled(raw, folder), count)
    return drawn(raw, folder) if forms == ["svg"] else expressed(raw)


__all__ = ["DEFAULT_POINTS", "MAX_POINTS", "Wanted", "closed", "read_points"]
