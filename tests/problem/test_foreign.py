"""Linkages written here in the formats of other programs, against closed forms; links of PMKS+ itself; and damaged ones."""

from __future__ import annotations

import cmath
import itertools
import json
import math
import random
import re
import urllib.parse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.problem.file import ProblemFile, read
from optlink.problem.foreign import DIGITS, check_digit, problem_text
from tests.cli.test_cli import run

FOUR_BAR = (
    "2P.Ay,1E8.K,0.1011.MA,A,0mv,0VU,0.GB,B,0e_,E6,0.GC,C,l1,WW,0.KD,D,qD,0Pk,0..YRAB,AB,Fe,Fe,0ix,08i,c5cae9,A,B,,."
    "YRBC,BC,Fe,Fe,32,NJ,303e9f,B,C,,.YRCD,CD,Fe,Fe,nd,3P,0d125a,C,D,,...N_v"
)
SLIDER_CRANK = (
    "2P.Ay,1E8.K,0.1011.MA,A,0mA,0c,0.GB,B,0Yt,bK,0.GC,C,il,H-,0.LD,D,il,H-,0..YRAB,AB,Fe,Fe,0fW,IN,c5cae9,A,B,,."
    "YRBC,BC,Fe,Fe,4y,Rf,303e9f,B,C,,.YPCD,CD,Fe,0,0,0,,C,D,,...N_j"
)
"""Templates of PMKS+."""
RPM = math.tau / 60.0


def circles(p: complex, a: float, q: complex, b: float, near: complex) -> complex:
    """Return the crossing of two circles that is nearer to a place."""
    way, far = (q - p) / abs(q - p), abs(q - p)
    along = (a * a - b * b + far * far) / (2.0 * far)
    both = [p + way * complex(along, side * math.sqrt(a * a - along * along)) for side in (1, -1)]
    return min(both, key=lambda one: abs(one - near))


def crossing(p: complex, a: float, on: complex, direction: float, near: complex) -> complex:
    """Return the crossing of a circle and a line that is nearer to a place."""
    way = cmath.exp(1j * direction)
    foot = (p - on) / way
    both = [on + way * (foot.real + side * math.sqrt(a * a - foot.imag**2)) for side in (1, -1)]
    return min(both, key=lambda one: abs(one - near))


@dataclass
class Drawn:
    """A linkage with the crank AB: places [cm], pins by the two they hang on, points of a link, slides by their direction."""

    places: Mapping[str, complex]
    pins: Mapping[str, str]
    points: Mapping[str, str]
    slides: Mapping[str, tuple[str, float]]
    rpm: float = 20.0

    @property
    def ground(self) -> list[str]:
        """Ground pivots."""
        return [one for one in self.places if one not in {"B", *self.pins, *self.points, *self.slides}]

    @property
    def links(self) -> list[str]:
        """The joints of each link."""
        links = ["AB", *(one + pin for pin, of in self.pins.items() for one in of)]
        links += [one + pin for pin, (one, _) in self.slides.items()]
        return [link + "".join(point for point, of in self.points.items() if {*of} <= {*link}) for link in links]

    def turned(self, angle: float, before: Mapping[str, complex]) -> dict[str, complex]:
        """Return the places at a crank angle, near those before it."""
        at, now = self.places, {one: self.places[one] for one in self.ground}
        now["B"] = at["A"] + (at["B"] - at["A"]) * cmath.exp(1j * angle)
        for one in self.places:
            if one in self.pins:
                p, q = self.pins[one]
                now[one] = circles(now[p], abs(at[one] - at[p]), now[q], abs(at[one] - at[q]), before[one])
            elif one in self.points:
                p, q = self.points[one]
                now[one] = now[p] + (at[one] - at[p]) / (at[q] - at[p]) * (now[q] - now[p])
            elif one in self.slides:
                p, direction = self.slides[one]
                now[one] = crossing(now[p], abs(at[one] - at[p]), at[one], direction, before[one])
        return now


def rounded(place: complex) -> complex:
    """Return a place to a thousandth, as PMKS+ stores it."""
    return complex(round(place.real, 3), round(place.imag, 3))


def four_bar(side: int, rpm: float) -> Drawn:
    a, b, d = complex(1.0, 0.5), complex(1.6, 1.3), complex(5.0, 1.0)
    c = rounded(circles(b, 4.5, d, 3.0, complex(3.0, side * 9.0)))
    return Drawn({"A": a, "B": b, "D": d, "C": c}, {"C": "BD"}, {}, {}, rpm)


def slider_crank(side: int) -> Drawn:
    a, b, direction = 0.5j, complex(0.6, 1.3), 0.524
    on = a + cmath.exp(1j * direction) * 0.3j
    c = rounded(crossing(b, 4.0, on, direction, side * 9.0 * cmath.exp(1j * direction)))
    return Drawn({"A": a, "B": b, "C": c}, {}, {}, {"C": ("B", direction)})


def level(side: int) -> Drawn:
    """A slider-crank on a level line."""
    c = rounded(crossing(complex(0.6, 1.3), 4.0, 0.1j, 0.0, side * 9.0))
    return Drawn({"A": 0.5j, "B": complex(0.6, 1.3), "C": c}, {}, {}, {"C": ("B", 0.0)})


def six_bar() -> Drawn:
    first = four_bar(1, 20.0)
    p = complex(2.2, 4.9)
    places = {**first.places, "P": p, "F": complex(8.0, 4.0), "E": complex(6.2, 7.7)}
    return Drawn(places, {"C": "BD", "E": "PF"}, {"P": "BC"}, {})


def number(value: float) -> str:
    rest, text = abs(round(1000 * value)), ""
    while rest or not text:
        rest, digit = divmod(rest, 64)
        text = DIGITS[digit] + text
    return ("0" if value < 0 else "") + text


def pmks(drawn: Drawn) -> str:
    """Write a share link of PMKS+; a slide s of the pin C is a joint of its own."""
    head = f"2{'P' if drawn.rpm < 0 else 'O'}.Ay,1E8.{DIGITS[abs(round(drawn.rpm))]},0.1011"
    joints = [((4 if one in drawn.ground else 0) + 2 * (one == "A"), one, at, 0.0) for one, at in drawn.places.items()]
    joints += [(5, pin.lower(), drawn.places[pin], direction) for pin, (_, direction) in drawn.slides.items()]
    bodies = ["R" + link for link in drawn.links] + ["P" + pin + pin.lower() for pin in drawn.slides]
    pins = ".".join(
        f"{DIGITS[flags]}{one},{one},{number(at.real)},{number(at.imag)},{number(way)}" for flags, one, at, way in joints
    )
    rows = ".".join(f"Y{body},{body[1:]},Fe,Fe,0,0,c5cae9,{','.join(body[1:])},," for body in bodies)
    text = f"{head}.{pins}..{rows}...N_"
    return text + check_digit(text)


def old_pmks(drawn: Drawn) -> str:
    """Write a link of PMKS+ of 2021: rows with friction, and level slides that are pins."""
    yes = {True: "t", False: "f"}
    joints = "".join(
        f"{one},{at.real!r},{at.imag!r},,{'P' if one in drawn.slides else 'R'},"
        f"{yes[one in drawn.ground or one in drawn.slides]},0,0.1,{yes[one == 'A']},\n"
        for one, at in drawn.places.items()
    )
    links = "".join(f"{link},1,1,0.5,0.5,{'|'.join(link)},,l,0,0,0,0,0,0,0,0\n" for link in drawn.links)
    settings = f"{abs(drawn.rpm)},{str(drawn.rpm < 0).lower()},false,cm"
    return f"https://example.org/?{urllib.parse.quote(f'j={joints}&l={links}&f=&pp=&tp=&s={settings}', '=&,')}"


def linkage2(drawn: Drawn) -> str:
    """Write a file of Linkage; lines of slides end at two anchors, and a drawing is on the layer of decoration."""
    number = {one: index for index, one in enumerate(drawn.places)}
    unit, rows, ends = 96.0 / 2.54, [], []
    for one, at in drawn.places.items():
        words = f'id="{number[one]}" name="{one}" layer="16" x="{unit * at.real:.6f}" y="{unit * at.imag:.6f}"'
        words += ' anchor="true"' if one in drawn.ground else ""
        words += f' input="true" rpm="{-drawn.rpm:.6f}"' if one == "A" else ""
        if one in drawn.slides:
            start = len(number) + len(ends)
            for shift in (-2, 3):
                to = unit * (at + shift * cmath.exp(1j * drawn.slides[one][1]))
                ends.append(f'<connector id="{len(number) + len(ends)}" anchor="true" x="{to.real:.6f}" y="{to.imag:.6f}"/>')
            words += f' slider="true"><slidelimit id="{start}"/><slidelimit id="{start + 1}"/></connector'
        else:
            words += "/"
        rows.append(f"<connector {words}>")
    rows += [*ends, '<connector id="90" layer="1" x="0" y="0"/>']
    for index, link in enumerate(drawn.links):
        inner = "".join(f'<connector id="{number[one]}"/>' for one in link)
        rows.append(f'<Link id="{index}" layer="16" actuator="false" gear="false">{inner}</Link>')
    lines = "\r\n\t".join(['<program zoom="1" scalefactor="1" units="Millimeters"/>', *rows])
    return f"<linkage2>\r\n\t{lines}\r\n</linkage2>\r\n"


def pylinkage(drawn: Drawn) -> str:
    """Write joints with parents, some in other places than their distances give."""
    at, joints = {one: 0.01 * place for one, place in drawn.places.items()}, []
    for one, place in at.items():
        joint: dict[str, Any] = {"type": "Static", "name": one, "x": place.real, "y": place.imag}
        if one == "B":
            joint |= {"type": "Crank", "joint0": {"ref": "A"}, "distance": abs(place - at["A"]), "angle": drawn.rpm * RPM}
        elif one in drawn.pins:
            near = place + 0.0002j
            p, q = drawn.pins[one]
            joint |= {"type": "Revolute", "x": near.real, "y": near.imag, "joint0": {"ref": p}, "joint1": {"ref": q}}
            joint |= {"distance0": abs(place - at[p]), "distance1": abs(place - at[q])}
        elif one in drawn.points:
            p, q = drawn.points[one]
            way = (place - at[p]) / (at[q] - at[p])
            joint |= {"type": "Fixed", "x": 0.0, "y": 0.0, "joint0": {"ref": p}, "joint1": {"ref": q}}
            joint |= {"distance": abs(place - at[p]), "angle": cmath.phase(way)}
        elif one in drawn.slides:
            p, direction = drawn.slides[one]
            ends = [place + 0.01 * shift * cmath.exp(1j * direction) for shift in (-2, 3)]
            inline = [{"inline": True, "type": "Static", "x": end.real, "y": end.imag, "name": "end"} for end in ends]
            joint |= {"type": "Linear", "joint0": {"ref": p}, "joint1": inline[0], "joint2": inline[1]}
            joint |= {"revolute_radius": abs(place - at[p])}
        joints.append(joint)
    return json.dumps({"name": "drawn", "joints": joints[::-1], "solve_order": [*at]}, indent=2)


def mechanism(drawn: Drawn) -> str:
    """Write joints and links; the point of a coupler is a tracker."""
    joints = []
    for one, place in drawn.places.items():
        kind = "ground" if one in drawn.ground else "prismatic" if one in drawn.slides else "revolute"
        joint: dict[str, Any] = {"id": one, "type": kind, "position": [0.01 * place.real, 0.01 * place.imag]}
        if one in drawn.points:
            p, q = (drawn.places[of] for of in drawn.points[one])
            joint |= {"type": "tracker", "ref_joint1_id": drawn.points[one][0], "ref_joint2_id": drawn.points[one][1]}
            joint |= {"distance": 0.01 * abs(place - p), "angle": cmath.phase((place - p) / (q - p))}
        if one in drawn.slides:
            direction = cmath.exp(1j * drawn.slides[one][1])
            joint |= {"axis": [direction.real, direction.imag], "slide_distance": 0.0}
        joints.append(joint)
    links: list[dict[str, Any]] = [{"id": "ground", "type": "ground", "joints": drawn.ground}]
    links += [{"id": link, "type": "link", "joints": [*link[:2]]} for link in drawn.links]
    links[1] |= {"type": "driver", "angular_velocity": drawn.rpm * RPM, "initial_angle": 0.0, "motor_joint": "A"}
    return json.dumps({"name": "drawn", "joints": joints, "links": links, "ground": "ground"})


WRITERS: dict[str, Callable[[Drawn], str]] = {
    "PMKS+": pmks,
    "PMKS+ of 2021": old_pmks,
    "Linkage": linkage2,
    "pylinkage": pylinkage,
    "pylinkage mechanism": mechanism,
}
LINKAGES = {
    **{f"four-bar, {side}, {rpm}": four_bar(side, rpm) for side in (1, -1) for rpm in (20.0, -20.0)},
    **{f"slider-crank, {side}": slider_crank(side) for side in (1, -1)},
    **{f"level slider-crank, {side}": level(side) for side in (1, -1)},
    "six-bar": six_bar(),
}


def moved(file: ProblemFile, turned: float, point: str) -> complex:
    model = file.model
    pose = model.linkage.at(model.machine().sizes, model.driving.first + turned)
    return 100.0 * complex(*(float(part) for part in pose.point(point)))


def text_of(content: str, folder: Any) -> str:
    """Return the problem file of a link, or of a file with this content."""
    if content[0] not in "<{":
        return problem_text(content)
    (folder / "drawn.txt").write_text(content, encoding="utf-8")
    return problem_text(str(folder / "drawn.txt"))


INCLINED = [("PMKS+ of 2021", f"slider-crank, {side}") for side in (1, -1)]
"""Refused there."""


@pytest.mark.parametrize(("writer", "name"), [pair for pair in itertools.product(WRITERS, LINKAGES) if pair not in INCLINED])
def test_a_linkage_moves_as_in_closed_form(writer, name, tmp_path):
    drawn = LINKAGES[name]
    file = read(text_of(WRITERS[writer](drawn), tmp_path), "x", "x")
    assert file.model.driving.pace == pytest.approx(drawn.rpm * RPM)
    now: Mapping[str, complex] = drawn.places
    for turned in np.linspace(0.0, math.tau, 73):
        now = drawn.turned(turned, now)
        for point in now.keys() - {"A", "D", "F"}:
            assert abs(moved(file, turned, point) - now[point]) < 1e-6


@pytest.mark.parametrize("text", [FOUR_BAR, SLIDER_CRANK])
def test_links_of_pmks_itself_are_read(text):
    file = read(problem_text(f"https://app.pmksplus.com/?{text}"), "x", "x")
    assert optlink.analyze(file).full
    assert moved(file, 0.0, "B") == pytest.approx(
        complex(-2.622, 0.902) if text == FOUR_BAR else complex(-2.231, 2.388), abs=1e-9
    )


def test_links_that_are_one_body_are_joined_and_names_are_made_usable(tmp_path):
    """The coupler as a triangle of bars; a bar between two anchors; names that are no names."""
    text = linkage2(six_bar()).replace('name="P"', 'name="link_2"').replace('name="E"', 'name="the end"')
    number = {one: index for index, one in enumerate(six_bar().places)}
    ternary = "".join(f'<connector id="{number[one]}"/>' for one in "BCP")
    assert ternary in text
    bars = "".join(f'</Link><Link><connector id="{number[p]}"/><connector id="{number[q]}"/>' for p, q in ("CP", "PB", "AD"))
    text = text.replace(ternary, "".join(f'<connector id="{number[one]}"/>' for one in "BC") + bars)
    mechanism = read(text_of(text, tmp_path), "x", "x").model.mechanism
    assert [sorted([*link.joints, *link.points]) for link in mechanism.links.values()] == [
        ["A", "B"],
        ["B", "C", "P_link_2"],
        ["C", "D"],
        ["P_link_2", "the_end"],
        ["F", "the_end"],
    ]


SLOT = FOUR_BAR.replace("C,C,l1,WW,0", "C,C,l1,WW,0,AB,A,B")[:-1]
PLAIN, CRANK = linkage2(four_bar(1, 20.0)), linkage2(slider_crank(1))
BUILT, MADE = pylinkage(four_bar(1, 20.0)), mechanism(four_bar(1, 20.0))
REFUSED = {
    "hello": "PMKS+ link: the link is damaged or not one of PMKS+: its length does not fit its check sum. "
    "Copy the link again from Share in PMKS+",
    SLOT + check_digit(SLOT): "a slot in a moving link is not supported. Draw it with pins and sliders on the frame",
    old_pmks(slider_crank(1)).replace("P,t,0,", "P,t,0.524,"): "only level slides on the ground are supported in an old link",
    "http://example.org/pmks.html?mech=ground,a,R,0,0|": "PMKS link: links of the first PMKS are not supported",
    PLAIN.replace('actuator="false"', 'actuator="true"', 1): "Link 0: an actuator is not supported. Drive the linkage by a crank",
    PLAIN.replace('gear="false"', 'gear="true"', 1): "Link 0: a gear or chain is not supported. Take it out",
    PLAIN.replace('input="true"', 'input="true" limitangle="30"'): "connector 0: an input that swings is not supported",
    PLAIN.replace('name="D"', 'fastenlink="0"'): "connector 2: a fastened element is not supported. Join its links into one",
    CRANK.replace('anchor="true" x', "x", 2): "a slot in a moving link is not supported",
    CRANK.replace('<slidelimit id="4"/>', ""): "connector 2: a slider without two ends of its line is not supported",
    PLAIN.replace('scalefactor="1"', 'scalefactor="12"'): "a drawing scale other than 1 is not supported",
    PLAIN.replace('input="true"', ""): "the linkage has 0 inputs, and one driven pin on the ground is supported",
    PLAIN.replace('rpm="-20', 'rpm="twenty'): '"twenty.000000" is not a number',
    '<!DOCTYPE a [<!ENTITY b "c">]>' + PLAIN: "the file has a document type, and those of Linkage have none",
    PLAIN[:-20]: "the file is damaged: unclosed token",
    "<html/>": "not a file of Linkage: it begins with <html>",
    BUILT.replace('"Revolute"', '"Prismatic"'): "C: Prismatic is not supported, or a parent of it is missing",
    BUILT.replace('"ref": "D"', '"ref": "Z"'): "C: joints have no parents in the file",
    re.sub(r'"distance0": [\d.]+', '"distance0": 9.0', BUILT): "C: the distances of this joint do not reach its place",
    BUILT.replace('"x": 0.05,', '"x": "far",'): "joints.1.x: not a file of pylinkage: Input should be a valid number",
    "{" * 100000: "not a file of pylinkage: Invalid JSON",
    MADE.replace('"driver"', '"arc_driver"'): "AB: a link of the type arc_driver is not supported. Let the driver turn fully",
    MADE.replace('"position"', '"at"', 1): "A: the joint has no place",
}


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_what_is_not_read_is_refused_by_name(text, tmp_path):
    with pytest.raises(optlink.InputError, match=re.escape(REFUSED[text])) as error:
        text_of(text, tmp_path)
    assert len(error.value.faults) == 1
    assert str(error.value).startswith("PMKS" if text[0] not in "<{" else str(tmp_path))


def test_a_file_that_is_missing_or_too_large_is_refused(tmp_path):
    with pytest.raises(optlink.InputError, match=r"drawn\.linkage2: no such file\. Check the path"):
        problem_text(str(tmp_path / "drawn.linkage2"))
    with pytest.raises(optlink.InputError, match=r"photo\.jpg: no such file\. Check the path"):
        problem_text("photo.jpg")
    (tmp_path / "drawn.linkage2").write_text(" " * 1_000_001)
    with pytest.raises(optlink.InputError, match=r"the file has more than 1000000 bytes"):
        problem_text(str(tmp_path / "drawn.linkage2"))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0", "neither a drawing nor a linkage of another program. Give a path in an SVG file"),
        (b"My linkage, drawn in June", "neither a drawing nor a linkage of another program. Give a path in an SVG file"),
        (b'<?xml version="1.0"?>\n<!-- foot -->\n<svg xmlns="http://www.w3.org/2000/svg"/>', "does not end with .svg. Rename it"),
    ],
)
def test_a_file_that_is_no_linkage_is_told_what_is_read(content, says, tmp_path):
    file = tmp_path / "foot.pdf"
    file.write_bytes(content)
    with pytest.raises(optlink.InputError, match=re.escape(says)):
        problem_text(str(file))


VALUES = ["0", "1e400", "-1e308", "1e-320", "9" * 400, "NaN", "null", "[]", "{}", "true", "A", "link_1", "frame", "C", "1e7", "é"]


def damaged(chance: random.Random) -> str:
    """Return a text of one of the formats with some characters changed, a link with the check sum of its length."""
    writer = chance.choice([*WRITERS])
    whole = WRITERS[writer](chance.choice([*LINKAGES.values()]))
    for found in chance.sample([*re.finditer(r"-?\d[\d.]*|(?<=\").*?(?=\")", whole)], chance.randint(0, 2)):
        whole = whole.replace(found[0], chance.choice(VALUES), chance.choice([-1, 1]))
    text = list(whole)
    for _ in range(chance.randint(0, 3)):
        place = chance.randrange(len(text))
        text[place : place + chance.randint(0, 3)] = chance.choices('.,0AZaz-_~%é\n\x00KLP"<>{}[]:/|&=9', k=chance.randint(0, 3))
    changed = "".join(text)
    return changed[:-1] + check_digit(changed[:-1].strip()) if writer == "PMKS+" and changed[1:] else changed


def test_damaged_linkages_give_one_sentence(tmp_path):
    chance, read_still = random.Random(1), 0
    for _ in range(500):
        text = damaged(chance)
        try:
            text_of(text, tmp_path)
            read_still += 1
        except optlink.InputError as error:
            assert len(error.faults) == 1
            assert error.faults[0].remedy
    assert 50 < read_still < 400


def test_a_link_or_a_file_becomes_a_problem_file(tmp_path):
    (tmp_path / "drawn.linkage2").write_text(PLAIN)
    for source in (FOUR_BAR, str(tmp_path / "drawn.linkage2")):
        done = run("new", "--from", source, "--out", str(tmp_path / "mine.toml"), "--force")
        assert done.exit_code == 0, done.stderr
        assert optlink.load(tmp_path / "mine.toml").model.drive.body == "link_1"
    done = run("new", "--from", FOUR_BAR[:-1] + "0")
    assert done.exit_code == 2
    assert done.stderr.startswith("Error: PMKS+ link")
