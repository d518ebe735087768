"""A linkage as a share link of PMKS+, of which `optlink new --from` makes the same linkage again."""

from __future__ import annotations

import math
import string
from collections.abc import Iterator

import numpy as np

from optlink.errors import InputError
from optlink.linkage.bodies import FRAME
from optlink.presentation.export.mjcf import without_full_turn
from optlink.problem.foreign import RPM, check_digit, digits
from optlink.tasks.analyze import Analysis

ADDRESS = "https://app.pmksplus.com/?"
IDS = string.ascii_uppercase + string.ascii_lowercase
"""Names that PMKS+ gives joints."""
SLIDE, INPUT, GROUND, PATH = 1, 2, 4, 16
"""Bits of a joint."""


def share_link(cycle: Analysis, at: float) -> str:
    """Return the link of a linkage that is drawn at a crank angle [rad], in cm.

    Raises
    ------
    InputError
        If PMKS+ has no counterpart for a part of the machine.
    """
    for what, remedy, key in _without_counterpart(cycle):
        raise InputError(f"PMKS+ has no counterpart for {what}", remedy, cycle.problem.file, key)
    machine, mechanism = cycle.machine, cycle.machine.mechanism
    moving = machine.moving([at], cycle.speed)
    sliders = {guide.slider: guide for guide in mechanism.guides}
    points = [point for point, owners in mechanism.owners.items() if owners != (FRAME,)]
    ids = dict(zip([*points, *(f"{slider} " for slider in sliders)], IDS, strict=False))
    if len(points) + len(sliders) > len(IDS):
        raise InputError(f"PMKS+ names at most {len(IDS)} joints", "Export a smaller machine", cycle.problem.file, "mechanism")
    rpm = cycle.speed / RPM
    whole = abs(rpm - round(rpm)) < 5e-4
    joints, links = [], []

    def joint(bits: int, name: str, point: str, direction: float, *more: str) -> None:
        place = ",".join(digits(1e5 * float(np.squeeze(x))) for x in moving.position(point))
        joints.append(",".join([f"{digits(bits)}{ids[name]}", point, place, digits(1e3 * direction), *more]))

    def link(kind: str, colour: str, members: list[str]) -> None:
        name = "".join(ids[one] for one in members)
        links.append(f"Y{kind}{name},{name},{digits(1e3)},{digits(1e3)},0,0,{colour},{','.join(name)},,")

    for point in points:
        driven = point == mechanism.crank.start
        bits = PATH + GROUND * (FRAME in mechanism.owners[point]) + INPUT * driven
        joint(bits, point, point, 0.0, *(["", "", "", digits(1e3 * rpm)] if driven and not whole else []))
    for body, bar in mechanism.bodies.items():
        if body not in sliders:
            link("R", "c5cae9", [point for point in points if body in mechanism.owners[point]])
            continue
        x, y = (float(np.squeeze(part)) for part in moving.line(sliders[body].name))
        joint(PATH + GROUND + SLIDE, f"{body} ", bar.start, math.atan2(y, x))
        link("P", "", [bar.start, f"{body} "])
    head = f"2{'P' if rpm < 0.0 else 'O'}.Ay,1E8.{digits(abs(rpm))},0.1011"
    text = f"{head}.{'.'.join(joints)}..{'.'.join(links)}...N_"
    return f"{ADDRESS}{text}{check_digit(text)}"


def _without_counterpart(cycle: Analysis) -> Iterator[tuple[str, str, str]]:
    """Yield what of a linkage PMKS+ has no counterpart for, with the remedy and the key of the file."""
    yield from without_full_turn(cycle)
    mechanism = cycle.machine.mechanism
    for guide in mechanism.guides:
        key = f"mechanism.guides.{guide.name}"
        if guide.on != FRAME:
            yield f"the guide {guide.name} on the moving body {guide.on}", "Export a machine with guides on the frame", key
        if sum(guide.slider in owners for owners in mechanism.owners.values()) > 1:
            yield f"further points of the slider {guide.slider}", "Leave them out", key
