"""What optlink does not support: the sentence that says so, what to do instead, and the keys of a file that ask for it."""

import re
from typing import NamedTuple


class Unsupported(NamedTuple):
    """Something that is not supported: `what` with its verb, and what to do `instead`; names in braces are filled in.

    `keys`: pattern of the unknown keys, with dots between their parts, that ask for it; empty for what other checks recognise.
    """

    what: str
    instead: str
    keys: str = ""


UNSUPPORTED = {
    "crank acceleration": Unsupported(
        "an acceleration of the crank is",
        "Leave it out: the speed is constant. `optlink simulate` computes accelerations under a torque, and "
        "`optlink.linkage.sweep` in Python takes one of the crank",
        r"drive\.(acceleration|alpha|ramp|jerk|deceleration)",
    ),
    "varying speed": Unsupported(
        "a crank speed that varies in a given way is",
        "Give the constant mean speed; `optlink simulate` with drive.torque computes how the speed varies",
        r"drive\.(profile|law|table|schedule|motion|csv|over|expression)",
    ),
    "range of the crank": Unsupported(
        "a range of the driven body is",
        "Leave it out: the body turns as far as it can. Take the range from the table of `optlink analyze --csv FILE`",
        r"drive\.(end|stop|range|to|until|limits?|min|max|travel|swing)",
    ),
    "linear drive": Unsupported(
        "a drive along a guide (a cylinder, a screw, a linear motor) is",
        'Drive a body that is pinned to the frame, at a speed such as "10 rpm"; the table of `optlink analyze` has the slide',
        r"drive\.(force|velocity|stroke|length|cylinder|ram|screw|slider|guide)|(mechanism\.)?(cylinders?|rams?|screws?|spindles?)",
    ),
    "several drives": Unsupported(
        "several drives are",
        "Drive one body, and hold each other one still: leave it out, and give its joints places under [mechanism.ground]",
        r"(mechanism\.)?(drives|motors?|actuators?)|drive\.(bodies|motors?)",
    ),
    "drive on a moving link": Unsupported(
        "a drive between two moving links is",
        "Drive a body that is pinned to the frame ({bodies}); or make the link that carries the motor the frame of the file: "
        "relative motions are the same",
    ),
    "drive of a four-bar": Unsupported(
        "a drive of the {body} of a four-bar is",
        'Leave body out, as the crank is driven; a force on the {body} is a load: loads.hand = {{ on = "{body}", at = "C", '
        'force = "50 N", direction = "90 deg" }}',
    ),
    "gears": Unsupported(
        "gears are",
        "Leave them out, and drive the linkage at the shaft behind them, with the speed of that shaft",
        r"(.*\.)?(gear(s|ing|ed|_ratio)?|pinions?|planet\w*|sprockets?|teeth)",
    ),
    "racks": Unsupported(
        "racks are", "Leave them out, and describe the linkage on one side of the rack, driven there", r"(.*\.)?racks?"
    ),
    "belts": Unsupported(
        "belts, chains and ropes are",
        "Leave them out, and drive the linkage at the shaft behind them, with the speed of that shaft",
        r"(.*\.)?(belts?|chains?|ropes?|cables?|pulleys?|winch(es)?|drums?)",
    ),
    "cams": Unsupported(
        "cams are",
        "Leave them out; `optlink new law` begins the design of a linkage that follows the law of a cam",
        r"(.*\.)?(cams?|profiles?|followers?|grooves?)",
    ),
    "curved guides": Unsupported(
        "curved guides are",
        "A slider on an arc moves as a pin of a link: pin a link to the centre of the arc, with its radius as length",
        r"(mechanism\.)?guides\.\w+\.(radius|curve|curvature|arc|centre|center)",
    ),
    "stops": Unsupported(
        "stops and contacts between bodies are",
        "Leave them out, and take the motion up to the stop from the table of `optlink analyze --csv FILE`",
        r"(mechanism\.)?(stops?|contacts?|bumpers?|collisions?)|loads\.\w+\.(stops?|contacts?)",
    ),
    "pin friction": Unsupported(
        "friction in a pin without clearance is",
        'Leave it out, and give its torque as a load: loads.friction_{point} = {{ on = "{body}", against = "{other}", '
        'torque = "0.2 N*m", acts = "opposing" }}',
    ),
    "load over time": Unsupported("a load over time is", "Write it over phi, which is the speed times the time"),
    "redundant body": Unsupported(
        "redundant bodies are",
        "Remove one of these joints, or add a body between; if {body} only repeats a motion, as a third crank of a coupling rod, "
        "leave it out",
    ),
    "higher class": Unsupported(
        "such groups are",
        "Drive another body, or change the structure so that the bodies can be placed two at a time",
    ),
    "free links": Unsupported(
        "several drives and links that hang freely are",
        "If a joint is missing, join {them} to the frame or to another body{check}; else hold {them} still: list the points of "
        "{them} under the body that carries {them}",
    ),
}
"""By name; the first that fits a key counts."""


def unsupported(name: str, **names: str) -> tuple[str, str]:
    """Return the message and the remedy of one of `UNSUPPORTED`; `names` are those that its texts need."""
    item = UNSUPPORTED[name]
    return f"{item.what} not supported".format(**names), item.instead.format(**names)


def unsupported_key(key: str) -> tuple[str, str] | None:
    """Return message and remedy of what an unknown key, whole with its dots, asks for, if that is known to be not supported."""
    name = next((name for name, item in UNSUPPORTED.items() if item.keys and re.fullmatch(item.keys, key.lower())), None)
    return None if name is None else unsupported(name)
