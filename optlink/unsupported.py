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
    "drive on a moving link": Unsupported(
        "a motor between two moving links of a loop is",
        "Drive a body that is pinned to the frame ({bodies}); of an open chain state each drive: [drives.wrist]",
    ),
    "drive of a four-bar": Unsupported(
        "a drive of the {body} of a four-bar is",
        'Leave body out, as the crank is driven; a force on the {body} is a load: loads.hand = {{ on = "{body}", at = "C", '
        'force = "50 N", direction = "90 deg" }}',
    ),
    "curved guides": Unsupported(
        "curved guides and grooves are",
        "On an arc, pin a link to its centre, with its radius as length; of another curve state the travel that it gives over "
        "the rotation of a body as the law of a cam: [mechanism.cams]",
        r"(mechanism\.)?(guides|slots)\.\w+\.(radius|curve|curvature|arc|centre|center)",
    ),
    "contacts": Unsupported(
        "contacts between bodies are",
        "Leave them out, and take the motion up to the stop from the table of `optlink analyze --csv FILE`",
        r"(mechanism\.)?(contacts?|collisions?)|loads\.\w+\.contacts?",
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


WRITTEN = {
    r"requirements?\.(\d+\.)?(body|link|slider?|guide)": (
        'Name the output: output = "rocker" (of a path or a motion: point = "P")'
    ),
    r"drive\.(end|stop|to|until|limits?|min|max|travel|swing)": 'Write range = ["15 deg", "60 deg"]',
    r"((mechanism|loads)\.)?(\w+\.)?(stops?|bumpers?|end_?stops?)": (
        'Write in [drive] range = ["0 deg", "90 deg"], torque = "0 N*m" for a body that moves freely, '
        "and stops = { restitution = 0.4 }"
    ),
    r"drive\.(profile|table|schedule|motion|csv|over|expression)": 'Write law = [{ time = "0.4 s", to = "60 deg" }, ...]',
    r"drive\.(alpha|ramp|deceleration)": 'Write acceleration = "-40 rad/s^2", or a law over the time',
    r"drive\.(velocity|stroke|length|ram|screw|slider|guide)": 'Write slide = "G" (a guide) or cylinder = "lift", and a range',
    r"drive\.(bodies|motors?)|(mechanism\.)?(motors?|actuators?)": "Write [drives.NAME] for each, with body, slide or cylinder",
    r"(mechanism\.)?(rams?|screws?|spindles?|struts?)": (
        'Write [mechanism.cylinders] lift = { joints = ["D", "B"], closed = "900 mm", open = "1500 mm" }'
    ),
    r"(.*\.)?(gear(ing|_ratio)?|teeth|pinions?|planet\w*|sprockets?)": (
        'Write [mechanism.gears] mesh = { bodies = ["crank", "wheel"], teeth = [20, 60] }'
    ),
    r"(.*\.)?(chains?|ropes?|pulleys?|belt)": (
        'Write [mechanism.belts] belt = { bodies = ["motor", "crank"], diameters = ["60 mm", "180 mm"] }'
    ),
    r"(.*\.)?(cam|profiles?|followers?)": (
        'Write [mechanism.cams] valve = { cam = "cam", follower = "tappet", law = [{ to = "120 deg", rise = "20 mm" }, ...] }'
    ),
    r"(.*\.)?grooves?": 'Write [mechanism.slots] slot = { pin = "B", on = "rocker", through = "C" }',
}
"""How to write what unknown keys ask for, by patterns of the whole key with its dots."""


def unsupported(name: str, **names: str) -> tuple[str, str]:
    """Return the message and the remedy of one of `UNSUPPORTED`; `names` are those that its texts need."""
    item = UNSUPPORTED[name]
    return f"{item.what} not supported".format(**names), item.instead.format(**names)


def unsupported_key(key: str) -> tuple[str, str] | None:
    """Return message and remedy of what an unknown key, whole with its dots, asks for, if that is known.

    It is not supported, or written in another way.
    """
    remedy = next((remedy for keys, remedy in WRITTEN.items() if re.fullmatch(keys, key.lower())), None)
    if remedy is not None:
        return "unknown key", remedy
    name = next((name for name, item in UNSUPPORTED.items() if item.keys and re.fullmatch(item.keys, key.lower())), None)
    return None if name is None else unsupported(name)
