"""Share links of PMKS+ written here, against closed forms; links of its own gallery; and damaged ones."""

from __future__ import annotations

import cmath
import math
import random
import re

import numpy as np
import pytest

import optlink
from optlink.problem.file import ProblemFile, read
from optlink.problem.foreign import DIGITS, problem_text
from tests.cli.test_cli import run

SUMS = DIGITS[:62]
FOUR_BAR = (
    "2P.Ay,1E8.K,0.1011.MA,A,0mv,0VU,0.GB,B,0e_,E6,0.GC,C,l1,WW,0.KD,D,qD,0Pk,0..YRAB,AB,Fe,Fe,0ix,08i,c5cae9,A,B,,."
    "YRBC,BC,Fe,Fe,32,NJ,303e9f,B,C,,.YRCD,CD,Fe,Fe,nd,3P,0d125a,C,D,,...N_v"
)
SLIDER_CRANK = (
    "2P.Ay,1E8.K,0.1011.MA,A,0mA,0c,0.GB,B,0Yt,bK,0.GC,C,il,H-,0.LD,D,il,H-,0..YRAB,AB,Fe,Fe,0fW,IN,c5cae9,A,B,,."
    "YRBC,BC,Fe,Fe,4y,Rf,303e9f,B,C,,.YPCD,CD,Fe,0,0,0,,C,D,,...N_j"
)
"""Templates of PMKS+."""


def number(value: float) -> str:
    rest, text = abs(round(1000 * value)), ""
    while rest or not text:
        rest, digit = divmod(rest, 64)
        text = DIGITS[digit] + text
    return ("0" if value < 0 else "") + text


def link(joints: list[tuple[int, str, complex, float]], bodies: list[str], clockwise: bool = False) -> str:
    """Write a link: joints with flags, place and direction; bodies as in PMKS+, "RAB" for the link of A and B; 20 rpm, cm."""
    head = f"2{'P' if clockwise else 'O'}.Ay,1E8.K,0.1011"
    pins = ".".join(
        f"{DIGITS[flags]}{one},{one},{number(at.real)},{number(at.imag)},{number(way)}" for flags, one, at, way in joints
    )
    rows = ".".join(f"Y{body},{body[1:]},Fe,Fe,0,0,c5cae9,{','.join(body[1:])},," for body in bodies)
    text = f"{head}.{pins}..{rows}...N_"
    return text + SUMS[len(text) % 62]


def circles(p: complex, a: float, q: complex, b: float, near: complex) -> complex:
    """Return the crossing of two circles that is nearer to a place."""
    way, far = (q - p) / abs(q - p), abs(q - p)
    along = (a * a - b * b + far * far) / (2.0 * far)
    both = [p + way * complex(along, side * math.sqrt(a * a - along * along)) for side in (1, -1)]
    return min(both, key=lambda one: abs(one - near))


def moved(file: ProblemFile, turned: float, point: str) -> complex:
    model = file.model
    pose = model.linkage.at(model.machine().sizes, model.driving.first + turned)
    return 100.0 * complex(*(float(part) for part in pose.point(point)))


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("clockwise", [False, True])
def test_a_four_bar_moves_as_in_closed_form(side, clockwise):
    a, b, d = complex(1.0, 0.5), complex(1.6, 1.3), complex(5.0, 1.0)
    c = circles(b, 4.5, d, 3.0, complex(3.0, side * 9.0))
    c = complex(round(c.real, 3), round(c.imag, 3))
    text = link([(6, "A", a, 0), (0, "B", b, 0), (0, "C", c, 0), (4, "D", d, 0)], ["RAB", "RBC", "RCD"], clockwise)
    file = read(problem_text(text), "x", "x")
    assert file.model.driving.pace == pytest.approx((-1 if clockwise else 1) * 20.0 * math.tau / 60.0)
    near = c
    for turned in np.linspace(0.0, math.tau, 73):
        pin = a + (b - a) * cmath.exp(1j * turned)
        near = circles(pin, abs(c - b), d, abs(d - c), near)
        assert abs(moved(file, turned, "C") - near) < 1e-9


@pytest.mark.parametrize("side", [1, -1])
def test_a_slider_crank_moves_as_in_closed_form(side):
    a, b, way, offset, rod = 0.5j, complex(0.6, 1.3), cmath.exp(0.524j), 0.3, 4.0
    level = ((b - a) / way).imag - offset
    c = a + way * complex(((b - a) / way).real + side * math.sqrt(rod * rod - level * level), offset)
    c = complex(round(c.real, 3), round(c.imag, 3))
    text = link([(6, "A", a, 0), (0, "B", b, 0), (0, "C", c, 0), (5, "D", c, 0.524)], ["RAB", "RBC", "PCD"])
    file = read(problem_text(text), "x", "x")
    rod, offset = abs(c - b), ((c - a) / way).imag
    for turned in np.linspace(0.0, math.tau, 73):
        pin = (b - a) * cmath.exp(1j * turned) / way
        along = pin.real + side * math.sqrt(rod * rod - (pin.imag - offset) ** 2)
        assert abs(moved(file, turned, "C") - (a + way * complex(along, offset))) < 1e-9


@pytest.mark.parametrize("text", [FOUR_BAR, SLIDER_CRANK])
def test_links_of_pmks_itself_are_read(text):
    file = read(problem_text(f"https://app.pmksplus.com/?{text}"), "x", "x")
    assert optlink.analyze(file).full
    assert moved(file, 0.0, "B") == pytest.approx(
        complex(-2.622, 0.902) if text == FOUR_BAR else complex(-2.231, 2.388), abs=1e-9
    )


def test_what_is_not_read_is_refused_by_name():
    slot = FOUR_BAR.replace("C,C,l1,WW,0", "C,C,l1,WW,0,AB,A,B")[:-1]
    for text, message in {
        "hello": "the link is damaged or not one of the present PMKS+: its length does not fit its check sum",
        slot + SUMS[len(slot) % 62]: "a slot in a moving link or a welded joint is not supported",
    }.items():
        with pytest.raises(optlink.InputError, match=re.escape(message)):
            problem_text(text)


def test_damaged_links_give_one_sentence():
    chance = random.Random(1)
    for _ in range(500):
        text = list(chance.choice([FOUR_BAR, SLIDER_CRANK])[:-1])
        for _ in range(chance.randint(1, 4)):
            place = chance.randrange(len(text))
            text[place : place + chance.randint(0, 2)] = chance.choices(".,0AZaz-_~%é\n\x00KLP", k=chance.randint(0, 3))
        damaged = "".join(text)
        try:
            problem_text(damaged + SUMS[len(damaged.strip()) % 62])
        except optlink.InputError as error:
            assert str(error)


def test_a_link_becomes_a_file(tmp_path):
    done = run("new", "--from", FOUR_BAR, "--out", str(tmp_path / "mine.toml"))
    assert done.exit_code == 0, done.stderr
    assert optlink.load(tmp_path / "mine.toml").model.drive.body == "link_1"
    done = run("new", "--from", FOUR_BAR[:-1] + "0")
    assert done.exit_code == 2
    assert done.stderr.startswith("Error: PMKS+ link")
