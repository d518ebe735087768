"""Files and figures of a tolerance analysis: variance contributions, band over the crank angle, histogram."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from optlink.report.format import percent
from optlink.report.style import BODIES, CRANK, FOUND, LIMIT, QUIET, SHADE, WANTED, figure, heading, styled
from optlink.report.view import View
from optlink.studies.tolerance.analysis import Tolerance
from optlink.studies.tolerance.monte_carlo import MonteCarlo
from optlink.studies.tolerance.nominal import display_unit

COLOURS = (CRANK, *BODIES)
NEAR = 2.5  # the limit is drawn up to this multiple of the drawn range


@styled
def contributions(result: Tolerance) -> Figure:
    """Draw the variance contributions over the crank angle."""
    drawn = figure(8.0, 4.2)
    axes = drawn.add_subplot()
    degrees = np.degrees(result.nominal.crank_angles)
    order = np.argsort(-np.mean(result.contributions, axis=1), kind="stable")
    labels = [result.deviations[i].name for i in order]
    shares = [100.0 * result.contributions[i] for i in order]
    colours = [COLOURS[i % len(COLOURS)] for i in range(len(order))]
    if len(degrees) > 1:
        axes.stackplot(degrees, shares, labels=labels, colors=colours, alpha=0.85)
        axes.set_xlim(degrees.min(), degrees.max())
        axes.set_xlabel("crank angle [deg]")
        axes.set_ylabel("share of the variance [%]")
        axes.set_ylim(0.0, 100.0)
        handles, names = axes.get_legend_handles_labels()
        drawn.legend(handles[::-1], names[::-1], loc="outside right center", frameon=False)  # legend in the order of the stack
    else:
        axes.barh(labels[::-1], [float(share[0]) for share in shares][::-1], color=colours[::-1])
        axes.set_xlabel(f"share of the variance at {degrees[0]:.4g} deg [%]")
    title = f"{result.problem.model.title}: who is to blame for its scatter"
    drawn.suptitle(heading(title, 8.0), x=0.01, ha="left", fontsize=11)
    return drawn


@styled
def band(result: Tolerance) -> Figure:
    """Draw the error or the change of the output over the crank angle: worst case, three sigma, sample extremes, limit."""
    scale, unit = display_unit(result.nominal)
    drawn = figure(8.0, 4.6)
    axes = drawn.add_subplot()
    degrees, worst, base = np.degrees(result.nominal.crank_angles), result.worst, result.nominal.base
    marker = "." if len(degrees) < 3 else ""
    axes.fill_between(degrees, scale * (base + worst[0]), scale * (base + worst[1]), color=SHADE, label="worst case")
    if np.any(base):
        axes.plot(degrees, scale * base, color=FOUND, linewidth=2.0, marker=marker, label="as drawn")
    for side in (1.0, -1.0):
        three = scale * (base + result.shift + side * 3.0 * result.sigma)
        label = "three standard deviations" if side > 0.0 else None
        axes.plot(degrees, three, color=FOUND, linewidth=1.2, linestyle="--", marker=marker, label=label)
    if result.carlo is not None:
        ends = f"ends of {result.carlo.samples:,} samples"
        for column, name in ((result.carlo.most, ends), (result.carlo.least, None)):
            axes.plot(degrees, scale * (base + column), color=WANTED, linestyle=":", linewidth=1.1, marker=marker, label=name)
    axes.axhline(0.0, color=QUIET, linewidth=1.0)
    if result.limit is not None:
        _limits(axes, scale * result.limit, unit)
    if len(degrees) > 1:
        axes.set_xlim(degrees.min(), degrees.max())
    axes.set_xlabel("crank angle [deg]")
    what = result.nominal.name if np.any(base) else f"change of {result.nominal.name}"
    axes.set_ylabel(f"{what} [{unit}]")
    drawn.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    title = f"{result.problem.model.title}: {_output(result)} as built"
    drawn.suptitle(heading(title, 8.0), x=0.01, ha="left", fontsize=11)
    return drawn


def _output(result: Tolerance) -> str:
    """Return the name of the output for use in a sentence."""
    return f"the {result.nominal.name}" if np.any(result.nominal.base) else result.nominal.name


def _limits(axes: Any, limit: float, unit: str) -> None:
    """Draw the limit on both sides if it is near enough."""
    reach = max(abs(end) for end in axes.get_ylim())
    label = f"limit ±{limit:.5g} {unit}"
    if limit > NEAR * reach:
        axes.plot([], [], color=LIMIT, label=f"{label} (far outside)")
        return
    for side in (1.0, -1.0):
        axes.axhline(side * limit, color=LIMIT, linewidth=1.6, label=label if side > 0.0 else None)
    reach = max(reach, 1.1 * limit)
    axes.set_ylim(-reach, reach)


@styled
def histogram(result: Tolerance, carlo: MonteCarlo) -> Figure:
    """Draw the histogram of the largest error or change of each sample, and the limit.

    Parameters
    ----------
    result : Tolerance
    carlo : MonteCarlo
        Samples to draw.
    """
    scale, unit = display_unit(result.nominal)
    drawn = figure(8.0, 4.0)
    axes = drawn.add_subplot()
    seen = np.flatnonzero(carlo.counts)
    first, last = (int(seen[0]), int(seen[-1]) + 1) if len(seen) else (0, len(carlo.counts))
    merge = max(1, (last - first) // 60)
    starts = np.arange(first, last, merge)
    counts = np.add.reduceat(carlo.counts[first:last], starts - first)
    ends = np.minimum(starts + merge, last)
    left, right = scale * carlo.edges[starts], scale * carlo.edges[ends]
    limit = math.inf if result.limit is None else scale * result.limit
    colours = [FOUND if 0.5 * (a + b) <= limit else LIMIT for a, b in zip(left, right, strict=True)]
    axes.bar(left, 100.0 * counts / carlo.samples, right - left, align="edge", color=colours)
    if result.limit is not None:
        axes.axvline(limit, color=LIMIT, linewidth=1.6)
        text = f" limit {limit:.5g} {unit} \n yield {percent(carlo.share)} "
        inside = limit > 0.5 * sum(axes.get_xlim())
        side = "right" if inside else "left"
        axes.annotate(text, (limit, 0.98), xycoords=("data", "axes fraction"), ha=side, va="top", color=LIMIT)
    what = "error" if np.any(result.nominal.base) else f"change of {result.nominal.name}"
    axes.set_xlabel(f"largest {what} at any of the crank angles [{unit}]")
    axes.set_ylabel("share of the samples [%]")
    title = f"{result.problem.model.title}: {carlo.samples:,} linkages with their tolerances"
    drawn.suptitle(heading(title, 8.0), x=0.01, ha="left", fontsize=11)
    return drawn


VIEW = View(
    drawings={
        "contributions": contributions,
        "band": band,
        "histogram": lambda result: None if result.carlo is None else histogram(result, result.carlo),
    },
    tables=lambda result: {"tolerance": result.columns},
)
