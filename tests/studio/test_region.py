"""The region of the pivots that is drawn on the canvas."""

from __future__ import annotations

import pytest

from optlink.errors import InputError
from optlink.studio import region
from optlink.studio.document import from_template, named
from tests.studio.test_session import Page, saved


@pytest.mark.slow
def test_a_drawn_region_holds_both_pivots_and_is_one_step_of_undo() -> None:
    page = Page()
    page.patient = False  # the first state alone
    before = page.state("open", name="motion-3-poses")
    assert before["pivots"] == [None, None, None, None]
    page.patient = True
    after = page.state("region", box=[-200.0, 0.0, 0.0, 200.0])
    assert after["pivots"] == [-200.0, 0.0, 0.0, 200.0]
    assert after["status"] == "verified"
    pivots = [after["scene"]["points"][name][0] for name in ("A", "D")]
    assert all(-200.001 <= x <= 0.001 and -0.001 <= y <= 200.001 for x, y in pivots)
    problem = saved(page)
    assert problem.raw["limits"]["pivots"] == {"x": ["-200 mm", "0 mm"], "y": ["0 mm", "200 mm"]}
    assert problem.raw["mechanism"]["pivot"] == [{"bounds": ["-200 mm", "0 mm"]}, {"bounds": ["0 mm", "200 mm"]}]
    page.patient = False
    assert page.state("undo")["pivots"] == [None, None, None, None]


def test_one_open_side_and_no_free_pivot() -> None:
    problem = from_template("path").problem
    assert region.shown(problem.override({"limits.pivots": {"y": ["10 mm", "90 mm"]}})) == [None, 10.0, None, 90.0]
    for fixed in ("path-watt-leg", "crank-rocker", "slider-crank"):
        assert region.shown(named(fixed).problem) is None


@pytest.mark.parametrize(
    ("name", "box", "words"),
    [
        ("motion-3-poses", [0.0, 0.0, 10.0], "four sides"),
        ("motion-3-poses", [0.0, 0.0, 10.0, "1"], "four sides"),
        ("motion-3-poses", [0.0, 0.0, float("nan"), 1.0], "four sides"),
        ("motion-3-poses", [0.0, 0.0, 0.0, 10.0], "the region is empty"),
        ("path-watt-leg", [0.0, 0.0, 10.0, 10.0], "no pivot of this problem may move"),
    ],
)
def test_an_unusable_region_is_refused_with_a_reason(name: str, box: list[object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        region.changes(named(name).problem, box)
