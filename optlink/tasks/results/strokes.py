"""Strokes of the outputs of a machine as JSON."""

import math
from typing import Any

from optlink.dynamics.machine import Machine
from optlink.dynamics.strokes import StrokeLoad, acting_loads, named_travels, use_of, working_stroke
from optlink.linkage.stroke import Travel


def stroke_records(travel: Travel, speed: float, acting: tuple[StrokeLoad, ...]) -> dict[str, Any]:
    """Return the working, slow, forward and backward stroke of an output as JSON, with crank ranges in the direction of rotation.

    `acting` are the loads that act in one stroke only; of the speed only the sign matters.
    """
    working, loads = working_stroke(travel, speed, acting)
    strokes = travel.strokes(speed)
    return {
        "slow_stroke": next((stroke.name for stroke in strokes if stroke.pace == "slow"), None),
        "working_stroke": working,
        "working_loads": list(loads),
        **{
            stroke.name: {
                "crank_from_deg": math.degrees(stroke.begin),
                "crank_to_deg": math.degrees(stroke.end),
                "crank_rotation_deg": math.degrees(stroke.rotation),
                "pace": stroke.pace,
                "use": use_of(stroke, working) or None,
            }
            for stroke in strokes
        },
    }


def stroke_document(machine: Machine, speed: float) -> dict[str, Any]:
    """Return the strokes of every output of a machine whose crank turns fully, as JSON."""
    acting = acting_loads(machine, speed)
    return {
        name: {"time_ratio": travel.time_ratio, **stroke_records(travel, speed, acting)}
        for part in named_travels(machine)
        for name, travel in part.items()
    }
