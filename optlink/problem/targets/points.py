"""Target points of a path, or poses of a body: a list, a CSV file, a drawing (SVG), or expressions in t."""

from pathlib import Path

from optlink.problem.quantity import Unusable, check_keys
from optlink.problem.targets.curves import expression_curve
from optlink.problem.targets.point_table import check_and_reduce, read_csv_rows, read_rows
from optlink.problem.targets.svg_path import svg_points
from optlink.problem.targets.target_points import TargetPoints, read_count

_FORMS = (
    'Write [["20 mm", "25 mm"], ...], { csv = "curve.csv" }, { svg = "drawing.svg" } '
    'or { x = "20*cos(t)", y = "10*sin(t)", unit = "mm", t = [0, "2*pi"] }'
)


_KEYS = {
    "csv": ("csv", "points"),
    "svg": ("svg", "path", "unit", "points"),
    "x": ("x", "y", "unit", "t", "points", "spacing"),
}


def read_points(raw: object, folder: Path) -> TargetPoints:
    """Read points or poses from a problem file: a list, a CSV file, a shape of an SVG file, or expressions in t.

    Up to `MAX_POINTS` listed points are kept unchanged; more are reduced evenly by arc length or, if further columns are defined,
    evenly by rows. A closed curve that is sampled or reduced by arc length does not repeat its first point at the end. The y axis
    of SVG points down, that of optlink up, so y changes its sign; the origin remains that of the drawing.

    Raises
    ------
    Unusable
        with the key below the present one.
    """
    if isinstance(raw, list | tuple):
        return check_and_reduce(read_rows(raw), None)
    if not isinstance(raw, dict):
        raise Unusable("points are a list or a table", _FORMS)
    forms = [form for form, keys in (("csv", ("csv",)), ("svg", ("svg",)), ("x", ("x", "y"))) if any(key in raw for key in keys)]
    if not forms:
        check_keys(raw, sorted({name for form in _KEYS.values() for name in form}))
        raise Unusable("the points are missing", _FORMS)
    if len(forms) > 1:
        raise Unusable(f"the points are given twice, by {' and by '.join(forms)}", "Keep one of them", forms[1], raw[forms[1]])
    check_keys(raw, _KEYS[forms[0]])
    if forms == ["csv"]:
        count = read_count(raw) if "points" in raw else None
        return check_and_reduce(read_csv_rows(raw, folder), count)
    return svg_points(raw, folder) if forms == ["svg"] else expression_curve(raw)
