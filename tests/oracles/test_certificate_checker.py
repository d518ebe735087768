"""The checker of certificates proves every kind that optlink writes, and refuses every forgery in a sentence with its place."""

from __future__ import annotations

import ast
import copy
import itertools
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import flint
import numpy as np
import pytest

import optlink
from optlink.optimization.taylor_model import box_problem
from optlink.problem.design import DesignProblem
from optlink.tasks.results.certificate import certificate_document, numbers_of, sides_of
from optlink.validation import validate
from tests.as_dyads import as_dyads
from tests.cli.test_cli import run
from tests.oracles import ball, certificate_checker as checker
from tests.oracles.ball import Ball, box_minimum, constant, floats, lower_bound, positive_definite, square_floats, tangent_bound
from tests.oracles.certificate_checker import Refused, check, identity, uncovered
from tests.oracles.linkage_formulas import Expression, Problem, Unknown
from tests.tiers import mostly_slow

NARROW = {"mechanism.coupler": "412..418 mm", "mechanism.rocker": "228..232 mm", "requirement.points": 8}
NO_DESIGN = {"limits.transmission_angle": ["80 deg", "100 deg"]}
HERE = Path(__file__).parent
Document = dict[str, Any]


def certificate(problem: optlink.ProblemFile, gap: float = 1e-6) -> Document:
    result = optlink.solve(problem, certify=True, gap=gap)
    return json.loads(json.dumps(certificate_document(result.certificate, result)))


def sealed(document: Document) -> Document:
    """A forger can compute the hash of the problem too."""
    return document | {"identity": identity(document)}


@pytest.fixture(scope="module")
def narrow() -> Document:
    return certificate(optlink.load("crank-rocker", NARROW))


@pytest.fixture(scope="module")
def infeasible() -> Document:
    return certificate(optlink.load("crank-rocker", NARROW | NO_DESIGN))


# --- sound certificates -------------------------------------------------------------------------------------------------------

SLIDER = {
    "mechanism.links.crank.length": "50 mm",
    "mechanism.links.rod.length": "150 mm",
    "mechanism.guides.G.offset": "10 mm",
    "requirement.start": "20 deg",
}
SIX_BAR = {
    "mechanism.links.crank.length": "110 mm",
    "mechanism.links.coupler.length": "400 mm",
    "mechanism.links.rocker.length": "300 mm",
    "mechanism.links.rod.length": "500 mm",
    "requirement.start": "20 deg",
}
KINDS: dict[str, tuple[str, dict[str, Any], float]] = {
    "law": ("crank-rocker", NARROW, 1e-6),
    "law of the root mean square": ("crank-rocker", NARROW | {"requirement.measure": "rms"}, 1e-3),
    "law of the largest error": ("crank-rocker", NARROW | {"requirement.measure": "max"}, 1e-3),
    "law with a linked rocker": (
        "crank-rocker",
        NARROW | {"mechanism.rocker": {"equals": "-0.5*coupler + 1.5^2*(200 mm) - 12 mm", "bounds": ["150 mm", "231 mm"]}},
        1e-6,
    ),
    "law with a linked start": (
        "crank-rocker",
        NARROW | {"requirement.from": {"equals": "atan(rocker/frame) + 5 deg"}, "requirement.psi0": {"equals": "start + 75 deg"}},
        1e-3,
    ),
    "law with both assembly modes": ("crank-rocker", NARROW | {"mechanism.assembly": "either"}, 1e-3),
    "law over a span": (
        "crank-rocker",
        NARROW | {"limits.crank": "span", "limits.transmission_angle": ["30 deg", "150 deg"], "requirement.from": "10 deg"},
        1e-2,
    ),
    "function with free start angles": (
        "function-log10",
        {
            "requirement.measure": "rms",
            "requirement.points": 6,
            "mechanism.crank": "200 mm",
            "mechanism.coupler": "150 mm",
            "mechanism.rocker": "180 mm",
            "mechanism.assembly": "left",
            "requirement.from": {"bounds": ["20 deg", "60 deg"]},
            "requirement.psi0": {"bounds": ["-30 deg", "120 deg"]},
        },
        1e-2,
    ),
    "law that no design meets": ("crank-rocker", NARROW | NO_DESIGN, 1e-6),
    "law with limits of the rocker": (
        "crank-rocker",
        NARROW | {"limits.swing_angle": ["20 deg", "120 deg"], "limits.time_ratio": [1.0, 3.0]},
        1e-3,
    ),
    "law without a design variable in the missed limit": (
        "crank-rocker",
        {"mechanism.coupler": "300 mm", "mechanism.rocker": "200 mm", "requirement.psi0": {"bounds": ["60 deg", "120 deg"]}},
        1e-6,
    ),
    "slide of a slider-crank": ("law-slider-crank", SLIDER, 1e-3),
    "slide of a six-bar": ("law-six-bar", SIX_BAR, 1e-1),
    "transmission": (
        "transmission-optimal",
        {"mechanism.crank": "50..60 mm", "mechanism.coupler": "240..260 mm", "mechanism.rocker": "200 mm"},
        1e-3,
    ),
}


@pytest.mark.parametrize(
    "kind",
    mostly_slow(
        KINDS,
        "law of the largest error",
        "law over a span",
        "law that no design meets",
        "law with a linked rocker",
        "law without a design variable in the missed limit",
    ),
)
def test_a_sound_certificate_is_proven(kind: str) -> None:
    name, changes, gap = KINDS[kind]
    document = certificate(optlink.load(name, changes), gap)
    verdict = check(document)
    assert verdict.boxes == sum(len(cover["test"]) for cover in document["covers"])
    assert verdict.pieces >= verdict.boxes > 0
    assert str(verdict).startswith(f"proven: {name} ({document['problem_hash']};")


@pytest.mark.parametrize(
    ("kind", "swapped"),
    mostly_slow(
        itertools.product(
            ("law", "law with both assembly modes", "law over a span", "law with limits of the rocker", "transmission"),
            (False, True),
        ),
        ("law over a span", True),
    ),
)
def test_a_four_bar_of_dyads_has_the_certificate_of_its_lengths(kind: str, swapped: bool) -> None:
    name, changes, gap = KINDS[kind]
    problem = optlink.load(name, changes)
    section, dyads = (certificate(file, gap) for file in (problem, as_dyads(problem, swapped=swapped)))
    assert dyads["numbers"]["linkage"]["four_bar"]
    verdicts = [check(document) for document in (section, dyads)]
    assert verdicts[0].boxes == verdicts[1].boxes > 0
    assert dyads["status"] == section["status"]
    if section["objective"] is not None:
        assert dyads["objective"] == pytest.approx(section["objective"], rel=1e-12)
        assert dyads["lower_bound"] == pytest.approx(section["lower_bound"], rel=1e-9)


@pytest.mark.slow
def test_the_whole_crank_rocker_is_proven_as_the_page_on_certificates_shows() -> None:
    def worded(text: str) -> str:  # digits depend on the machine
        return re.sub(r"[\d.]+", "#", " ".join(text.split()))

    page = worded((HERE.parents[1] / "docs" / "certificates.md").read_text(encoding="utf-8"))
    document = certificate(optlink.load("crank-rocker"))
    verdict = check(document)
    assert verdict.boxes > 200
    assert worded(str(verdict)) in page
    _box_left_out(document)
    with pytest.raises(Refused) as refused:
        check(document)
    assert worded(f"refused: run/certificate.json: {refused.value}") in page


@pytest.mark.slow
def test_the_command_needs_no_optlink_and_checks_the_result_too(tmp_path: Path) -> None:
    changes = [f"--set={key}={value}" for key, value in NARROW.items()]
    assert run("solve", "crank-rocker", "--certify", "--out", str(tmp_path), *changes).exit_code == 0
    block = "import sys, runpy; sys.modules['optlink'] = sys.modules['numpy'] = None; sys.argv = sys.argv[1:]; "
    block += "runpy.run_path(sys.argv[0], run_name='__main__')"

    def command(*files: str) -> subprocess.CompletedProcess[str]:
        paths = [str(HERE / "certificate_checker.py"), *(str(tmp_path / file) for file in files)]
        return subprocess.run([sys.executable, "-c", block, *paths], capture_output=True, text=True, cwd=tmp_path, check=False)

    done = command("certificate.json", "result.json")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("proven: crank-rocker")
    document = json.loads((tmp_path / "certificate.json").read_text())
    (tmp_path / "other.json").write_text(
        json.dumps(json.loads((tmp_path / "result.json").read_text()) | {"problem_hash": "0" * 16})
    )
    for name, text, code, words in (
        ("raised.json", json.dumps(document | {"lower_bound": 2.0 * document["objective"]}), 1, "refused: "),
        ("half.json", json.dumps(document)[:500], 2, "unreadable: "),
        ("list.json", "[]", 2, "not a JSON object"),
        ("result.json", (tmp_path / "result.json").read_text(), 2, "this is not a certificate"),
    ):
        (tmp_path / name).write_text(text)
        done = command(name)
        assert (done.returncode, done.stdout) == (code, "")
        assert words in done.stderr
        assert done.stderr.count("\n") == 1
    assert command("none.json").returncode == command().returncode == 2
    done = command("certificate.json", "other.json")
    assert done.returncode == 1
    assert "problem_hash: the result has '0000000000000000'" in done.stderr


@pytest.mark.parametrize("file", ["ball.py", "certificate_checker.py", "linkage_formulas.py"])
def test_the_checker_imports_the_standard_library_and_flint_alone(file: str) -> None:
    tree = ast.parse((HERE / file).read_text(encoding="utf-8"))
    names = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    names |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    outside = {name for name in names if name and name.split(".")[0] not in sys.stdlib_module_names}
    assert outside <= {"flint", "tests.oracles.ball", "tests.oracles.linkage_formulas"}


# --- forgeries ----------------------------------------------------------------------------------------------------------------


def put(*path: str | int, value: Any) -> Callable[[Document], None]:
    """Set an entry; a function as the value is applied to the old one."""

    def forge(document: Document) -> None:
        part: Any = document
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = value(part[path[-1]]) if callable(value) else value

    return forge


def delete(*path: str | int) -> Callable[[Document], None]:
    def forge(document: Document) -> None:
        part: Any = document
        for key in path[:-1]:
            part = part[key]
        del part[path[-1]]

    return forge


def _raised_with_the_objective(document: Document) -> None:
    document["objective"] *= 1.0 + 1e-13
    document["lower_bound"] = document["objective"]


def _box_left_out(document: Document) -> None:
    for name in ("low", "high", "test", "multipliers"):
        del document["covers"][0][name][7]


def _box_moved(document: Document) -> None:
    for name in ("low", "high"):
        document["covers"][0][name][7][0] += 1e-15


def _columns_swapped(document: Document) -> None:
    for name in ("low", "high"):
        document["covers"][0][name] = [row[::-1] for row in document["covers"][0][name]]


def _corners_swapped(document: Document) -> None:
    cover = document["covers"][0]
    cover["low"], cover["high"] = cover["high"], cover["low"]


def _infeasible(document: Document) -> None:
    document.update(status="infeasible", objective=None, lower_bound=None, design=None)


def _worse_design(document: Document) -> None:
    """A valid design that is not optimal, with a bound just below it."""
    model = optlink.load("crank-rocker", NARROW).model
    assert isinstance(model, DesignProblem)
    worse = model.design({"coupler": 0.4155, "rocker": 0.2315})
    assert validate(model, worse).valid
    objective = validate(model, worse).objective
    assert objective > 1.001 * document["objective"]
    document.update(design=worse, objective=objective, lower_bound=objective * (1.0 - 1e-7), status="global")


def _wide(document: Document) -> None:
    """The proof of a part of the bounds, for wider ones."""
    document["numbers"]["quantities"]["coupler"]["high"] = 0.5


def _mode_left_out(document: Document) -> None:
    document["numbers"]["modes"].append({"assembly": "right", "sides": {"C": -1}})


def _mode_twice(document: Document) -> None:
    document["numbers"]["modes"] *= 2
    document["covers"] *= 2


def _other_law(document: Document) -> None:
    document["numbers"]["law"]["text"] += " + 0.001*(phi - phi0)"


FORGERIES: dict[str, tuple[Callable[[Document], None], str]] = {
    "bound raised above the objective by 1e-13": (
        lambda document: document.update(lower_bound=document["objective"] * (1.0 + 1e-13)),
        "lower_bound: ",
    ),
    "bound and objective raised by 1e-13": (_raised_with_the_objective, "lower_bound: "),
    "objective raised by 1e-8": (put("objective", value=lambda x: x * (1.0 + 1e-8)), "objective: the design has the objective"),
    "objective lowered by 1e-8": (put("objective", value=lambda x: x * (1.0 - 1e-8)), "objective: the design has the objective"),
    "bound lowered under a global optimum": (put("lower_bound", value=lambda x: 0.9 * x), "status: the gap is 0.1"),
    "negative bound": (put("lower_bound", value=-1.0), "status: the gap is"),
    "local optimum as a global one": (_worse_design, "in it violates none of the limits and has a lower objective"),
    "box shrunk by 1e-12": (put("covers", 0, "high", 7, 1, value=lambda x: x - 1e-12), "covers[0]: no box covers a part of"),
    "box moved by 1e-15": (_box_moved, "covers[0]: no box covers a part of"),
    "box left out": (_box_left_out, "covers[0]: no box covers a part of"),
    "wider bounds": (_wide, "covers[0]: no box covers a part of"),
    "columns swapped": (_columns_swapped, "covers[0]: no box covers a part of"),
    "corners swapped": (_corners_swapped, "covers[0].high[0]: the upper corner"),
    "design variables swapped": (
        put("unknowns", value=["rocker", "coupler"]),
        "unknowns: the design variables of the problem are",
    ),
    "no boxes": (put("covers", value=[]), "covers: the boxes are those of the assembly modes []"),
    "assembly mode left out": (_mode_left_out, "covers: the boxes are those of the assembly modes"),
    "assembly mode twice": (_mode_twice, "covers: the boxes are those of the assembly modes"),
    "boxes of the other assembly mode": (
        put("numbers", "modes", 0, "sides", "C", value=-1),
        "design.phi0: this is not the angle of the design",
    ),
    "a feasible problem called infeasible": (_infeasible, "violates none of the limits"),
    "infeasible with a design": (put("status", value="infeasible"), "objective: there is none if no design is feasible"),
    "design changed by 1e-6": (put("design", "coupler", value=lambda x: x + 1e-6), "design"),
    "start angle changed by 1e-6": (put("design", "phi0", value=lambda x: x + 1e-6), "design.phi0: "),
    "design beyond the bounds": (put("design", "rocker", value=0.24), "design.rocker: 0.24 is beyond 0.228 ... 0.232"),
    "design without a length": (delete("design", "frame"), "design.frame: this is missing"),
    "design that violates a limit": (
        put("numbers", "limits", "transmission", "C", "high", value=lambda x: x - 1e-6),
        "design: the design violates limits.transmission_angle",
    ),
    "other law": (_other_law, "objective: the design has the objective"),
    "other length": (put("numbers", "quantities", "frame", "value", value=0.51), "design"),
    "other position": (put("numbers", "offsets", 3, value=lambda x: x + 1e-4), "objective: the design has the objective"),
    "other measure": (put("numbers", "measure", value="max"), "objective: the design has the objective"),
    "unknown function in the law": (
        put("numbers", "law", "text", value="psi0 + gamma(phi)"),
        "numbers: the problem is incomplete",
    ),
    "negative multiplier": (put("covers", 0, "multipliers", 3, value={"5": -1.0}), "covers[0].multipliers[3].5: "),
    "multiplier of no limit": (put("covers", 0, "multipliers", 3, value={"99": 1.0}), "covers[0].multipliers[3].99: "),
    "multipliers left out": (delete("covers", 0, "multipliers", 3), "covers[0].multipliers: expected"),
    "nan in a corner": (put("covers", 0, "low", 2, 1, value=float("nan")), "covers[0].low[2][1]: expected a finite number"),
    "null in a corner": (put("covers", 0, "low", 2, 1, value=None), "covers[0].low[2][1]: expected a finite number"),
    "text in a corner": (put("covers", 0, "high", 2, 1, value="0.5"), "covers[0].high[2][1]: expected a finite number"),
    "true in a corner": (put("covers", 0, "high", 2, 1, value=True), "covers[0].high[2][1]: expected a finite number"),
    "infinite bound": (put("lower_bound", value=float("inf")), "lower_bound: expected a finite number"),
    "corner with a coordinate too few": (
        put("covers", 0, "low", 2, value=[0.412]),
        "covers[0].low[2]: a corner has 2 coordinates",
    ),
    "unknown status": (put("status", value="proven"), "status: expected one of global, within gap, infeasible"),
    "unknown key": (put("more", value=1), "more: no certificate has this key"),
    "no objective": (put("objective", value=None), "objective: this is missing"),
    "no numbers": (delete("numbers", "offsets"), "numbers.offsets: this is missing"),
    "no range": (put("numbers", "quantities", "coupler", "low", value=0.9), "numbers.quantities.coupler: the lower bound"),
    "a number beyond all": (put("objective", value=10**400), "objective: expected a finite number"),
    "side of no assembly mode": (
        put("numbers", "modes", 0, "sides", "C", value=0.5),
        "numbers.modes[0].sides.C: expected one of 1, -1",
    ),
    "nested brackets": (put("numbers", "law", "text", value=5000 * "("), "numbers: the problem is incomplete"),
    "unknown dyad": (
        put("numbers", "linkage", "dyads", 0, "kind", value="RRRR"),
        "numbers.linkage.dyads[0].kind: expected one of",
    ),
}
UNSEALED: dict[str, Callable[[Document], None]] = {
    "faked hash of the problem": put("problem_hash", value="0123456789abcdef"),
    "faked name": put("problem", value="my-crank-rocker"),
    "faked identity": put("identity", value="0" * 64),
    "changed number": put("numbers", "limits", "alignment", value=0.02),
    "numbers of another problem": put("numbers", "offsets", value=lambda offsets: [0.5 * offset for offset in offsets]),
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_a_forgery_is_refused_with_its_place(narrow: Document, forgery: str) -> None:
    forge, words = FORGERIES[forgery]
    document = copy.deepcopy(narrow)
    forge(document)
    with pytest.raises(Refused) as refused:
        check(sealed(document))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("forgery", UNSEALED)
def test_a_changed_problem_is_refused_by_its_hash(narrow: Document, forgery: str) -> None:
    document = copy.deepcopy(narrow)
    UNSEALED[forgery](document)
    with pytest.raises(Refused, match=r"identity: this is not the hash of the problem"):
        check(document)


@pytest.mark.parametrize(
    ("forge", "words"),
    [
        (_box_left_out, "no box covers"),
        (put("lower_bound", value=0.001), "lower_bound: there is none if no design is feasible"),
        (put("numbers", "limits", "transmission", value={}), "violates none of the limits"),
    ],
)
def test_a_forgery_of_an_infeasible_problem_is_refused(
    infeasible: Document, forge: Callable[[Document], None], words: str
) -> None:
    document = copy.deepcopy(infeasible)
    forge(document)
    with pytest.raises(Refused, match=words):
        check(sealed(document))


@pytest.mark.slow
def test_no_damage_ends_in_a_traceback(infeasible: Document) -> None:
    """Any entry left out, or replaced by a value of another kind."""
    rng = np.random.default_rng(11)
    refused = 0
    for _ in range(60):
        document = copy.deepcopy(infeasible)
        part: Any = document
        while isinstance(part, dict | list) and part:
            keys = list(part) if isinstance(part, dict) else list(range(len(part)))
            key = keys[rng.integers(len(keys))]
            above, part = part, part[key]
            if rng.random() < 0.2:
                break
        if rng.random() < 0.5:
            del above[key]
        else:
            above[key] = [None, "x", -1.0, [], {}, True, 1e300][rng.integers(7)]
        try:
            check(
                document | {"identity": identity(document)}
                if {"problem", "problem_hash", "numbers"} <= set(document)
                else document
            )
        except (Refused, checker.Unreadable) as fault:
            refused += 1
            assert "\n" not in str(fault)
    assert refused > 30


@pytest.mark.parametrize("key", ["problem_hash", "status", "lower_bound"])
def test_the_certificate_of_another_result_is_refused(narrow: Document, key: str) -> None:
    proof = {name: narrow[name] for name in ("status", "lower_bound")}
    result = {"problem_hash": narrow["problem_hash"], "certificate": proof}
    checker.check_result(narrow, result)
    (result if key == "problem_hash" else proof)[key] = "another"
    with pytest.raises(Refused, match=f"{key}: the result has 'another'"):
        check(narrow, result)


@pytest.mark.slow
def test_wrong_multipliers_do_not_matter(narrow: Document) -> None:
    document = copy.deepcopy(narrow)
    for row in document["covers"][0]["multipliers"]:
        row.update({str(k): 3.0 for k in range(4)})
    assert check(document | {"lower_bound": 0.9 * document["objective"], "status": "within gap", "asked": 0.2})


# --- formulas -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "crank-rocker",
        "function-log10",
        "law-six-bar",
        "law-slider-crank",
        "path-closed18",
        "path-conveyor",
        "transmission-optimal",
    ],
)
def test_deviations_and_limits_are_those_of_the_search(name: str) -> None:
    """The formulas of the checker, written separately, have the values of those of the search, row for row."""
    compare(optlink.load(name).variants()[0])


GROUND = {"A": ["0 mm", "0 mm"], "D": ["150 mm", "-30 mm"]}
PLACES = [(150, 90, 20), (160, 80, 50), (150, 70, 80)]
POINTS = {"timing": "given", "points": [{"x": f"{x} mm", "y": f"{y} mm", "crank": f"{phi} deg"} for x, y, phi in PLACES]}
OTHERS: dict[str, dict[str, Any]] = {
    "RPR": {
        "mechanism": {
            "type": "dyads",
            "ground": GROUND,
            "links": {
                "crank": {"joints": ["A", "B"], "length": {"bounds": ["40 mm", "60 mm"]}},
                "block": {"joints": ["B"]},
                "lever": {"joints": ["D", "E"], "length": "200 mm", "points": {"P": ["120 mm", "15 mm"]}},
            },
            "guides": {"G": {"slider": "block", "on": "lever", "through": "D", "direction": "5 deg", "offset": "7 mm"}},
            "assembly": {"G": "forward"},
        },
    },
    "RPP": {
        "mechanism": {
            "type": "dyads",
            "ground": GROUND,
            "links": {
                "crank": {"joints": ["A", "B"], "length": {"bounds": ["40 mm", "60 mm"]}},
                "block": {"joints": ["B"]},
                "yoke": {"joints": ["Y"], "points": {"P": ["12 mm", "15 mm"]}},
            },
            "guides": {
                "R": {"slider": "yoke", "through": "D", "direction": "10 deg"},
                "S": {"slider": "block", "on": "yoke", "through": "Y", "direction": "80 deg", "offset": "3 mm"},
            },
        },
    },
    "PRP": {
        "mechanism": {
            "type": "dyads",
            "ground": GROUND,
            "links": {
                "crank": {"joints": ["A", "B"], "length": {"bounds": ["40 mm", "60 mm"]}},
                "sleeve": {"joints": ["P"]},
                "block": {"joints": ["P"]},
            },
            "guides": {
                "R": {"slider": "sleeve", "on": "crank", "through": "A", "direction": "0 deg", "offset": "4 mm"},
                "S": {"slider": "block", "through": "D", "direction": "120 deg"},
            },
        },
    },
}


@pytest.mark.parametrize("kind", mostly_slow(OTHERS, "RPR", "RPP"))
def test_every_dyad_has_the_positions_of_the_search_and_a_proof(kind: str) -> None:
    file = one_dyad(kind).variants()[0]
    assert [group.kind for group in file.model.linkage.groups] == [kind]
    compare(file)
    assert check(certificate(one_dyad(kind), 1e-3))


@pytest.mark.slow
def test_poses_pivots_and_tolerances_are_proven_too() -> None:
    linkage = copy.deepcopy(OTHERS["RPR"]["mechanism"])
    poses = [{**place, "angle": f"{angle} deg"} for place, angle in zip(POINTS["points"], (20, 25, 30), strict=True)]
    mark, region = {"bounds": ["-180 deg", "180 deg"]}, {"x": ["-3 mm", "200 mm"], "y": ["-50 mm", "50 mm"]}
    motion = {"kind": "motion", "point": "P", "timing": "given", "points": poses, "angle_length": "50 mm", "mark": mark}
    moved = linkage | {"ground": GROUND | {"A": [{"bounds": ["-5 mm", "5 mm"]}, "0 mm"]}}
    limits = {"crank": "span", "pivots": region}
    document = certificate(optlink.read({"title": "poses", "mechanism": moved, "requirement": motion, "limits": limits}), 1e-2)
    assert document["status"] != "infeasible"
    assert any("limits.pivots" in cover["limits"] for cover in document["covers"])
    assert check(document)
    near = [{**place, "tolerance": "40 mm"} for place in POINTS["points"]]
    path = {"kind": "path", "point": "P", "timing": "from start", "points": near, "start": {"bounds": ["-20 deg", "20 deg"]}}
    document = certificate(
        optlink.read({"title": "path", "mechanism": linkage, "requirement": path, "limits": {"crank": "span"}})
    )
    assert document["status"] == "infeasible"
    assert check(document)
    document["numbers"]["tolerances"] = [0.4, 0.4, 0.4]
    with pytest.raises(Refused, match="violates none of the limits"):
        check(sealed(document))


def one_dyad(kind: str) -> optlink.ProblemFile:
    raw = OTHERS[kind] | {"title": "one dyad", "requirement": {"kind": "path", "point": "P", **POINTS}}
    raw["limits"] = {"crank": "span", "transmission_angle": ["20 deg", "160 deg"], "alignment": "3 deg"}
    return optlink.read(raw)


def compare(file: optlink.ProblemFile) -> None:
    boxes = box_problem(file)
    known = [file.model.quantities[key].value for key in file.model.free]
    x = np.clip(np.array(known), boxes.low, boxes.high)
    models = boxes.over(x[None], x[None])
    modes = [{"assembly": "the only one", "sides": sides_of(file.model.linkage)}]
    numbers = json.loads(json.dumps(numbers_of(file, np.zeros(0)) | {"modes": modes}))
    checker.check_form(numbers, checker.NUMBERS, "numbers")
    with flint.ctx.workprec(100):
        problem = Problem(numbers, numbers["modes"][0])
        values = problem.values([float(one) for one in x], [flint.arb(0)] * len(x))
        slacks, start = problem.slacks(values), problem.starts(values)[0]
        assert tuple(key for key, _ in slacks) == boxes.limits
        for (_, slack), value, remainder in zip(slacks, models.slacks.value[0], models.slacks.remainder[0], strict=True):
            both = np.isfinite(remainder) and slack.known
            assert not both or float(slack.centre) == pytest.approx(value, rel=1e-9, abs=1e-12)
        compared = 0
        for position, computed in enumerate(problem.deviations(values, start)):
            for k, one in enumerate(computed):
                if one.model is not None:
                    compared += 1
                    size = abs(models.residuals.value[0, position, k])  # angles count in either sense
                    assert abs(float(one.model.centre)) == pytest.approx(size, rel=1e-9, abs=1e-12)
        assert compared or not np.any(np.isfinite(models.residuals.remainder))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("-x^2", -9.0), ("2^3^2", 512.0), ("2^-1", 0.5), ("1 - 2 - 3", -4.0), ("8/2*4", 16.0), ("2*(x + 1.5e1)**2", 648.0)),
        *(("x^2.5", 3.0**2.5), ("sin(pi/6) + log10(100)*abs(-x)", 6.5), ("-(-x) + +2", 5.0)),
    ],
)
def test_expressions(text: str, value: float) -> None:
    assert float(Expression(text, {"x": constant(3.0)}).value.value) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("text", ["", "x +", "(x", "x)", "y", "sin x", "x ~ 2", "2 x"])
def test_an_expression_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(Unknown):
        Expression(text, {"x": constant(3.0)})


# --- parts --------------------------------------------------------------------------------------------------------------------


def test_guillotine_partitions() -> None:
    rng = np.random.default_rng(3)
    for count in (1, 2, 3):
        low, high = np.zeros((1, count)), np.ones((1, count))
        whole = [0.0] * count, [1.0] * count
        for _ in range(60):  # a cut through a box, anywhere, along any variable
            k, i = rng.integers(len(low)), rng.integers(count)
            at = rng.uniform(low[k, i], high[k, i])
            low, high = np.vstack([low, low[k]]), np.vstack([high, high[k]])
            high[k, i] = low[-1, i] = at
        assert uncovered(low.tolist(), high.tolist(), whole) is None
        assert uncovered([*low.tolist(), *low[:3].tolist()], [*high.tolist(), *high[:3].tolist()], whole) is None  # twice
        for k in rng.integers(len(low), size=6):
            keep = np.arange(len(low)) != k
            gap = uncovered(low[keep].tolist(), high[keep].tolist(), whole)
            assert gap is not None
            assert np.all(gap[0] < high[k])
            assert np.all(gap[1] > low[k])
            smaller = high.copy()
            smaller[k, 0] = np.nextafter(smaller[k, 0], 0.0)
            assert uncovered(low.tolist(), smaller.tolist(), whole) is not None


def test_balls_contain_values_and_derivatives() -> None:
    """Values, gradients and Hessians of formulas, with those by differences at 200 bits at random designs of the box."""
    rng = np.random.default_rng(5)
    call = ball.FUNCTIONS
    formulas: list[Callable[..., Ball]] = [
        lambda x, y: call["sqrt"](x) * call["sin"](x * y) / (1.0 + y * y),
        lambda x, y: ball.angle_of((x - 3.0, y - 2.0)) * call["exp"](-x),
        lambda x, y: ball.power(call["log"](x + y), constant(2)) - call["tan"](0.3 * x) + ball.power(x, constant(-3)),
        lambda x, y: call["asin"](0.3 * x) + call["acos"](0.2 * y) - call["sinh"](x) * call["tanh"](y) + call["log10"](x),
        lambda x, y: ball.power(y, constant(-0.7)) + call["atan"](x * y) - ball.power(y, x),
        lambda x, y: ball.absolute(x - 3.0) * ball.maximum(x, -y) + call["cosh"](x) * call["cos"](y),
    ]
    step = flint.arb(2) ** -40
    with flint.ctx.workprec(200):
        for formula in formulas:
            for _ in range(10):
                centre, scale = rng.uniform(1.0, 1.6, 2), 10.0 ** rng.uniform(-6.0, -1.0, 2)

                def at(d: list[Any], centre: Any = centre, scale: Any = scale, formula: Any = formula) -> Any:
                    return formula(
                        *(constant(flint.arb(c) + flint.arb(s) * x) for c, s, x in zip(centre, scale, d, strict=True))
                    ).value

                result = formula(*(Ball.variable(k, 2, centre[k], flint.arb(scale[k])) for k in range(2)))
                assert result.known
                assert result.centre.overlaps(at([0, 0]))
                d = [flint.arb(x) for x in rng.uniform(-1.0, 1.0, 2)]
                assert result.value.contains(at(d))
                assert result.range.contains(at(d))
                assert lower_bound(result) <= at(d)
                near = flint.arb(0, 1e-9)
                for i in range(2):
                    unit = [step * (k == i) for k in range(2)]
                    up, down = (at([x + sign * u for x, u in zip(d, unit, strict=True)]) for sign in (1, -1))
                    assert (result.gradient[0, i] + near).contains((up - down) / (2 * step))
                    assert (result.hessian[i, i] + near).contains((up - 2 * at(d) + down) / (step * step))


def test_definite_matrices() -> None:
    assert positive_definite(flint.arb_mat(2, 2, [2, 1, 1, 2]))
    assert not positive_definite(flint.arb_mat(2, 2, [1, 2, 2, 1]))
    assert not positive_definite(flint.arb_mat(2, 2, [flint.arb(1, 0.6), 0.5, 0.5, flint.arb(1, 0.6)]))


def test_angles_beyond_half_a_turn() -> None:
    """A box across the negative x axis: the angle is continuous; inside limits, which mean the principal value, undefined."""
    direction = constant(-1.0), Ball.variable(0, 1, 0.1, flint.arb(0.2))
    angle = ball.angle_of(direction)
    assert float(angle.range.upper()) == pytest.approx(np.pi + np.arctan(0.1), rel=1e-2)
    assert not ball.angle_of(direction, principal=True).known


def test_not_negative_least_squares() -> None:
    from scipy.optimize import nnls

    rng = np.random.default_rng(7)
    for _ in range(20):
        matrix, right = rng.normal(size=(6, 4)), rng.normal(size=6)
        assert checker.not_negative_least_squares(matrix.T.tolist(), right.tolist()) == pytest.approx(
            nnls(matrix, right)[0], abs=1e-9
        )


def test_tangent_plane_of_a_convex_quantity() -> None:
    """The tangent plane at about the minimum is a lower bound, and as high as the minimum; so over a corner of the box."""
    for centre, least in ((0.2, 0.0), (0.9, 0.9)):  # minimum inside, and at the lower end of both variables
        scale = flint.arb(0.5)

        def quantity(at: list[float], over: bool, scale: Any = scale) -> Ball:
            x, y = (Ball.variable(k, 2, at[k], scale, over=over) for k in range(2))
            return ball.FUNCTIONS["exp"](x) - x + ball.FUNCTIONS["exp"](-y) + 2.0 * y * y - 0.3 * x * y

        box = quantity([centre, centre], True)
        assert positive_definite(box.hessian)
        point = [0.0, 0.0]
        for _ in range(6):
            model = quantity([centre + 0.5 * d for d in point], False)
            point = box_minimum(floats(model.slope), square_floats(box.hessian), point)
        bound = float(tangent_bound(quantity([centre + 0.5 * d for d in point], False), [flint.arb(d) for d in point]))
        d = np.linspace(-1.0, 1.0, 401)
        x, y = np.meshgrid(centre + 0.5 * d, centre + 0.5 * d)
        smallest = float(np.min(np.exp(x) - x + np.exp(-y) + 2.0 * y * y - 0.3 * x * y))
        assert smallest - 1e-4 <= bound <= smallest + 1e-12
        assert float(lower_bound(box)) <= bound + 1e-12
        assert (least > 0.0) == all(at == -1.0 for at in point)
