"""Pictures of a balanced machine show what they claim: curves are the columns, discs are to scale, labels are legible."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.text import Text
from PIL import Image

import optlink
from optlink.dynamics.columns import MotionColumns
from optlink.presentation import terminal
from optlink.presentation.chart_mpl import pictures
from optlink.presentation.registry import view_of
from optlink.presentation.views import balance, balance_drawing
from tests.solved import once

SPRUNG = {
    "gravity": "9.81 m/s^2",
    "balance.objective": "rms torque",
    "balance.counterweights": [{"body": "rocker", "kind": "free", "extent": "50 mm", "mass": {"max": "0.3 kg"}}],
    "balance.springs": [{"name": "tie", "between": ["D", "B"], "stiffness": {"max": "5 N/m"}}],
    "balance.limits": {"peak torque": "90 %"},
}


@functools.cache
def result(name: str = "balance-six-bar", changed: bool = False) -> optlink.Balance:
    problem = optlink.load(name, SPRUNG if changed else None)
    return once(f"balance of {name}, {changed}", lambda: optlink.balance(problem, None, "force,torque", 7))


@functools.cache
def charts(name: str, changed: bool) -> dict[str, Figure]:
    return pictures(balance.charts(result(name, changed)))


@functools.cache
def drawn(picture: str, name: str = "balance-six-bar", changed: bool = False) -> Figure:
    figure = balance_drawing.mechanism(result(name, changed)) if picture == "mechanism" else charts(name, changed)[picture]
    assert figure is not None
    figure.draw_without_rendering()
    return figure


def lines(figure: Figure, gid: str) -> list[Line2D]:
    return [line for axes in figure.axes for line in axes.get_lines() if line.get_gid() == gid]


CASES = [("balance-six-bar", False), ("balance-four-bar", False), ("balance-four-bar", True)]


@pytest.mark.slow
@pytest.mark.parametrize("picture", ["before_after", "hodograph", "mechanism", "trade"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case)))
def test_bars_beyond_the_axes_are_not_clipped_silently(picture, case):
    figure = drawn(picture, *case)
    whole = figure.bbox
    ticks = {label for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for label in axis.get_ticklabels(which="both")}
    texts = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip() and text not in ticks]
    assert texts
    for text in texts:
        box = text.get_window_extent()
        if box.width > 0.0:
            assert box.x0 >= whole.x0 - 2.0, text.get_text()
            assert box.x1 <= whole.x1 + 2.0, text.get_text()
            assert box.y0 >= whole.y0 - 2.0, text.get_text()
            assert box.y1 <= whole.y1 + 2.0, text.get_text()


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["shaking moment", "torque"])
def test_curves_show_the_machine_before_and_after_balancing(quantity):
    """Against the inverse dynamics at the drawn crank angles, in the unit of the axis."""
    outcome, figure = result(), drawn("before_after")
    for name, machine in (("initial", outcome.original), ("balanced", outcome.heavier)):
        line = lines(figure, f"{name} {quantity}")[0]
        x, y = (np.asarray(part, dtype=float) for part in (line.get_xdata(), line.get_ydata()))
        column = "input.torque_Nm" if quantity == "torque" else "frame.shaking_moment_Nm"
        expected = MotionColumns(machine.moving(np.radians(x), outcome.speed))[column]
        assert "[N·m]" in line.axes.get_ylabel()
        assert y == pytest.approx(expected, rel=1e-9, abs=1e-9 * float(np.max(np.abs(expected))))
        assert abs(x[-1] - x[0]) == pytest.approx(360.0)


@pytest.mark.slow
def test_a_limit_is_a_line_on_either_side():
    figure = drawn("before_after", "balance-four-bar", True)
    outcome = result("balance-four-bar", True)
    bound = next(limit.bound for limit in outcome.limits if limit.name == "peak torque")
    heights = sorted(float(np.asarray(line.get_ydata())[0]) for line in lines(figure, "limit"))
    assert len(heights) == 2
    assert heights[0] == -heights[1]
    torque = lines(figure, "balanced torque")[0]
    factor = float(np.max(np.abs(np.asarray(torque.get_ydata())))) / float(np.max(np.abs(outcome.columns["after.torque_Nm"])))
    assert heights[1] == pytest.approx(bound * factor, rel=1e-9)
    assert float(np.max(np.abs(np.asarray(torque.get_ydata())))) <= heights[1] * (1.0 + 1e-6)


@pytest.mark.slow
def test_discs_are_to_scale_and_in_their_place():
    """Radius from the mass; the centre lies where body axes put it, in both positions."""
    outcome, figure = result(), drawn("mechanism")
    for axes, angle in zip(figure.axes, (62.0, 242.0), strict=True):
        assert axes.get_aspect() == 1.0
        discs = {patch.get_gid(): patch for patch in axes.patches if isinstance(patch, Circle)}
        assert set(discs) == {f"counterweight {one.body}" for one in outcome.added}
        for one in outcome.added:
            patch = discs[f"counterweight {one.body}"]
            assert patch.radius == pytest.approx(1e3 * math.sqrt(one.mass / (math.pi * 7850.0 * 0.04)), rel=1e-9)
            if one.body == "crank":
                turned = complex(*one.place) * np.exp(1j * math.radians(angle)) * 1e3
                assert complex(*patch.center) == pytest.approx(turned, rel=1e-9)
            (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
            assert x0 < patch.center[0] - patch.radius < patch.center[0] + patch.radius < x1
            assert y0 < patch.center[1] - patch.radius < patch.center[1] + patch.radius < y1


@pytest.mark.slow
def test_a_free_weight_is_dashed_and_a_spring_is_drawn():
    figure, outcome = drawn("mechanism", "balance-four-bar", True), result("balance-four-bar", True)
    assert outcome.added[0].radius is None
    patch = next(p for p in figure.axes[0].patches if isinstance(p, Circle))
    assert patch.get_linestyle() == "--"
    assert patch.radius == pytest.approx(1e3 * outcome.added[0].gyration, rel=1e-9)
    if outcome.springs:
        assert any(artist.get_gid() == "tie" for artist in figure.axes[0].get_children())


def test_hodograph_has_equal_scales_and_both_paths():
    figure, outcome = drawn("hodograph"), result()
    axes = figure.axes[0]
    assert axes.get_aspect() == 1.0
    for when, name in (("before", "initial"), ("after", "balanced")):
        x, y = (np.asarray(part) for part in lines(figure, f"hodograph {name}")[0].get_data())
        assert x[:-1] == pytest.approx(outcome.columns[f"{when}.shaking_force_x_N"])
        assert y[:-1] == pytest.approx(outcome.columns[f"{when}.shaking_force_y_N"])
        assert (x[0], y[0]) == (x[-1], y[-1])


@pytest.mark.slow
def test_complete_balance_is_shown_as_zero():
    texts = [text.get_text() for text in drawn("hodograph", "balance-four-bar").findobj(Text)]
    assert "balanced: at most 0" in texts


def test_trade_off_marks_ends_knee_and_initial_machine():
    figure, outcome = drawn("trade"), result().trade
    axes = figure.axes[0]
    x, y = (np.asarray(part) for part in lines(figure, "realised")[0].get_data())
    assert x == pytest.approx([point.realised[0] for point in outcome.points])
    assert y == pytest.approx([point.realised[1] for point in outcome.points])
    given = lines(figure, "initial")[0].get_data()
    assert (given[0][0], given[1][0]) == pytest.approx(outcome.before)
    printed = " ".join(text.get_text() for text in axes.texts)
    for words in ("least shaking force", "least torque", "knee", "initial machine"):
        assert words in printed
    masses = lines(figure, "mass crank")[0].get_ydata()
    assert np.asarray(masses) == pytest.approx([point.masses.get("crank", 0.0) for point in outcome.points])


def test_no_pictures_without_data():
    limits = {"balance.limits": {"rms shaking force": "1 %"}}
    nothing = optlink.balance(optlink.load("balance-six-bar", limits))
    assert nothing.status == "infeasible"
    assert nothing.plots == ()


@pytest.mark.slow
def test_files_can_be_opened(tmp_path):
    for path in view_of("balance").write(result(), tmp_path):
        assert path.stat().st_size > 100
        if path.suffix == ".png":
            with Image.open(path) as picture:
                assert min(picture.size) > 500


@pytest.mark.slow
def test_table_fits_the_narrowest_terminal():
    """No figure of the table is broken over two lines."""
    console = terminal.console()
    for case in CASES:
        with console.capture() as capture:
            console.print(terminal.rendered(balance.overview(result(*case))))
        text = capture.get()
        row = next(line for line in text.splitlines() if line.startswith(" torque"))
        assert row.rstrip().endswith("N·m")
        assert len(row.split()) == 8
