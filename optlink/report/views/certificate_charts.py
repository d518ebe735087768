"""Charts of the certificate of a global optimum: the boxes of the search, and the bounds of the objective."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from optlink.report.chart_spec import Axis, Boxes, ChartSpec, Curve, Mark, Panel
from optlink.tasks.results.certificate import SHOWN, Certificate, Cover

Design = Mapping[str, float]
Display = Callable[[str], tuple[float, str]]
"""Returns factor and display unit of a design variable."""
FEW = 256  # boxes up to which the bounds are not drawn: about one batch of the search
SCHEME = {
    "limits": ("limit violated", "#c0392b"),
    "objective": ("objective too large", "#2c6fbb"),
    "Lagrangian": ("Lagrangian too large", "#2e8b57"),
    "cut": ("cut off", "#d07d00"),
}
"""Name and colour of the boxes that each test discards."""


def certificate_charts(
    certificate: Certificate | None, title: str, scale: tuple[float, str], design: Design, assembly: Any, display: Display
) -> list[ChartSpec]:
    """Return the boxes of two design variables, and the bounds of the objective against the number of boxes.

    Parameters
    ----------
    certificate : Certificate or None
    title : str
        Of the problem.
    scale : (float, str)
        Factor of the objective from SI to its display unit, and that unit.
    design : mapping of str to float [SI]
        Of the best design; empty if there is none.
    assembly : object
        Its assembly mode, in the words of the problem file.
    display : function of a name
        Returns factor and display unit of a design variable.
    """
    if certificate is None:
        return []
    found = []
    if len(certificate.unknowns) == 2 and 0 < sum(len(cover.test) for cover in certificate.covers) <= SHOWN:
        for k, cover in enumerate(certificate.covers):
            at = design if certificate.proven and str(cover.assembly) == str(assembly) else {}
            mode = f", assembly {cover.assembly}" if len(certificate.covers) > 1 else ""
            found.append(replace(_boxes(cover, certificate.unknowns, title, mode, at, display), remark=certificate.text, row=k))
    if certificate.boxes > FEW and np.isfinite(certificate.history[-1:, 2]).any():
        found.append(_bounds(certificate, title, *scale))
    return found


def _boxes(cover: Cover, unknowns: Sequence[str], about: str, mode: str, design: Design, display: Display) -> ChartSpec:
    """Return the boxes of one assembly mode, coloured by the tests that discarded them."""
    scales = [display(name) for name in unknowns]
    factors = np.array([factor for factor, _ in scales])
    low, high = cover.low * factors, cover.high * factors
    x, y = (np.stack([low[:, k], high[:, k]], axis=1) for k in range(2))
    traces = []
    for k, (key, (name, colour)) in enumerate(SCHEME.items()):
        own = cover.test == k
        if own.any():
            traces.append(Boxes(x[own], y[own], f"{name} ({int(own.sum())})", colour, gid=f"boxes {key}"))
    marks = []
    if design:
        at_x, at_y = (design[name] * factor for name, factor in zip(unknowns, factors, strict=True))
        marks.append(Mark(at_x, at_y, "design", "#111111", "star", 11.0, prefer=(1.0, 1.0), gid="design"))
    axes = [
        Axis(f"{name} [{unit}]", (float(ends.min()), float(ends.max())))
        for name, (_, unit), ends in zip(unknowns, scales, (x, y), strict=True)
    ]
    panel = Panel(axes[1], traces, 2.1, marks=marks)
    title = f"Global search: boxes of designs and the test that discarded each{mode}"
    return ChartSpec("boxes", title, [panel], axes[0], f"{about}: boxes of the global search", cursor=False)


def _bounds(certificate: Certificate, title: str, factor: float, unit: str) -> ChartSpec:
    """Return the lower bound and the best known objective as steps over the number of boxes."""
    boxes, lower, best = certificate.history.T
    steps = np.repeat(boxes, 2)[1:]
    curves = [
        Curve(steps, np.repeat(values * factor, 2)[:-1], name, colour, 1.8, gid=name)
        for values, name, colour in ((best, "best known design", "#2e8b57"), (lower, "lower bound", "#2c6fbb"))
    ]
    axis = Axis(f"objective [{unit}]" if unit else "objective")
    x = Axis("boxes examined", (float(boxes[0]), float(boxes[-1])), "log")
    name, heading = "Global search: bounds of the objective", f"{title}: bounds of the objective"
    return ChartSpec("bounds", name, [Panel(axis, curves, 1.4)], x, heading, certificate.text, cursor=False)
