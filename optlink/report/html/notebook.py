"""Results and problems in a notebook: table, linkage and chart of a result, sliders for dimensions and limits of a problem."""

from __future__ import annotations

import asyncio
import io
import json
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optlink.errors import InputError, OptlinkError
from optlink.problem.base_model import Contradiction
from optlink.problem.file import ProblemFile
from optlink.report.chart_spec import ChartSpec
from optlink.report.export.svg import svg
from optlink.report.html.moving_linkage import Moving
from optlink.report.html.page import animation_of
from optlink.report.html.shell import asset, fragment, templates
from optlink.report.registry import schema_of, table_of, view_of
from optlink.report.report_model import report_model_of
from optlink.report.stored.loader import STUDIES, WITH_PAGE
from optlink.report.table_spec import Part, TableSpec
from optlink.report.views import analysis_forces, function_tables
from optlink.studies.toml_keys import Knob, exact_text, knobs
from optlink.tasks.analyze import analyze
from optlink.tasks.function import FunctionResult
from optlink.tasks.results.analysis import Analysis
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.path import PathResult
from optlink.tasks.run import solve, validate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEPS = 120  # positions per revolution


def notebook_html(result: Any) -> str | None:
    """Return the drawings and the tables of a result as HTML; None for a kind without a table."""
    schema = schema_of(type(result).record)
    if schema not in WITH_PAGE:
        return None
    _, kind = WITH_PAGE[schema]
    shown = table_of(kind)(result)
    moving = _moving(kind, result, study=schema in STUDIES)
    linkage = "" if moving is None else moving_html(moving, result.problem.model.title)
    chart = _chart(kind, result) if moving is None or schema in STUDIES else ""
    return fragment(shown.status) + linkage + chart + fragment(*shown.parts)


def moving_html(moving: Moving, title: str) -> str:
    """Return a linkage that a slider moves, as HTML for any number of outputs of a notebook."""
    motion = json.dumps(moving.to_dict(), separators=(",", ":"), allow_nan=False)
    script = asset("motion.js") + asset("notebook.js")
    text = templates().get_template("notebook.html").render(moving=moving, title=title, motion=motion, script=script)
    return text.replace("\n\n", "\n")


def _moving(kind: str, result: Any, *, study: bool) -> Moving | None:
    """Return the moving linkage of a result; None if it has none, or cannot be assembled."""
    try:
        if study:
            return view_of(kind).page(type(result).record.of(result), result.problem, Path("result.json")).moving(STEPS)
        drawn = isinstance(result, FunctionResult | PathResult | CycleResult | Analysis)
        return animation_of(report_model_of(result.problem, result), STEPS) if drawn else None
    except (InputError, Contradiction):  # a design that cannot be assembled, a study without a design
        return None


def _chart(kind: str, result: Any) -> str:
    """Return the first chart or drawing of a result as SVG; an empty text if it has none."""
    view = view_of(kind)
    drawings = (fig for drawing in view.drawings.values() if (fig := drawing(result)) is not None)
    return chart_svg(view.charts(view.model(result))) or next(map(_svg, drawings), "")


def chart_svg(charts: Iterable[ChartSpec]) -> str:
    """Return the first of several charts as SVG; an empty text if there is none."""
    from optlink.report.chart_mpl import draw

    return next((_svg(draw([chart])) for chart in charts), "")


def _svg(figure: Figure) -> str:
    from matplotlib import rc_context
    from matplotlib.text import Text

    from optlink.report.style import apply_style

    text = io.StringIO()
    for text_artist in figure.findobj(Text):
        text_artist.set_path_effects([])
    # Letters as text have a tenth of the size of outlines; without a salt, no other picture has the same names.
    with apply_style(), rc_context({"svg.fonttype": "none", "svg.hashsalt": None}):
        figure.savefig(text, format="svg")
    shown = text.getvalue()[text.getvalue().index("<svg") :]
    return re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), shown)  # a hundredth of a point is enough


PAUSE = 0.15  # s without a change of a slider before anything is computed
SLIDER_STEPS = 20_000  # steps of a slider: its front end rounds to them, so that they are finer than what is shown
SHOWN_TABLES = ("Conflicting limits", "Objective", "Working and return")  # tables of the current design
LIVE_KINDS = ("function",)  # kinds of problems that are optimised again in about a tenth of a second
STYLE = "<style>.optlink-bad,.optlink-figures .bad{color:#b3261e}.optlink-figures .good{color:#1e7b34}</style>"


class Explorer:
    """Sliders of every dimension and limit of a problem, its linkage in motion, and the checks of its current result.

    A slider of a design variable changes the design, which is validated. A slider of a fixed dimension or of a limit changes
    the problem, which is optimised again: at once for a function of a four-bar, else at the button. Machines without design
    variables are analysed. The default of the initial design is the optimum of a function, path or motion problem, or the
    starting values of a machine.

    Attributes
    ----------
    sliders : dict
        Sliders by the name of a design variable, or by the key of a fixed dimension or limit.
    panel : ipywidgets.Box
        What a notebook shows.
    """

    def __init__(self, problem: ProblemFile, design: Mapping[str, float] | None = None) -> None:
        self._widgets = _ipywidgets()
        self._file, self._problem = problem, problem
        self._designed = problem.task not in ("analysis", "balance")
        self._changes: dict[str, str | float] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._setting = self._moved = False
        self._rest: dict[str, float] = {}  # exact values of the sliders
        free = problem.model.quantities
        self._design = {name: free[name].value for name in problem.model.free} | dict(design or {})
        self.knobs = {knob.key or knob.name: knob for knob in knobs(problem)}
        self.sliders = {key: self._slider(key, knob) for key, knob in self.knobs.items()}
        self._build()
        if self._designed and design is None and problem.task != "cycle":
            self.optimise()
        else:
            self.update()

    @property
    def problem(self) -> ProblemFile:
        """The problem with the values of the sliders."""
        self._finish()
        return self._problem

    @property
    def result(self) -> Any:
        """The current design."""
        self._finish()
        return self._result

    def _finish(self) -> None:
        """Compute at once what waits for the sliders to rest."""
        if self._timer is not None:
            self.update()

    # --- the widgets ---------------------------------------------------------------------------------------------------------

    def _slider(self, key: str, knob: Knob) -> Any:
        self._rest[key] = knob.value
        slider = self._widgets.FloatSlider(
            value=knob.value,
            min=knob.low,
            max=knob.high,
            step=(knob.high - knob.low) / SLIDER_STEPS,
            description=f"{knob.name} [{knob.unit}]" if knob.unit else knob.name,
            readout_format=".5g",
            style={"description_width": "220px"},
            layout={"width": "490px"},
        )
        slider.observe(lambda change: self._change(key, change["new"]), names="value")
        return slider

    def _build(self) -> None:
        widgets, title = self._widgets, self._widgets.HTML
        self.status, self.drawing, self.angle, self.chart = title(), title(), title(), title()
        self.crank = widgets.IntSlider(max=STEPS, description="crank", readout=False, layout={"width": "360px"})
        self.crank.observe(lambda _: self._draw(), names="value")
        self.play = widgets.Play(max=STEPS, interval=50, repeat=True)
        self.link = widgets.jslink((self.play, "value"), (self.crank, "value"))
        self.live = widgets.Checkbox(
            value=self._file.task in LIVE_KINDS,
            description="optimise at every change of a fixed dimension or limit",
            indent=False,
            layout={"width": "auto"},
        )
        self.button = widgets.Button(description="Optimise", button_style="primary", tooltip="Search the best design")
        self.button.on_click(lambda _: self.optimise())
        groups: dict[str, list[Any]] = {}
        for key, knob in self.knobs.items():
            group = "Design variables" if not knob.key else "Limits" if knob.key.startswith("limits.") else "Fixed dimensions"
            groups.setdefault(group if self._designed else "Dimensions", []).append(self.sliders[key])
        rows = [row for name, sliders in groups.items() for row in (title(f"<b>{name}</b>"), *sliders)]
        rows += [self.button, self.live] if self._designed else []
        left = widgets.VBox(rows, layout={"max_height": "620px", "overflow": "auto", "min_width": "520px"})
        stage = widgets.VBox([self.drawing, widgets.HBox([self.play, self.crank]), self.angle, self.status])
        self.panel = widgets.VBox([widgets.HBox([left, stage]), self.chart])

    def _repr_mimebundle_(self, **options: Any) -> dict[str, Any]:
        """Return the widgets, and the current result for a notebook without a kernel."""
        shown = self.panel._repr_mimebundle_(**options)
        return {**shown, "text/html": notebook_html(self.result), "text/plain": repr(self)}

    def __repr__(self) -> str:
        return f"<Explorer of {self.result!r}>"

    # --- changes -------------------------------------------------------------------------------------------------------------

    def _change(self, key: str, value: float) -> None:
        """Take the new value of a slider, and compute once the sliders rest."""
        knob = self.knobs[key]
        if self._setting or abs(value - self._rest[key]) <= 0.51 * self.sliders[key].step:  # the echo of a rounded value
            return
        self._rest[key] = value
        if knob.key:
            self._changes[knob.key] = exact_text(value, knob.unit)
            self._moved = True
        else:
            self._design[knob.name] = value * knob.size
        self._later(self.update)

    def _later(self, action: Callable[[], None]) -> None:
        """Call an action after a pause without further calls; at once where no event loop runs."""
        if self._timer is not None:
            self._timer.cancel()
        try:
            loop = asyncio.get_running_loop()
        except RuntimeError:
            action()
            return
        self._timer = loop.call_later(PAUSE, action)

    def update(self) -> None:
        """Compute the result for the values of the sliders."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        moved_meanwhile, self._moved = self._moved and self._designed and self.live.value, False
        if moved_meanwhile:
            self.optimise()
        else:
            self._compute(self._current)

    def optimise(self) -> None:
        """Search the best design of the current problem, and set the sliders to it."""
        self._compute(lambda problem: solve(problem))
        if self._designed and self._result.design:
            self._design = {name: self._result.design[name] for name in self._file.model.free}
            self._setting = True
            for name, value in self._design.items():
                self._rest[name] = self.sliders[name].value = value / self.knobs[name].size
            self._setting = False

    def _current(self, problem: ProblemFile) -> Any:
        return validate(problem, self._design) if self._designed else analyze(problem)

    def _compute(self, compute: Callable[[ProblemFile], Any]) -> None:
        """Show the result of the changed problem; on bad input show the reason and keep the last one."""
        begin = time.perf_counter()
        try:
            problem = self._file.override(self._changes) if self._changes else self._file
            result = compute(problem)
        except OptlinkError as error:
            if not hasattr(self, "_result"):
                raise
            self.status.value = f'{STYLE}<p class="optlink-bad">{escape(str(error))}</p>'
            return
        self._problem, self._result, self._seconds = problem, result, time.perf_counter() - begin
        self._show()

    # --- what is shown -------------------------------------------------------------------------------------------------------

    def _show(self) -> None:
        kind = "analysis" if isinstance(self._result, Analysis) else self._problem.task
        shown = table_of(kind)(self._result)
        self.status.value = f'{STYLE}<div class="optlink-figures">{fragment(shown.status, *self._figures(shown.parts))}</div>'
        self._moving: Moving | None = animation_of(report_model_of(self._problem, self._result), STEPS)
        if self._moving is not None:
            self.crank.max = self.play.max = len(self._moving.stops.values) - 1
        self._draw()
        view = view_of(kind)
        model = view.model(self._result)
        torque = analysis_forces.torque(model) if kind == "analysis" else []
        self.chart.value = chart_svg(torque or view.charts(model))

    def _figures(self, parts: tuple[Part, ...]) -> Iterator[Part]:
        """Yield the failed checks and the conflicting limits of a design, its objective, and strokes."""
        checked = getattr(getattr(self._result, "best", self._result), "validation", None)
        checks = () if checked is None else checked.checks
        failed = [check for check in checks if not check.passed]
        if failed:
            title = f"{len(failed)} of {len(checks)} checks fail"
            yield replace(function_tables.checks(failed), title=title, appendix=False)
        for part in parts:
            if isinstance(part, TableSpec) and part.title.startswith(SHOWN_TABLES):
                yield part

    def _draw(self) -> None:
        """Draw the linkage at the crank angle of the slider."""
        moving = self._moving
        if moving is None:
            self.drawing.value = f'{STYLE}<p class="optlink-bad">This linkage cannot be assembled.</p>'
            self.angle.value = ""
            return
        k = min(self.crank.value, len(moving.stops.values) - 1)
        drawing = svg(moving.scene, self._problem.model.title, k=k)
        self.drawing.value = f'<div style="width:560px;background:#fff;color:#222">{drawing}</div>'
        values = (f"{readout.name} {readout.text(k)} {readout.shown_unit}" for readout in moving.readouts)
        self.angle.value = escape(" · ".join((moving.stops.text(k), *values)))


def _ipywidgets() -> Any:
    try:
        import ipywidgets
    except ImportError:
        remedy = 'Install it: pip install "optlink[notebook]"'
        raise InputError("explore needs the package ipywidgets, which is not installed", remedy) from None
    return ipywidgets
