"""A chart is described once: the picture and the page show the same curves, bars, bands, maps, lines and labels."""

import math

import numpy as np
import pytest

from optlink.presentation import chart_mpl
from optlink.presentation.chart_spec import (
    Axis,
    Band,
    Bars,
    ChartSpec,
    Curve,
    HeatMap,
    Line,
    Mark,
    Panel,
    Picks,
    Span,
    cells,
    crank_angle,
)
from optlink.presentation.format import pretty
from optlink.presentation.html import chart_plotly
from optlink.presentation.html.study_page import drawn
from optlink.presentation.view import PageSection

X = np.linspace(0.0, 360.0, 91)
Y = np.sin(np.radians(X))


def over_the_crank(**more) -> ChartSpec:
    curves = [Curve(X, np.where(X < 90.0, np.nan, Y), "output", gid="output"), Band(X, Y - 0.1, Y + 0.1, "scatter", "#2c6fbb")]
    top = Panel(Axis("angle [deg]"), curves, 1.5, [Line(0.9, "limit", "#c0392b")], [Mark(90.0, 1.0, "largest 1°", gid="top")])
    below = Panel(Axis("error [deg]", (0.0, 0.5)), [Bars(X[::30], np.abs(Y[::30]), "error", width=10.0, gid="bars")])
    return ChartSpec("law", "Law", [top, below], crank_angle(), "Machine: law", lines=[Line(180.0, "dead centre")], **more)


def test_picture_and_page_write_units_with_their_signs() -> None:
    panel = Panel(Axis("objective [rad^2]"), [Curve(X, Y, "torque <= 2 N*m"), Curve(X, Y, "other")])
    spec = ChartSpec("front", "Front", [panel], Axis("moment of inertia [kg*m^2]"), "Machine: front")
    axes, page = chart_mpl.pictures([spec])["front"].axes[0], chart_plotly.chart(spec).figure
    names = (axes.get_ylabel(), axes.get_xlabel(), axes.get_legend().get_texts()[0].get_text())
    assert names == ("objective [rad²]", "moment of inertia [kg·m²]", "torque ≤ 2 N·m")
    written = (page["layout"]["yaxis"]["title"]["text"], page["layout"]["xaxis"]["title"]["text"], page["data"][0]["name"])
    assert written == names


def test_picture_and_page_show_the_same_values() -> None:
    spec = over_the_crank(spans=[Span(0.0, 90.0, "quick")])
    (picture,) = chart_mpl.pictures([spec]).values()
    page = chart_plotly.chart(spec)
    (line,) = (line for line in picture.axes[0].get_lines() if line.get_gid() == "output")
    trace = next(trace for trace in page.figure["data"] if trace["name"] == "output")
    shown = np.array([np.nan if y is None else y for y in trace["y"]])
    np.testing.assert_allclose(shown, np.asarray(line.get_ydata()), atol=1e-6)
    assert np.isnan(shown[0])
    for number, axes in enumerate(picture.axes):
        assert page.figure["layout"][f"yaxis{number + 1 if number else ''}"]["title"]["text"] == axes.get_ylabel()
    assert picture.axes[-1].get_xlabel() == page.figure["layout"]["xaxis"]["title"]["text"] == "crank angle φ [deg]"
    entries = {text.get_text() for axes in picture.axes for text in axes.get_legend().get_texts()}
    assert entries == {trace["name"] for trace in page.figure["data"] if trace["name"] and trace.get("showlegend", True)}
    assert [text.get_text() for text in picture.axes[0].texts] == ["largest 1°"]
    assert "largest 1°" in str(page.figure["data"])
    assert sorted(text.get_text() for text in picture.axes[1].texts) == ["↑ 0.866", "↑ 0.866", "↑ 1"] or picture.axes[1].texts
    shapes = page.figure["layout"]["shapes"]
    assert len(shapes) == 2
    swatch = next(trace for trace in page.figure["data"] if trace["name"] == "quick")["marker"]
    assert [(swatch["color"], swatch["opacity"])] == [(one["fillcolor"], one["opacity"]) for one in shapes if "fillcolor" in one]


def test_the_crank_turning_clockwise_runs_to_the_right() -> None:
    spec = ChartSpec("a", "A", [Panel(Axis("y"), [Curve(X, Y)])], crank_angle(clockwise=True))
    left, right = chart_mpl.draw([spec]).axes[0].get_xlim()
    assert left > right
    assert chart_plotly.chart(spec).figure["layout"]["xaxis"]["autorange"] == "reversed"


def test_markers_at_the_ends_of_a_curve_are_whole() -> None:
    spec = ChartSpec("a", "A", [Panel(Axis("y"), [Curve(X, Y, mode="lines+markers")])], Axis("x"))
    left, right = chart_mpl.draw([spec]).axes[0].get_xlim()
    assert left < X[0]
    assert right > X[-1]


@pytest.mark.parametrize(("entries", "columns"), [(3, 3), (8, 4), (9, 5), (13, 7)])
def test_rows_of_a_legend_are_equally_long(entries: int, columns: int) -> None:
    curves = [Curve(X, Y + k, f"joint {k}") for k in range(entries)]
    legend = chart_mpl.draw([ChartSpec("a", "A", [Panel(Axis("y"), curves)], Axis("x"))]).axes[0].get_legend()
    assert legend._ncols == columns


def test_relations_have_their_signs() -> None:
    assert pretty("M <= 5 N m; x >= 1 mm^2; B -> D") == "M ≤ 5 N·m; x ≥ 1 mm²; B → D"
    assert pretty("361.1 mN m, 2 kN*m per N m") == "361.1 mN·m, 2 kN·m per N·m"


@pytest.mark.slow
def test_charts_of_one_file_share_a_picture() -> None:
    specs = [over_the_crank(), over_the_crank(row=1), over_the_crank(row=1, page=False)]
    pictures = chart_mpl.pictures(specs)
    assert list(pictures) == ["law"]
    assert len(pictures["law"].axes) == 6
    assert len(drawn([PageSection("Curves", specs)])[0].parts) == 2


@pytest.mark.parametrize("log", [False, True])
def test_a_map_has_cells_around_its_places(log: bool) -> None:
    x = np.array([1.0, 2.0, 4.0])
    z = np.array([[1.0, 2.0, np.nan], [3.0, 4.0, 5.0]])
    picks = Picks("point", ("x",), (("1",), ("2",)), np.array([1.0, 2.0]), np.array([10.0, 20.0]))
    trace = HeatMap(x, np.array([10.0, 20.0]), z, "objective [mm]", picks=[[0, None, None], [None, 1, None]])
    spec = ChartSpec("map", "Map", [Panel(Axis("b"), [trace])], Axis("a", scale="log" if log else "linear"), picks=picks)
    page, picture = chart_plotly.chart(spec), chart_mpl.draw([spec])
    assert page.figure["data"][0]["z"][0][2] is None
    assert page.figure["data"][-1]["x"] == [1.0]  # the mark of the selected point is the last trace
    low, high = picture.axes[0].get_xlim()
    edges = cells(x, log=log)
    assert (low, high) == pytest.approx((edges[0], edges[-1]))
    assert edges == pytest.approx(2.0 ** np.array([-0.5, 0.5, 1.5, 2.5]) if log else [0.5, 1.5, 3.0, 5.0])


def test_a_constant_is_a_straight_line() -> None:
    """Its rounding has no scale of its own; a limit beside it stays in sight."""
    noisy = [Curve(X, 0.153397 * (1.0 + 1e-16 * np.sign(Y)))]
    low, high = Panel(Axis("objective [m]"), noisy).y.limits or (0.0, 0.0)
    assert (low, high) == pytest.approx((0.98 * 0.153397, 1.02 * 0.153397))
    assert Panel(Axis("objective [m]"), noisy, lines=[Line(0.2, "limit")]).y.limits is None
    assert Panel(Axis("objective [m]"), [Curve(X, 1.0 + 1e-6 * Y)]).y.limits is None


@pytest.mark.parametrize("names", [("across the curve, to the left", "along the curve, forward"), ("a", "b"), tuple("abcdefgh")])
def test_legends_between_panels_have_room_on_a_phone(names):
    """A legend grows upwards from its panel; where the page is narrow its entries stand below one another."""
    x = np.linspace(0.0, 1.0, 5)
    panels = [Panel(Axis("y"), [Curve(x, x + k, name) for k, name in enumerate(labels)]) for labels in (("",), names)]
    layout = chart_plotly.chart(ChartSpec("file", "two panels", panels, Axis("x"))).figure["layout"]
    inner = layout["height"] - layout["margin"]["t"] - layout["margin"]["b"]
    (low, high), (other, below) = layout["yaxis"]["domain"], layout["yaxis2"]["domain"]
    columns = max(1, int(270 / (45 + 6.5 * max(map(len, names)))))
    assert (low - below) * inner >= 19.0 * math.ceil(len(names) / columns)
    assert high - low == pytest.approx(below - other)
    assert other == pytest.approx(0.0, abs=1e-9)
