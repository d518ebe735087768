"""New names for parts of a linkage: every mention changes, nothing else does, and the machine remains the same."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.problem.design import DesignProblem
from optlink.problem.file import load, read, shipped
from optlink.problem.machine.model import marked_kinds
from optlink.problem.renaming import MENTIONS, own_names, renamed
from optlink.problem.schema import schema_of
from optlink.problem.templates import template, templates

TEXTS = re.compile(r'^(title|source|about) = ("""[\s\S]*?"""|.*)$|#.*$', re.MULTILINE)
NO_PARTS = {
    *("assembly", "author", "company", "damping", "date", "derivative", "exactly", "exponent"),
    *("figure_tolerance", "fit", "fluctuation", "friction", "integral", "law", "length_margin", "link_ratio"),
    *("material", "max", "min", "minimise", "minimize", "name", "objective", "objective_tolerance", "part"),
    *("proportional", "range", "ratio", "restitution", "revision", "scale", "source", "time_ratio", "title"),
    *("transmission_cosine", "unit", "weight"),
}
"""Fields of free texts that are no mere mention of a part: quantities, words, and what `renaming` reads in a way of its own."""
ODD = """format = 1  # The crank of the mast: C and P are names, N and m are units
title = "crank C"
[mechanism.ground]
left = ["0 m", "0 m"]  # left is a joint
m = ["0.4 m", "0 m"]
[mechanism.links]
crank = { joints = ["left", "N"], length = "100 mm" }
links = { joints = ["N", "of"], length = "1 m", points = { length = ["5 m", "3 m"], P = [{ equals = "2*links.length" }, "0 m"] } }
"bodies" = { joints = ["m", "of"], length = { equals = "links.length - 0.1 m" } }
[mechanism.assembly]
of = "left of N-m"
[bodies]
links = { mass = "1 kg", centroid = "length", inertia = "1 kg*m^2" }
[loads]
push = { on = "bodies", force = "10 N", at = "of", direction = "0 deg" }
"""


def files() -> Iterator[tuple[optlink.ProblemFile, str]]:
    """Templates, and shipped problems with what no template has, with their texts."""
    for name in templates():
        yield read(template(name).text, name), template(name).text
    for name in ("balance-six-bar", "path-scott-russell", "stephenson-iii", "slider-crank-three-gaps"):
        yield load(name), shipped()[name].read_text(encoding="utf-8")


@pytest.mark.slow
def test_every_mention_changes_and_nothing_else():
    for problem, text in files():
        own, new = own_names(problem), text
        for k, name in enumerate(own):
            new = renamed(new, problem, name, f"q{k}q")
            problem = read(tomllib.loads(new), problem.name, problem.file, problem.folder)
        code = re.sub(
            r"crank = \"(full rotation|double-crank|span|[-\d.]+ deg)|(slider|cam|follower|pinion|rack) = \"q",
            "",
            TEXTS.sub("", new),
        )
        assert not [one for one in own if re.search(rf"(?<![\w.]){one}(?!\w)", code)], problem.name
        back = re.sub(r"q(\d+)q", lambda found, own=own: own[int(found[1])], new)
        assert set(text.splitlines()) <= set(back.splitlines()), problem.name


def test_a_machine_with_other_names_moves_alike_under_the_same_forces():
    first = load("six-bar")
    problem = first
    names = {"crank": "wheel", "C": "knee", "slider": "ram", "F": "way", "link3": "D2", "E": "pin5"}
    for old, new in names.items():
        problem = optlink.rename(problem, old, new)
    before, after = optlink.analyze(first), optlink.analyze(problem)
    assert after.valid
    for quantity in ("input.torque_Nm", "slider.s_m", "E.f_N", "F.normal_N"):
        part, _, what = quantity.partition(".")
        same = after.extremes[f"{names.get(part, part)}.{what}"]
        assert np.isclose(same.largest, before.extremes[quantity].largest, rtol=1e-12)
    assert problem.at("drive.body") == "wheel"


def test_names_that_are_units_keys_and_words_are_told_from_them():
    problem = read(tomllib.loads(ODD), "odd")
    text = ODD
    for old, new in (
        ("N", "B"),
        ("m", "D"),
        ("left", "A"),
        ("of", "E"),
        ("length", "Q"),
        ("links", "rod"),
        ("bodies", "arm"),
        ("crank", "k"),
    ):
        text = renamed(text, problem, old, new)
        problem = read(tomllib.loads(text), "odd")
    assert text == ODD.replace('left = ["0 m"', 'A = ["0 m"').replace("\nm = ", "\nD = ").replace("crank = {", "k = {").replace(
        '["left", "N"]', '["A", "B"]'
    ).replace("links = { joints", "rod = { joints").replace('["N", "of"]', '["B", "E"]').replace("length = [", "Q = [").replace(
        "links.length", "rod.length"
    ).replace('"bodies" = ', '"arm" = ').replace('["m", "of"]', '["D", "E"]').replace(
        'of = "left of N-m"', 'E = "left of B-D"'
    ).replace("links = { mass", "rod = { mass").replace('centroid = "length"', 'centroid = "Q"').replace(
        'on = "bodies"', 'on = "arm"'
    ).replace('at = "of"', 'at = "E"') + ('\n[drive]\nbody = "k"\n')


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("six-bar", "Z", "Q", "the linkage has no part Z that can be renamed. Parts: A, D, B"),
        ("six-bar", "frame", "Q", "the linkage has no part frame"),
        ("six-bar", "C", "E", "E is the name of a joint. Choose another name for the joint C"),
        ("six-bar", "crank", "F", "F is the name of a guide"),
        ("six-bar", "crank", "process", "process is the name of a load"),
        ("six-bar", "C", "frame", "frame is a reserved name"),
        ("six-bar", "C", "2 knees", '"2 knees" is not a name. Use up to 40 letters'),
        ("six-bar", "C", "x" * 41, "is not a name"),
        ("six-bar", "C", "", '"" is not a name'),
        ("crank-rocker", "crank", "wheel", "the parts of a four-bar by its lengths have fixed names. Write it with its links"),
        ("path-vline6", "P", "B", "B is the name of a joint"),
    ],
)
def test_a_name_that_cannot_be_given_is_refused_in_one_sentence(name: str, old: str, new: str, words: str):
    with pytest.raises(InputError, match=re.escape(words)) as refused:
        optlink.rename(name, old, new)
    assert str(refused.value).startswith(f"{name}.toml: ")


def test_a_default_that_is_a_name_is_written():
    problem = load("path-vline6", {"requirement.point": None})
    assert optlink.rename(problem, "P", "foot").at("requirement.point") == "foot"
    assert problem.at("requirement.point") is None


@pytest.mark.slow
def test_each_field_of_free_text_is_a_mention_or_known_to_be_none():
    """A new field of the problem file that names a part must be added to `MENTIONS`."""

    def free(field: Any) -> bool:
        kind = field.get("type")
        if kind == "array":
            return free(field.get("items", {}))
        text = kind == "string" and not {"enum", "const"} & set(field)
        return (text and not field.get("examples")) or any(map(free, field.get("anyOf", ())))

    found = set()
    for model in (DesignProblem, *marked_kinds().values()):
        schema = schema_of(model)
        for section in (schema, *schema.get("$defs", {}).values()):
            found |= {name for name, field in section.get("properties", {}).items() if free(field)}
    assert len(found) > len(MENTIONS)
    print(sorted(found - MENTIONS - NO_PARTS), sorted(NO_PARTS - found))
    assert sorted(found - MENTIONS - NO_PARTS) == []
