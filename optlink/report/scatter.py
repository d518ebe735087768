"""Tolerances as files: result.json, a table over crank angles, and pictures: who is to blame, the scatter, the band."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from optlink.report.store import write_csv, write_json
from optlink.report.style import BODIES, CRANK, FOUND, LIMIT, QUIET, SHADE, WANTED, figure, heading, save, styled
from optlink.studies.tolerance import Carlo, Tolerance, people

COLOURS = (CRANK, *BODIES)
NEAR = 2.5  # bands that the room which a limit leaves may be away and still be drawn


def write_all(result: Tolerance, folder: Path) -> list[Path]:
    """Write result.json, tolerance.csv and the pictures."""
    written = [folder / name for name in ("result.json", "tolerance.csv", "contributions.png", "band.png")]
    write_json(written[0], result.to_dict())
    write_csv(written[1], result.columns)
    save(contributions(result), written[2])
    save(band(result), written[3])
    if result.carlo is not None:
        written.append(folder / "histogram.png")
        save(histogram(result, result.carlo), written[-1])
    return written


@styled
def contributions(result: Tolerance) -> Figure:
    """Shares of the variance over the crank angle."""
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
        drawn.legend(*axes.get_legend_handles_labels(), loc="outside right upper", frameon=False)
    else:
        axes.barh(labels[::-1], [float(share[0]) for share in shares][::-1], color=colours[::-1])
        axes.set_xlabel(f"share of the variance at {degrees[0]:.4g} deg [%]")
    title = f"{result.problem.model.title}: who is to blame for the scatter of {result.nominal.name}"
    drawn.suptitle(heading(title, 8.0), x=0.01, ha="left", fontsize=11)
    return drawn


@styled
def band(result: Tolerance) -> Figure:
    """Change of what is judged over the crank angle: worst case, three sigma, what the samples reached, and room left."""
    scale, unit = people(result.nominal)
    drawn = figure(8.0, 4.6)
    axes = drawn.add_subplot()
    degrees, worst = np.degrees(result.nominal.crank_angles), result.worst
    marker = "." if len(degrees) < 3 else ""
    low, high = scale * worst[0], scale * worst[1]
    axes.fill_between(degrees, low, high, color=SHADE, label="worst case")
    for side in (1.0, -1.0):
        three = scale * (result.shift + side * 3.0 * result.sigma)
        axes.plot(degrees, three, color=FOUND, marker=marker, label="three standard deviations" if side > 0.0 else None)
    if result.carlo is not None:
        ends = f"ends of {result.carlo.samples:,} samples"
        for column, label in ((result.carlo.most, ends), (result.carlo.least, None)):
            axes.plot(degrees, scale * column, color=WANTED, linestyle=":", linewidth=1.1, marker=marker, label=label)
    if result.limit is not None:
        _room(axes, degrees, scale * (np.array([[1.0], [-1.0]]) * result.limit - result.nominal.base), marker)
    axes.axhline(0.0, color=QUIET, linewidth=1.0)
    axes.set_xlabel("crank angle [deg]")
    axes.set_ylabel(f"change of {result.nominal.name} [{unit}]")
    drawn.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    drawn.suptitle(
        heading(f"{result.problem.model.title}: scatter of {result.nominal.name}", 8.0), x=0.01, ha="left", fontsize=11
    )
    return drawn


def _room(axes: Any, degrees: NDArray[np.float64], rooms: NDArray[np.float64], marker: str) -> None:
    """What the limit leaves above and below, as far as that is near."""
    bottom, top = axes.get_ylim()
    reach = max(abs(bottom), abs(top))
    for room in rooms:
        axes.plot(degrees, room, color=LIMIT, marker=marker)
    near = float(np.min(np.abs(rooms))) < NEAR * reach
    axes.plot([], [], color=LIMIT, label="what the limit leaves" if near else "what the limit leaves (far outside)")
    reach *= min(NEAR, max(1.2, 1.1 * float(np.min(np.abs(rooms))) / reach)) if near else 1.0
    axes.set_ylim(-reach, reach)


@styled
def histogram(result: Tolerance, carlo: Carlo) -> Figure:
    """How many samples have which largest size of what is judged, and the limit."""
    scale, unit = people(result.nominal)
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
        text = f" limit {limit:.5g} {unit}\n yield {100.0 * carlo.share:.2f} %"
        axes.annotate(text, (limit, 0.98), xycoords=("data", "axes fraction"), va="top", color=LIMIT)
    what = "error" if np.any(result.nominal.base) else f"change of {result.nominal.name}"
    axes.set_xlabel(f"largest {what} at any of the crank angles [{unit}]")
    axes.set_ylabel("share of the samples [%]")
    title = f"{result.problem.model.title}: {carlo.samples:,} linkages with their tolerances"
    drawn.suptitle(heading(title, 8.0), x=0.01, ha="left", fontsize=11)
    return drawn
