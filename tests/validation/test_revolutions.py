"""An output that meets the angles of its law alone, but not its revolutions, is not valid."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.tasks.run import validate
from optlink.validation.check import revolutions_check

CRANK_ROCKER = {"crank": 0.1, "coupler": 0.3, "rocker": 0.25, "frame": 0.28}
DRAG_LINK = {"crank": 0.25, "coupler": 0.2, "rocker": 0.22, "frame": 0.1}
BEGIN = 60.0  # deg
NAME = "output rotates as the law, without extra revolutions"


def rockers(lengths: dict[str, float], crank: np.ndarray) -> np.ndarray:
    """Continuous angles of the rocker [deg] with C to the left of B-D, by complex numbers and the cosine rule."""
    b, d, way = lengths["coupler"], lengths["rocker"], int(math.copysign(1.0, crank[-1] - crank[0]))
    fine = np.unique(np.concatenate([np.linspace(crank[0], crank[-1], 721), crank]))[::way]
    z = lengths["frame"] - lengths["crank"] * np.exp(1j * np.radians(fine))
    c = b * np.exp(1j * (np.angle(z) + np.arccos((b * b + np.abs(z) ** 2 - d * d) / (2.0 * b * np.abs(z))))) - z
    return np.interp(way * crank, way * fine, np.degrees(np.unwrap(np.angle(c))))


def verdict(
    lengths: dict[str, float], cranks: list[float], more: list[float], *, dyads: bool, skipped: int = 0
) -> tuple[bool, set[str]]:
    """Validate a linkage for its own angles at rotations of the crank, plus `more` [deg], without the first rows of the table.

    Return whether revolutions are checked, and the names of the checks that fail.
    """
    psi = rockers(lengths, BEGIN + np.array(cranks)) + np.array(more)
    sizes = {name: f"{1e3 * value!r} mm" for name, value in lengths.items()}
    sizes["coupler"] = {"bounds": ["150 mm", "400 mm"]}  # type: ignore[assignment]
    rows = list(zip(cranks, (psi - psi[0]).tolist(), strict=True))[skipped:]
    law = {"phi": [f"{phi} deg" for phi, _ in rows], "psi": [f"{angle!r} deg" for _, angle in rows]}
    raw: dict[str, Any] = {"limits": {"crank": "double-crank" if lengths is DRAG_LINK else "full rotation"}}
    raw |= {"requirement": {"kind": "function", "law": law, "from": f"{BEGIN} deg"}, "mechanism": sizes}
    if dyads:
        links = {"crank": {"joints": ["A", "B"]}, "coupler": {"joints": ["B", "C"]}, "rocker": {"joints": ["D", "C"]}}
        links = {name: {**link, "length": sizes[name]} for name, link in links.items()}
        ground = {"A": ["0 mm", "0 mm"], "D": [sizes["frame"], "0 mm"]}
        raw["mechanism"] = {"ground": ground, "links": links, "assembly": {"C": "left of B-D"}}
        requirement = {"output": "rocker", "start": f"{BEGIN} deg", "psi0": f"{math.remainder(float(psi[0]), 360.0)!r} deg"}
        raw |= {"requirement": {"kind": "function", "law": law, **requirement}}
    result = validate(optlink.read(raw), {"coupler.length" if dyads else "coupler": lengths["coupler"]})
    wrong = {check.name for check in result.best.validation.checks if not check.passed}  # type: ignore[union-attr]
    assert result.objective < 1e-18  # the angles are those of the law
    assert result.valid == (not wrong)
    return any(check.name == NAME for check in result.best.validation.checks), wrong  # type: ignore[union-attr]


@pytest.mark.parametrize("dyads", [False, True])
@pytest.mark.parametrize(
    ("lengths", "cranks", "more", "there", "wrong"),
    [
        (CRANK_ROCKER, [0.0, 45.0, 90.0], [0.0, 0.0, 0.0], False, set()),
        (CRANK_ROCKER, [0.0, 90.0], [0.0, 360.0], True, {NAME}),
        (CRANK_ROCKER, [0.0, 45.0, 90.0], [0.0, -360.0, -720.0], True, {NAME}),
        (CRANK_ROCKER, [0.0, -90.0], [0.0, 360.0], True, {NAME}),
        (DRAG_LINK, [0.0, 180.0, 360.0], [0.0, 0.0, 0.0], True, set()),
        (DRAG_LINK, [0.0, 180.0, 360.0], [0.0, -360.0, -360.0], True, {NAME}),
        (DRAG_LINK, [0.0, 360.0], [0.0, -360.0], True, {NAME}),  # constant by the law, one revolution in motion
        (DRAG_LINK, [0.0, 120.0, 240.0, 360.0], [0.0, 0.0, 0.0, -360.0], True, {NAME}),
    ],
)
def test_revolutions_of_a_law(lengths, cranks, more, there, wrong, dyads):
    assert verdict(lengths, cranks, more, dyads=dyads) == (there, wrong)


@pytest.mark.parametrize(
    ("cranks", "more", "there", "wrong"),
    [
        ([0.0, 180.0, 181.0, 182.0, 183.0], [0.0] * 5, False, set()),  # its cubic is at 400 deg at the start
        ([0.0, -180.0, -181.0, -182.0, -183.0], [0.0] * 5, False, set()),
        ([0.0, 90.0, 180.0], [0.0, 360.0, 360.0], True, {NAME}),  # relative to the rocker's own angle at the start
        ([0.0, 90.0, 180.0], [0.0, 0.0, 360.0], True, {NAME}),
    ],
)
def test_a_table_that_begins_later_is_not_extrapolated(cranks, more, there, wrong):
    assert verdict(CRANK_ROCKER, cranks, more, dyads=False, skipped=1) == (there, wrong)


def test_with_a_free_angle_at_the_start_a_table_begins_with_its_first_row():
    sizes = {name: f"{1e3 * value!r} mm" for name, value in CRANK_ROCKER.items()} | {"coupler": {"bounds": ["150 mm", "400 mm"]}}
    for more, valid in ((0.0, True), (360.0, False)):
        psi = rockers(CRANK_ROCKER, BEGIN + np.array([0.0, 90.0, 180.0])) + np.array([0.0, 360.0, 360.0 + more])
        law = {"phi": ["90 deg", "180 deg"], "psi": [f"{angle!r} deg" for angle in (psi - psi[0]).tolist()[1:]]}
        requirement = {"kind": "function", "law": law, "from": f"{BEGIN} deg", "psi0": f"{float(psi[0])!r} deg"}
        raw = {"mechanism": sizes, "requirement": requirement, "limits": {"crank": "full rotation"}}
        assert validate(optlink.read(raw), {"coupler": CRANK_ROCKER["coupler"]}).valid == valid


@pytest.mark.parametrize(
    ("expected", "moved", "passed"),
    [
        ([math.nan, 0.0, 3.0], [0.0, 0.0, 3.0], True),  # the law begins at the second position
        ([math.nan, 0.0, 3.0], [0.0, 0.0, 3.0 - math.tau], False),
        ([math.nan, 0.0, 1.0], [0.0, 0.0, 1.0], None),
        ([0.0, 3.0, math.nan], [0.0, 3.0, 3.0], False),
        ([0.0, math.inf, math.inf], [0.0, 0.0, 0.1], False),
        ([0.0, 3.0, 6.0], [0.0, math.nan, math.nan], False),
    ],
)
def test_positions_without_a_value_do_not_drop_the_check(expected, moved, passed):
    """Of one design among others, to which the check applies."""
    other = [0.0, 3.0, 6.0]
    [check] = revolutions_check(np.array([0.0, 1.0, 2.0]), np.array([expected, other]), lambda: np.array([moved, other]))
    assert check.passed[1]
    assert check.applies[0] == (passed is not None)
    assert passed is None or check.passed[0] == passed
