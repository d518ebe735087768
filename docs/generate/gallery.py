"""Gallery of the shipped problems: picture, one sentence and command of each.

A design problem is solved with a short search, and only a valid design is drawn; a machine is analysed.
"""

from __future__ import annotations

import html
import io
import itertools
import re
from typing import Any

import matplotlib as mpl
import numpy as np

import optlink
from optlink.linkage.motion import Motion, sweep
from optlink.presentation.drawing import Sketch
from optlink.presentation.report_model import report_model_of, solve_or_validate
from optlink.presentation.style import TARGET, apply_style
from optlink.presentation.views.design_view import DesignView, best
from optlink.tasks.results.design import SynthesisResult

FOLDER = "images/gallery"
SIZE = (3.3, 2.5)  # inch
SHARE = 0.045  # height of a ground pivot, as a share of the extent of a mechanism
SHORT = 45  # characters of a sentence that says too little on its own
STARTS = 1  # random starting points of a search, in whole rounds

GROUPS = {
    "function": "Motion laws and functions by a four-bar",
    "path": "Paths, poses, laws of other linkages",
    "cycle": "Machines optimised over their cycle",
    "balance": "Balancing",
    "clearance": "Joint clearance",
    "analysis": "Machines to analyse and simulate",
}
COMMANDS = {"clearance": "simulate", "analysis": "analyze", "balance": "balance"}


def group_of(problem: optlink.ProblemFile) -> str:
    """Return the group of a problem.

    Parameters
    ----------
    problem : ProblemFile
    """
    gaps = any(joint.clearance is not None for joint in problem.model.joints.values())
    return "clearance" if gaps else problem.task


def command_of(problem: optlink.ProblemFile) -> str:
    """Return the command that computes a shipped problem.

    Parameters
    ----------
    problem : ProblemFile
    """
    return f"optlink {COMMANDS.get(group_of(problem), 'solve')} {problem.name}"


def sentence_of(problem: optlink.ProblemFile) -> str:
    """Return the first sentence of the description of a problem, two if the first one is very short.

    Parameters
    ----------
    problem : ProblemFile
    """
    first, *others = re.split(r"(?<=\.)\s+(?=[A-Z])", " ".join(problem.model.about.split()))
    return " ".join([first, *others[: len(first) < SHORT]])


def picture(name: str) -> bytes:
    """Return the picture of a shipped problem as SVG: the mechanism, paths of its points, prescribed points.

    Parameters
    ----------
    name : str

    Raises
    ------
    ValueError
        If no valid design is found.
    """
    problem = optlink.load(name)
    found = report_model_of(solve_or_validate(problem, starts=STARTS))
    if found.cycle is None or not found.valid:
        raise ValueError(f"{name}: no valid design to draw")
    machine, view = found.cycle.machine, _view(found.result)
    if view is None:
        angles = np.radians(found.cycle["crank_angle_deg"])
        motion = sweep(machine.mechanism, machine.sizes, np.linspace(angles[0], angles[-1], 361))
        here = sweep(machine.mechanism, machine.sizes, [_pose_angle(motion)])
    else:
        motion, here = view.motion, view.here
    sketch = Sketch(motion, machine if view is None else None, SHARE)
    with apply_style(), mpl.rc_context({"svg.hashsalt": name}), io.BytesIO() as stream:
        if view is not None:
            sketch.widen(view.targets * sketch.scale.factor)
        drawn, axes = sketch.bare_figure(*SIZE)
        if view is not None:
            axes.plot(*(view.targets * sketch.scale.factor).T, ".", color=TARGET, markersize=3.5, zorder=5)
            if view.task.requirement.kind == "motion":
                for k in range(view.at.crank_angle.size):
                    for artist in sketch.pose(axes, view.at, k):
                        artist.set(alpha=0.13, zorder=1.5)
        sketch.pose(axes, here)
        drawn.savefig(stream, format="svg", metadata={"Date": None})
        return stream.getvalue()


def _view(outcome: Any) -> DesignView | None:
    """Return the motion of a synthesised design; None for other results."""
    return best(outcome) if isinstance(outcome, SynthesisResult) else None


def _pose_angle(motion: Motion) -> float:
    """Return a crank angle at which the points of a mechanism are neither close to each other nor on one line."""
    points = np.array([motion.position(name) for name in motion.mechanism.owners]).swapaxes(0, 1)
    reached = np.isfinite(points).all(axis=(1, 2))
    points = np.where(reached[:, None, None], points, 0.0)
    apart = np.linalg.norm(points[:, :, None] - points[:, None, :], axis=-1)
    least = np.where(apart < 1e-9, np.inf, apart).min(axis=(1, 2))  # points that coincide are one
    width = np.linalg.svd(points - points.mean(axis=1, keepdims=True), compute_uv=False)[:, 1]
    return float(motion.crank_angle[int(np.argmax(np.where(reached, np.where(np.isfinite(least), least, 0.0) * width, -1.0)))])


def page() -> str:
    """Return the gallery as Markdown with a heading for each group, two problems in a row."""
    problems = {name: optlink.load(name) for name in optlink.shipped()}
    parts = []
    for group, title in GROUPS.items():
        cells = [_cell(name, problem) for name, problem in problems.items() if group_of(problem) == group]
        rows = [f"| {one} | {other} |" for one, other in itertools.zip_longest(cells[::2], cells[1::2], fillvalue="")]
        parts += [f"## {title}", "", "| | |", "|---|---|", *rows, ""]
    return "\n".join(parts).rstrip()


def _cell(name: str, problem: optlink.ProblemFile) -> str:
    title, sentence = (html.escape(text, quote=False).replace("|", "\\|") for text in (problem.model.title, sentence_of(problem)))
    return f"![Drawing: {title}]({FOLDER}/{name}.svg)<br>**{title}**<br>{sentence}<br>`{command_of(problem)}`"
