"""The Python interface: namespaces with names that complete, problems by name or path, one interface of all results."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from numpy.typing import NDArray

import optlink
from optlink.errors import InputError
from optlink.presentation.registry import KINDS as REGISTERED_RESULTS
from optlink.problem.document import Document, Result
from optlink.tasks.results.common import DesignResult
from tests.test_docs import ROOT

FILE = ROOT / "problems" / "slider-crank.toml"


@pytest.mark.parametrize("given", ["slider-crank", FILE, str(FILE)])
def test_a_problem_is_given_by_name_path_or_object(given: str | Path) -> None:
    expected = optlink.analyze(optlink.load("slider-crank"), points=12)["input.torque_Nm"]
    np.testing.assert_array_equal(optlink.analyze(given, points=12)["input.torque_Nm"], expected)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optlink.solve("crank-rokcer"), 'no such problem. Did you mean "crank-rocker"'),
        (lambda: optlink.solve(3), "problem = 3: not a problem. Give what optlink.load returns"),
        (lambda: optlink.simulate(optlink.analyze("six-bar", 12)), "not a problem. Of a result give its problem, or its machine"),
        (lambda: optlink.studies.sweep("no.toml", ["a=1"]), "no.toml"),
    ],
)
def test_what_is_no_problem_is_refused_in_a_sentence(call, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1


def test_motion_of_a_problem_is_that_of_its_linkage() -> None:
    angles = np.linspace(0.0, 6.0, 9)
    moved = optlink.motion("slider-crank", angles, speed=10.0)
    assert moved.position("B").shape == (9, 2)
    cycle = optlink.analyze("slider-crank", speed=10.0)
    whole = optlink.motion("slider-crank", np.radians(cycle["crank_angle_deg"]), speed=10.0)
    for k, axis in enumerate("xy"):
        np.testing.assert_allclose(whole.velocity("B")[:, k], cycle[f"B.v{axis}_m_s"], rtol=0, atol=1e-12)
        np.testing.assert_allclose(whole.acceleration("B")[:, k], cycle[f"B.a{axis}_m_s2"], rtol=0, atol=1e-10)


RESULTS = {
    "design": lambda: optlink.validate("crank-rocker", {"coupler": 0.412, "rocker": 0.232}),
    "analysis": lambda: optlink.analyze("shaper", 36),
    "simulation": lambda: optlink.simulate("six-bar", 0.05, 40),
    "sweep": lambda: optlink.studies.sweep("crank-rocker", ["limits.transmission_angle.min=30..40 deg:2"], workers=1),
    "sensitivity": lambda: optlink.studies.sensitivities("crank-rocker"),
}


@pytest.fixture(scope="module", params=RESULTS)
def result(request: pytest.FixtureRequest) -> Document:
    found: Document = RESULTS[request.param]()
    return found


MEMBERS = {name for kind in (Result, DesignResult) for name in vars(kind) if not name.startswith("_")}


def members_of(kind: str) -> set[str]:
    """What a registered class of results has, as a field or otherwise."""
    known = REGISTERED_RESULTS[kind].result()
    return {*dir(known), *(item.name for item in dataclasses.fields(known))}  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", REGISTERED_RESULTS)
def test_every_kind_of_result_keeps_the_protocol(kind: str) -> None:
    """`tests/test_types_of_examples.py` has a type checker compare the types too."""
    expected = {name for name in vars(Result) if not name.startswith("_")} | {"kind"}
    assert {"valid", "status", "plots"} <= expected
    assert (MEMBERS if kind in ("design", "balance") else expected) - members_of(kind) == set()


def test_every_result_is_valid_or_not_and_says_how_it_ended(result: Document) -> None:
    assert type(result.valid) is bool
    assert isinstance(result.status, str)
    document = result.to_dict()
    assert (document["valid"], document["status"]) == (result.valid, result.status)
    assert ("not valid" in repr(result)) is not result.valid


@pytest.mark.parametrize(
    ("kind", "former"), [("analysis", "sound"), ("simulation", "finished"), ("sweep", "successful"), ("sweep", "complete")]
)
def test_a_member_of_a_former_name_warns(kind: str, former: str) -> None:
    result = RESULTS[kind]()
    with pytest.warns(DeprecationWarning, match=rf"\.{former} is now valid$") as caught:
        assert getattr(result, former) == result.valid
    assert caught[0].filename == __file__


def test_an_unknown_member_of_a_result_is_named_with_the_closest_one() -> None:
    result = RESULTS["design"]()
    with pytest.raises(AttributeError, match=r"^SynthesisResult has no attribute 'desgin'\. Did you mean \"design\"\?$"):
        _ = result.desgin  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=r"no attribute 'zzz'$"):
        _ = result.zzz  # type: ignore[attr-defined]


def test_a_property_that_fails_is_not_called_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    result = RESULTS["design"]()
    monkeypatch.setattr(type(result), "figures", property(lambda result: result.best.nothing))
    with pytest.raises(AttributeError, match="LinkageDesign has no attribute 'nothing'"):
        _ = result.figures  # type: ignore[attr-defined]


def test_every_result_prints_as_its_command(result: Document, capsys: pytest.CaptureFixture[str]) -> None:
    from optlink.presentation.registry import table_of
    from optlink.presentation.terminal import show

    shown = table_of(result.kind)(result)
    show(shown.short or shown)
    assert str(result).splitlines() == [line.rstrip() for line in capsys.readouterr().out.rstrip("\n").split("\n")]
    assert "\n" not in repr(result)


def test_every_result_is_plotted(result: Document) -> None:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    assert result.plots
    assert isinstance(result.plot(), Axes)
    assert all(isinstance(result.plot(name), Figure) for name in result.plots)
    with pytest.raises(InputError, match=r"has no picture nothing\. Known: "):
        result.plot("nothing")


def joints_of(axes: Axes, names: str) -> dict[str, NDArray[np.float64]]:
    """Places [m] at which axes show joints: the rings with their names."""
    rings = [line for line in axes.lines if line.get_marker() == "o" and line.get_gid() in [*names]]
    return {str(line.get_gid()): 1e-3 * np.asarray(line.get_xydata())[0] for line in rings}


def test_a_linkage_is_drawn_into_axes_at_an_angle() -> None:
    from matplotlib.figure import Figure

    result = RESULTS["design"]()
    left, right = Figure().subplots(1, 2)
    assert result.plot(ax=right, angle=1.25) is right
    moved = optlink.motion(result.machine, [1.25])
    shown = joints_of(right, "ABCD")
    assert shown.keys() == {*"ABCD"}
    for name, at in shown.items():
        np.testing.assert_allclose(at, moved.position(name)[0], atol=1e-12)
    assert {text.get_text() for text in right.texts} >= {*"ABCD"}
    assert not left.lines
    with pytest.raises(InputError, match=r"has axes and positions of its own.*Leave the name out"):
        result.plot("law", ax=left)  # type: ignore[call-overload]


def test_a_linkage_is_drawn_where_its_joints_spread() -> None:
    result = RESULTS["design"]()
    angles = np.linspace(0.0, 2.0 * np.pi, 181)
    moved = optlink.motion(result.machine, angles)
    spread = [np.linalg.det(np.cov([moved.position(name)[k] for name in "ABCD"], rowvar=False)) for k in range(len(angles))]
    shown = np.linalg.det(np.cov([*joints_of(result.plot(), "ABCD").values()], rowvar=False))
    assert shown > 0.999 * max(spread)
    assert max(spread) > 1.5 * min(spread)


def test_a_position_out_of_reach_is_refused() -> None:
    result = optlink.analyze(optlink.load("slider-crank", {"drive.start": "20 deg", "drive.range": ["15 deg", "60 deg"]}), 12)
    with pytest.raises(InputError, match=r"angle = \"85\.9437 deg\": .*Give an angle within"):
        result.plot(angle=1.5)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda result: result.plot(angle=90), "angle = 90.0: 90 rad are 14.3 turns. .*90 deg are 1.5708"),
        (lambda result: optlink.export(result, "never.dxf", at=90, even_invalid=True), "at = 90.0: 90 rad are 14.3 turns"),
        (lambda result: result.plot(3), "name = 3: not the name of a picture. Axes are given as ax=axes"),
        (lambda result: result.plot(ax=np.zeros(2)), "ax = .*: no axes of matplotlib"),
        (lambda result: result.animate(10.5), "frames = 10.5: not a whole number"),
        (lambda result: result.to_latex(3), "buf = 3: no file"),
    ],
)
def test_an_argument_of_a_result_is_refused_in_a_sentence(call: Callable[[Any], object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        call(RESULTS["design"]())


def test_every_result_moves(result: Document) -> None:
    animation = result.animate(frames=3)
    page = animation._repr_html_()  # type: ignore[attr-defined]
    assert page.count("data:image/png;base64,") == 3
    with pytest.raises(InputError, match=r"frames = 1: out of range. Give 2 to"):
        result.animate(1)


def test_an_animation_shows_the_positions_of_the_motion(tmp_path: Path) -> None:
    result = optlink.analyze("slider-crank", 36)
    animation = result.animate(frames=4)
    animation.save(tmp_path / "motion.gif", writer="pillow")
    (axes,) = animation._fig.axes  # type: ignore[attr-defined]
    angle = np.radians(float(axes.get_title().rpartition(" ")[2].rstrip("°")))
    moved = optlink.motion("slider-crank", [angle])
    for name, at in joints_of(axes, "ABC").items():
        np.testing.assert_allclose(at, moved.position(name)[0], atol=1e-4)
    assert 4.0 < angle < 5.0  # the last of four quarters


def test_every_result_is_a_frame(result: Document, tmp_path: Path) -> None:
    import pandas

    frame = result.to_frame()
    assert len(frame) > 0
    for path in result.write(tmp_path / "out"):
        if path.suffix == ".csv":
            there = result.to_frame(path.stem).replace([np.inf, -np.inf], np.nan)  # empty cells
            pandas.testing.assert_frame_equal(there, pandas.read_csv(path), check_dtype=False)
    with pytest.raises(InputError, match=r"has no table nothing\. Known: "):
        result.to_frame("nothing")


def test_a_frame_has_the_units_of_the_file(result: Document) -> None:
    import pint

    pint_of = pint.UnitRegistry()
    one, other = result.to_frame(), result.to_frame(units="file")
    assert one.shape == other.shape
    changed = 0
    for before, after in zip(one, other, strict=True):
        units = [frame.attrs["units"].get(name, "") for frame, name in ((one, before), (other, after))]
        if units[0] == units[1]:
            assert before == after
            continue
        changed += 1
        first, second = (pint_of.parse_units(unit.replace("²", "**2")) for unit in units)
        expected = pint_of.Quantity(one[before].to_numpy(), first).to(second).magnitude
        np.testing.assert_allclose(other[after].to_numpy(), expected, rtol=1e-12)
    assert changed or type(result).__name__ in ("Sensitivities",)
    with pytest.raises(InputError, match=r"units = \"mm\": no such units"):
        result.to_frame(units="mm")


def test_units_of_columns() -> None:
    units = optlink.analyze("whitworth", 12).to_frame().attrs["units"]
    expected = {"crank.omega_rad_s": "rad/s", "B.vx_m_s": "m/s", "B.ax_m_s2": "m/s²", "ram.s_m": "m", "time_s": "s"}
    assert {name: units[name] for name in expected} == expected
    assert optlink.analyze("whitworth", 12).to_frame(units="file")["B.x_mm"].max() == pytest.approx(100.0)


def cells(text: str) -> list[list[str]]:
    """Cells of the lines of tables for LaTeX."""
    return [line.removesuffix(r" \\").split(" & ") for line in text.splitlines() if line.endswith(r"\\")]


def test_every_result_is_a_table_for_latex(result: Document, tmp_path: Path) -> None:
    text = result.to_latex(tmp_path / "table.tex")
    assert (tmp_path / "table.tex").read_text(encoding="utf-8") == text
    assert text.count(r"\toprule") == text.count(r"\bottomrule") == text.count(r"\begin{tabular}") >= 1
    assert text.isascii()
    assert not re.search(r"(?<!\\)[_#%]|(?<!\\)&(?! )", text)
    for part in re.findall(r"\\begin\{tabular\}\{(\w+)\}(.*?)\\end", text, re.DOTALL):
        assert {len(row) for row in cells(part[1]) if "multicolumn" not in row[0]} == {len(part[0])}


def test_a_latex_table_has_the_columns_of_the_frame_in_units_of_the_file() -> None:
    import io

    result, buffer = optlink.analyze("whitworth", 12), io.StringIO()
    names = ["crank_angle_deg", "B.x_m", "input.torque_Nm"]
    text = result.to_latex(buffer, columns=names)
    assert buffer.getvalue() == text
    head, *rows = cells(text)
    assert head == [r"crank\_angle [deg]", "B.x [mm]", r"input.torque [N\textperiodcentered{}m]"]
    frame = result.to_frame(units="file")[["crank_angle_deg", "B.x_mm", "input.torque_Nm"]]
    read = [[float(cell.strip("$")) for cell in row] for row in rows]
    np.testing.assert_allclose(read / frame.abs().max().to_numpy(), frame / frame.abs().max(), atol=1e-4)
    for column in zip(*rows, strict=True):
        assert len({len(cell.strip("$").partition(".")[2]) for cell in column}) == 1
    assert result.to_latex(columns=["crank_angle_deg", "B.x_mm", "input.torque_Nm"]) == text
    with pytest.raises(InputError, match=r"no such column. Did you mean"):
        result.to_latex(columns=["B.x_mn"])


def test_a_study_is_ready_to_print() -> None:
    sweep = RESULTS["sweep"]()
    frame, text = sweep.to_frame(units="file"), sweep.to_latex(columns=["coupler_mm", "objective_rad2", "active"])
    assert frame["objective_rad2"].to_numpy() == pytest.approx(sweep.columns["objective_rad2"], rel=1e-12)  # type: ignore[attr-defined]
    assert r"\begin{tabular}{rrl}" in text
    assert r"objective [rad\textsuperscript{2}]" in text


def test_latex_of_a_design_has_its_sizes_and_limits() -> None:
    result = RESULTS["design"]()
    rows = cells(result.to_latex())
    assert ["coupler", "412.000", "mm", "free, 100 ... 900"] in rows


def test_letters_that_latex_reads_as_commands_are_escaped() -> None:
    from optlink.presentation.latex import escaped

    assert escaped(r"50 % of A_1 & \x{y} ^2 ≤ 3°") == (
        r"50 \% of A\_1 \& \textbackslash{}x\{y\} \textasciicircum{}2 $\leq$ 3\textdegree{}"
    )


def test_a_missing_pandas_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r'pip install "\.\[frame\]"'):
        optlink.analyze("shaper", 12).to_frame()


@pytest.mark.slow
def test_report_and_export_take_results_and_problems(tmp_path: Path) -> None:
    result = RESULTS["analysis"]()
    assert optlink.report(result, tmp_path / "one.html", {"author": "A. Designer"}).read_text().count("A. Designer") >= 1
    assert optlink.report("shaper", str(tmp_path / "two.html")).is_file()
    for suffix in ("dxf", "svg", "csv", "json"):
        assert optlink.export(result, tmp_path / f"shaper.{suffix}").stat().st_size > 100
    sources = optlink.analyze("shaper"), "shaper"
    one, other = (optlink.export(source, tmp_path / f"{k}.svg", at=0.5) for k, source in enumerate(sources))
    assert one.read_text() == other.read_text()
    with pytest.raises(InputError, match="not a single design"):
        optlink.export(RESULTS["sweep"](), tmp_path / "no.svg")
    invalid = optlink.validate("crank-rocker", {"coupler": 0.412, "rocker": 0.232})
    with pytest.raises(InputError, match="Nothing was written"):
        optlink.export(invalid, tmp_path / "no.svg")
    assert optlink.export(invalid, tmp_path / "yes.svg", even_invalid=True).is_file()
    with pytest.raises(InputError, match=r"unknown key|facts"):
        optlink.report("shaper", tmp_path / "no.html", {"autor": "x"})
    assert not (tmp_path / "no.svg").exists()
    assert not (tmp_path / "no.html").exists()


def test_first_designs_of_a_search() -> None:
    one, two = (optlink.synthesis.starts("path-arc5", rounds) for rounds in (1, 2))
    assert [first.cost for first in one] == sorted(first.cost for first in one)
    assert len(two) >= len(one)
    problem = optlink.load("path-arc5", {"mechanism.assembly": one[0].assembly})
    checked = optlink.validate(problem, one[0].design)
    assert checked.objective < 1e-4  # [m]
    with pytest.raises(InputError, match="no targets"):
        optlink.synthesis.starts("shaper-design")
