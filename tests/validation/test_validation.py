"""The validator must see every planted defect, name the check that it belongs to, and nothing else; and pass what is right."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

import optlink
from optlink.linkage.dyads import RRR, rrr
from optlink.linkage.fourbar import LENGTHS, Inversion, dead_centre, four_bar, grashof, swing, time_ratio
from optlink.linkage.jet import Jet
from optlink.linkage.mechanism import Link, Mechanism
from optlink.optimization import terms
from optlink.problem.design import DesignProblem
from optlink.validation import Validation, validate
from tests.solved import loaded
from tests.tiers import examples

OPTIMUM = {"coupler": 0.41286541580, "rocker": 0.23224617124}
PRINTED = {"coupler": 0.41226, "rocker": 0.2322417}

# a check by a word of its name, in the order in which the words are looked for
CHECKS = {
    "within its bounds": "bounds",
    "link lengths": "lengths",
    "Grashof": "grashof",
    "off alignment": "assembled",
    "C apart from A": "apart",
    "one branch": "branch",
    "one circuit": "circuit",
    "smallest transmission angle": "smallest",
    "largest transmission angle": "largest",
    "rocker at rest": "at rest",
    "in line": "in line",
    "psi0 is the rocker angle": "psi0",
    "output error": "finite",
    "objective": "objective",
    "two dead centres": "dead centres",
    "swing angle": "swing",
    "time ratio": "time ratio",
    "frame length": "frame length",
    " / frame": "link ratio",
}


def kind(name: str) -> str:
    return next(kind for word, kind in CHECKS.items() if word in name)


def failed(proof: Validation) -> set[str]:
    return {kind(check.name) for check in proof.checks if not check.passed}


def measured(proof: Validation, expected: str) -> float:
    (check,) = (check for check in proof.checks if kind(check.name) == expected)
    return check.value


def problem(
    mechanism: Mapping[str, object] | None = None,
    requirement: Mapping[str, object] | None = None,
    limits: Mapping[str, object] | None = None,
) -> DesignProblem:
    """The shipped crank-rocker with other values (None: without that key)."""
    raw = {key: value for key, value in loaded("crank-rocker").raw.items() if key != "expected"}
    for section, changes in (("mechanism", mechanism), ("requirement", requirement), ("limits", limits)):
        merged = {**raw[section], **(changes or {})}
        raw[section] = {key: value for key, value in merged.items() if value is not None}
    return optlink.read(raw).spec


def lengths(crank: float, coupler: float, rocker: float, frame: float) -> dict[str, str]:
    values = zip(LENGTHS, (crank, coupler, rocker, frame), strict=True)
    return {name: f"{1e3 * value!r} mm" for name, value in values}


SHIPPED = problem()
BEST = SHIPPED.design(OPTIMUM)
BEST_LENGTHS = [BEST[name] for name in LENGTHS]

# nothing tied to a dead centre and no limit near: here a defect of the mechanism shows in as few checks as can be
LOOSE = problem(None, {"from": "60 deg", "psi0": "120 deg"}, {"transmission_angle": ["30 deg", "150 deg"]})
LOOSE_DESIGN = LOOSE.design({"coupler": 0.41, "rocker": 0.3})


# --- what is right passes ----------------------------------------------------------------------------------------------


def test_the_alignment_check_names_the_bodies_of_a_single_dyad():
    """Not "coupler and rocker" of a linkage with other bodies."""
    raw = {
        "mechanism": {
            "ground": {"A": ["0 m", "0 m"], "D": ["-2.6 m", "3.2 m"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": {"start": "0.9 m", "bounds": ["0.8 m", "1 m"]}},
                "pitman": {"joints": ["B", "C"], "length": "3.1 m"},
                "beam": {"joints": ["D", "C"], "length": "2.5 m"},
            },
            "assembly": {"C": "right of B-D"},
        },
        "objective": {"quantity": "total length"},
    }
    names = [check.name for check in optlink.validate(optlink.read(raw), {"crank.length": 0.9}).validation.checks]
    assert "pitman and beam off alignment over the revolution" in names


@pytest.mark.parametrize(("least", "limits"), [(1.0, {}), (0.2, {"alignment": "0.2 deg"})])
def test_the_limit_of_alignment_is_that_of_the_file_or_one_degree(least, limits):
    for angle, meets in ((1.001 * least, True), (0.98 * least, False)):
        rule = nearly_aligned(angle, **limits)
        values = rule.design({})
        check = next(check for check in validate(rule, values).checks if "off alignment" in check.name)
        assert (check.value, check.passed) == (pytest.approx(angle, rel=1e-6), meets)
        aligned = [
            row for row in terms.rows(rule, values, rule.reach(values), values["frame"]) if row.limit == "limits.alignment"
        ]
        assert aligned
        assert all(row.low <= row.value <= row.high for row in aligned) == meets  # what the optimiser sees


def test_the_optimum_is_valid():
    proof = validate(SHIPPED, BEST, objective=0.00759237360)
    assert proof.valid
    assert failed(proof) == set()
    assert proof.objective == pytest.approx(0.00759237360, abs=1e-10)
    assert measured(proof, "largest") == pytest.approx(135.0, abs=1e-6)


def test_the_printed_design_is_not():
    """Chinese textbook case: the printed coupler of 412.26 mm violates the source's own limit of 135 deg."""
    proof = validate(SHIPPED, SHIPPED.design(PRINTED), objective=0.0075491)
    assert not proof.valid
    assert failed(proof) <= {"largest", "objective"}
    assert failed(validate(SHIPPED, SHIPPED.design(PRINTED))) == {"largest"}
    assert measured(proof, "largest") == pytest.approx(135.298, abs=1e-3)
    assert proof.objective == pytest.approx(0.0075491, abs=5e-8)


def test_every_check_has_a_kind_a_limit_and_a_finite_value():
    proof = validate(SHIPPED, BEST, objective=0.00759237360)
    kinds = [kind(check.name) for check in proof.checks]
    assert kinds.count("bounds") == 4
    where_asked = {"dead centres", "swing", "time ratio", "frame length", "link ratio", "apart"}
    assert sorted(k for k in kinds if k != "bounds") == sorted(set(CHECKS.values()) - where_asked - {"bounds"})
    assert all(check.limit and math.isfinite(check.value) for check in proof.checks)


VALID = {
    "loose": (LOOSE, LOOSE_DESIGN),
    "right": (problem({"assembly": "right"}), None),
    "inner dead centre": (problem(None, {"from": "inner dead centre", "law": "psi0 - 0.3*(phi - phi0)"}), None),
    "clockwise": (problem(None, {"span": "-70 deg"}), None),
    "rms": (problem(None, {"measure": "rms"}), None),
    "largest error": (problem(None, {"measure": "max"}), None),
    "table": (
        problem(None, {"law": {"phi": ["10 deg", "50 deg"], "psi": ["1 deg", "9 deg"]}, "span": None, "points": None}),
        None,
    ),
    "double-crank": (
        problem(
            lengths(0.5, 0.4, 0.45, 0.1),
            {"from": "60 deg"},
            {"crank": "double-crank", "transmission_angle": ["20 deg", "160 deg"]},
        ),
        None,
    ),
    "span": (
        problem(
            lengths(0.3, 0.2, 0.25, 0.34),
            {"from": "40 deg", "span": "20 deg"},
            {"crank": "span", "transmission_angle": ["1 deg", "179 deg"]},
        ),
        None,
    ),
    "all limits": (
        problem(
            None,
            None,
            {
                "swing_angle": ["52 deg", "53 deg"],
                "time_ratio": [1.07, 1.08],
                "frame_length": ["500 mm", "500 mm"],
                "link_ratio": [0.2, 0.826],
            },
        ),
        None,
    ),
}


@pytest.mark.parametrize("name", VALID)
def test_valid_designs_pass(name):
    rule, design = VALID[name]
    design = design or rule.design(OPTIMUM if rule.free else {})
    result = validate(rule, design)
    assert failed(result) == set()
    assert result.objective > 0.0
    assert failed(validate(rule, design, objective=result.objective)) == set()


def own_angle(design: Mapping[str, float], phi: float, side: int) -> float:
    """Angle of the rocker by the triangle B-C-D, seen from D."""
    crank, coupler, rocker, frame = (design[name] for name in LENGTHS)
    x, y = crank * math.cos(phi) - frame, crank * math.sin(phi)
    square = x * x + y * y
    return math.atan2(y, x) - side * math.acos(
        (square + rocker * rocker - coupler * coupler) / (2.0 * rocker * math.sqrt(square))
    )


@pytest.mark.parametrize("measure", ["sum of squares", "rms", "max"])
@pytest.mark.parametrize("side", [1, -1])
def test_objective_is_that_of_the_triangle(measure, side):
    rule = problem({"assembly": "left" if side > 0 else "right"}, {"measure": measure})
    design = rule.design(OPTIMUM)
    start = own_angle(design, design["phi0"], side)
    errors = []
    for i in range(1, 31):
        turned = i * math.pi / 2.0 / 30.0
        reference = start + 2.0 / (3.0 * math.pi) * turned**2
        errors.append(math.remainder(reference - own_angle(design, design["phi0"] + turned, side), math.tau))
    square = sum(error**2 for error in errors)
    expected = {"sum of squares": square, "rms": math.sqrt(square / 30), "max": max(map(abs, errors))}[measure]
    assert validate(rule, design).objective == pytest.approx(expected, rel=1e-10)


def test_swing_and_time_ratio_are_measured():
    rule = VALID["all limits"][0]
    result = {check.name: check.value for check in validate(rule, rule.design(OPTIMUM)).checks}
    swings = [value for name, value in result.items() if kind(name) == "swing"]
    ratios = [value for name, value in result.items() if kind(name) == "time ratio"]
    assert swings == [pytest.approx(math.degrees(swing(*BEST_LENGTHS, 1)), abs=1e-9)] * 2
    assert ratios == [pytest.approx(time_ratio(*BEST_LENGTHS, 1), abs=1e-9)] * 2


# --- planted defects -----------------------------------------------------------------------------------------------


def stretched(rule: DesignProblem, design: Mapping[str, float], body: str, by: float) -> Mechanism:
    """The problem's linkage with one link longer than the design says."""
    honest = rule.linkage

    def link(old: Link) -> Link:
        return replace(old, length=design[body] + by) if old.body == body else old

    groups = tuple(replace(group, first=link(group.first), second=link(group.second)) for group in honest.groups)
    return replace(honest, crank=link(honest.crank), groups=groups)


def exchanged(rule: DesignProblem) -> Mechanism:
    """Coupler and rocker swapped."""
    (group,) = rule.linkage.groups
    first, second = replace(group.first, length="rocker"), replace(group.second, length="coupler")
    return replace(rule.linkage, groups=(replace(group, first=first, second=second),))


@dataclass(frozen=True)
class Flipping(RRR):
    """A group that changes its assembly mode while the crank passes the frame line, as a linkage after a collision would."""

    def solve(self, pose):
        height, sizes = pose.points["B"][1], pose.sizes
        side = np.where((height.value if isinstance(height, Jet) else height) > 0.0, 1, -1)
        pose.points["C"], margin = rrr(pose.points["B"], pose.points["D"], sizes["coupler"], sizes["rocker"], side)
        return margin


def flipping(rule: DesignProblem) -> Mechanism:
    (group,) = rule.linkage.groups
    return replace(rule.linkage, groups=(Flipping(**vars(group)),))


@dataclass(frozen=True)
class Defect:
    """Something wrong: what `must` fail, and which companions `may`."""

    rule: DesignProblem
    design: Mapping[str, float]
    must: frozenset[str]
    may: frozenset[str] = frozenset()
    objective: float | None = None
    mechanism: Mechanism | None = None


def defect(rule, design, must, may="", **more) -> Defect:
    def words(text: str) -> frozenset[str]:
        return frozenset(word.strip() for word in text.split(",") if word.strip())

    return Defect(rule, design, words(must), words(may), **more)


def fixed(*values: float, **limits: object) -> DesignProblem:
    """A linkage without anything free, started from an angle, that no transmission limit holds."""
    return problem(lengths(*values), {"from": "60 deg", "psi0": "100 deg"}, {"transmission_angle": None, **limits})


def nearly_aligned(angle: float, **limits: object) -> DesignProblem:
    """A linkage whose coupler and rocker enclose an angle [deg] at the end of its span, by the laws of cosines."""
    square = 0.2**2 + 0.25**2 - 2.0 * 0.2 * 0.25 * math.cos(math.radians(angle))  # of B-D
    last = math.degrees(math.acos((0.3**2 + 0.34**2 - square) / (2.0 * 0.3 * 0.34)))
    return problem(
        lengths(0.3, 0.2, 0.25, 0.34),
        {"from": f"{-last - 40.0!r} deg", "span": "40 deg", "psi0": "100 deg"},
        {"crank": "span", "transmission_angle": None, **limits},
    )


@cache
def defects() -> dict[str, Defect]:
    computed: dict[str, Defect] = {}
    claimed = validate(SHIPPED, BEST).objective
    loosely = validate(LOOSE, LOOSE_DESIGN).objective
    for body in ("crank", "coupler", "rocker"):
        for sign in (1, -1):
            name = f"{body} {sign:+d} micrometre"
            longer = stretched(LOOSE, LOOSE_DESIGN, body, sign * 1e-6)
            computed[name] = defect(LOOSE, LOOSE_DESIGN, "lengths", mechanism=longer)
            computed[f"{name}, at the optimum"] = defect(
                SHIPPED,
                BEST,
                "lengths, psi0, objective",
                "at rest, in line, largest",
                objective=claimed,
                mechanism=stretched(SHIPPED, BEST, body, sign * 1e-6),
            )
    computed["coupler and rocker swapped"] = defect(LOOSE, LOOSE_DESIGN, "lengths", mechanism=exchanged(LOOSE))
    computed["coupler and rocker swapped, at the optimum"] = defect(
        SHIPPED, BEST, "lengths, at rest, in line, psi0", mechanism=exchanged(SHIPPED)
    )
    computed["wrong side"] = defect(LOOSE, LOOSE_DESIGN, "branch", mechanism=four_bar(-1))
    computed["wrong side, at the optimum"] = defect(
        SHIPPED, BEST, "branch, at rest, in line, psi0, objective", objective=claimed, mechanism=four_bar(-1)
    )
    computed["changes its side"] = defect(LOOSE, LOOSE_DESIGN, "circuit, branch", mechanism=flipping(LOOSE))
    degrees = {**BEST, "phi0": math.degrees(BEST["phi0"])}
    computed["degrees for radians"] = defect(SHIPPED, degrees, "at rest, in line, psi0")
    computed["degrees for radians, claimed"] = defect(SHIPPED, degrees, "at rest, in line, psi0, objective", objective=claimed)
    computed["degrees for radians in psi0"] = defect(SHIPPED, {**BEST, "psi0": math.degrees(BEST["psi0"])}, "psi0")
    inner = dead_centre(*BEST_LENGTHS, 1, False)
    there = {**BEST, "phi0": float(inner.phi), "psi0": float(inner.psi)}
    computed["the other dead centre"] = defect(SHIPPED, there, "in line")
    computed["the other dead centre, psi0 of the first"] = defect(SHIPPED, {**BEST, "phi0": there["phi0"]}, "in line, psi0")
    computed["phi0 off by a hundredth of a degree"] = defect(
        SHIPPED, {**BEST, "phi0": BEST["phi0"] + math.radians(0.01)}, "at rest", "psi0, in line"
    )
    computed["psi0 off by a millionth"] = defect(SHIPPED, {**BEST, "psi0": BEST["psi0"] + 1e-6}, "psi0")
    wide = problem(None, None, {"transmission_angle": ["5 deg", "175 deg"]})
    for name, values in {
        "coupler above": {"coupler": 0.90001, "rocker": 0.7},
        "rocker above": {"coupler": 0.8, "rocker": 0.90001},
        "rocker below": {"coupler": 0.43, "rocker": 0.09999, "crank": 0.1},
        "fixed crank changed": {**OPTIMUM, "crank": 0.09999},
        "fixed frame changed": {**OPTIMUM, "frame": 0.50001},
    }.items():
        shape = "grashof, assembled, branch, circuit, lengths, smallest, largest, finite" if "below" in name else ""
        computed[name] = defect(wide, wide.design(values), "bounds", shape)
    computed["phi0 that is given changed"] = defect(LOOSE, {**LOOSE_DESIGN, "phi0": 1.0}, "bounds")
    computed["psi0 that is given changed"] = defect(LOOSE, {**LOOSE_DESIGN, "psi0": 2.0}, "bounds")
    # where the modes meet, rounding decides whether C exists and on which side; what cannot be assembled has no lengths
    meet, gone = "assembled, branch, lengths, circuit, finite", "grashof, assembled, branch, circuit, lengths"
    for name, values, must, may in (
        ("parallelogram", (0.1, 0.3, 0.1, 0.3), "grashof", meet),
        ("change-point", (0.1, 0.3, 0.2, 0.4), "grashof", meet),
        ("kite", (0.1, 0.1, 0.3, 0.3), "grashof", meet),
        ("drag link", (0.5, 0.4, 0.45, 0.1), "grashof", ""),
        ("double-rocker", (0.3, 0.2, 0.25, 0.34), gone, "finite"),
        ("rocker-crank", (0.23, 0.41, 0.1, 0.5), gone, "finite"),
        ("triple-rocker", (0.3, 0.2, 0.2, 0.45), gone, "finite"),
        ("impossible", (0.1, 0.2, 0.1, 0.9), gone + ", finite", ""),
    ):
        rule = fixed(*values)
        computed[name] = defect(rule, rule.design({}), must, may)
    moved = problem(
        lengths(0.3, 0.2, 0.25, 0.34),
        {"from": "40 deg", "span": "60 deg", "psi0": "100 deg"},
        {"crank": "span", "transmission_angle": None},
    )
    # 0.01 mm between crank and coupler of a kite, 1e-4 of the rocker being 0.03 mm; at its other end 0.66 deg from alignment
    apart = {"crank": "span", "transmission_angle": None, "alignment": "0.1 deg"}
    folds = problem(lengths(0.1, 0.10001, 0.3, 0.3), {"from": "inner dead centre"}, apart)
    computed["crank pin on its pivot"] = defect(folds, folds.design({}), "apart")
    nearly = nearly_aligned(0.5)
    computed["nearly in line at the end"] = defect(nearly, nearly.design({}), "assembled")
    computed["span beyond the reach"] = defect(moved, moved.design({}), "assembled, branch, circuit, lengths, finite")
    for name, limits, must in (
        ("transmission angle 0.001 deg too large", {"transmission_angle": ["45 deg", "134.999 deg"]}, "largest"),
        ("transmission angle 0.001 deg too small", {"transmission_angle": ["70.38018 deg", "136 deg"]}, "smallest"),
        ("transmission cosine", {"transmission_angle": None, "transmission_cosine": [-0.70709, 0.7]}, "largest"),
        ("transmission cosine, below", {"transmission_angle": None, "transmission_cosine": [-0.8, 0.3357]}, "smallest"),
        ("swing too small", {"swing_angle": ["52.3821 deg", "60 deg"]}, "swing"),
        ("swing too large", {"swing_angle": ["40 deg", "52.3801 deg"]}, "swing"),
        ("swing not as wanted", {"swing_angle": "52.381 deg"}, "swing"),
        ("time ratio too small", {"time_ratio": [1.07428, 2.0]}, "time ratio"),
        ("time ratio too large", {"time_ratio": [1.0, 1.07426]}, "time ratio"),
        ("frame too long", {"frame_length": ["1 mm", "499.999 mm"]}, "frame length"),
        ("frame too short", {"frame_length": ["500.001 mm", "9 m"]}, "frame length"),
        ("crank too short for its frame", {"link_ratio": [0.20001, 0.9]}, "link ratio"),
        ("coupler too long for its frame", {"link_ratio": [0.1, 0.8257]}, "link ratio"),
    ):
        computed[name] = defect(problem(None, None, limits), BEST, must)
    least, largest = span_extremes(SHIPPED, BEST)
    for name, limit in {
        "smallest": [f"{least + 0.001} deg", "179 deg"],
        "largest": ["1 deg", f"{largest - 0.001} deg"],
    }.items():
        over = problem(None, None, {"transmission_angle": limit, "transmission_over": "span"})
        computed[f"transmission angle over the span, {name}"] = defect(over, BEST, name)
    # the extreme lies between two positions of the sweep, 6e-5 deg away from the nearer one
    past = {"from": "60.1 deg", "psi0": "120 deg", "span": "150 deg"}
    extremes = span_extremes(problem(None, past), LOOSE_DESIGN | {"phi0": math.radians(60.1)})
    limit = {"transmission_angle": ["1 deg", f"{extremes[1] - 1e-5!r} deg"], "transmission_over": "span"}
    between = problem(None, past, limit)
    computed["transmission angle between two positions"] = defect(
        between, between.design({"coupler": 0.41, "rocker": 0.3}), "largest"
    )
    swings = fixed(0.3, 0.2, 0.25, 0.34, swing_angle=["1 deg", "170 deg"])
    computed["swing of what does not turn"] = defect(
        swings, swings.design({}), "grashof, assembled", "branch, circuit, lengths, finite, dead centres, swing"
    )
    triple = fixed(0.3, 0.2, 0.2, 0.45, swing_angle=["1 deg", "170 deg"])
    computed["no dead centres"] = defect(
        triple, triple.design({}), "dead centres, grashof, assembled", "branch, circuit, lengths, finite"
    )
    computed["objective off by 1e-5"] = defect(SHIPPED, BEST, "objective", objective=claimed * (1.0 + 1e-5))
    computed["objective off by -1e-5"] = defect(SHIPPED, BEST, "objective", objective=claimed * (1.0 - 1e-5))
    computed["objective of the wrong sign"] = defect(SHIPPED, BEST, "objective", objective=-claimed)
    computed["objective that is no number"] = defect(SHIPPED, BEST, "objective", objective=math.nan)
    computed["objective of another problem"] = defect(LOOSE, LOOSE_DESIGN, "objective", objective=2.0 * loosely)
    for name, law in {
        "law of the wrong sign": "psi0 - 2/(3*pi)*(phi - phi0)^2",
        "law off by a thousandth": "psi0 + 2.002/(3*pi)*(phi - phi0)^2",
        "law measured from the frame": "psi0 + 2/(3*pi)*phi^2",
    }.items():
        computed[name] = defect(problem(None, {"law": law}), BEST, "objective", objective=claimed)
    computed["one point left out"] = defect(problem(None, {"points": 29}), BEST, "objective", objective=claimed)
    # psi0 is 1.75 at the optimum, and 2.19 at the start where the law is first followed
    rootless = problem(None, {"law": "psi0 + 0.1*sqrt(psi0 - 1.9)"})
    computed["law without a value"] = defect(rootless, rootless.design(OPTIMUM), "finite")
    return computed


def span_extremes(rule: DesignProblem, design: Mapping[str, float]) -> tuple[float, float]:
    """Least and largest transmission angle [deg] over the span, by the law of cosines on a dense sweep."""
    crank, coupler, rocker, frame = (design[name] for name in LENGTHS)
    phi = design["phi0"] + rule.span * np.linspace(0.0, 1.0, 20001)
    square = crank**2 + frame**2 - 2.0 * crank * frame * np.cos(phi)
    gamma = np.degrees(np.arccos((coupler**2 + rocker**2 - square) / (2.0 * coupler * rocker)))
    return float(np.min(gamma)), float(np.max(gamma))


@pytest.mark.parametrize("name", list(defects()))
def test_planted_defect_fails_its_check_and_no_other(name):
    case = defects()[name]
    proof = validate(case.rule, case.design, None, case.objective, case.mechanism)
    computed = failed(proof)
    assert not proof.valid
    assert computed >= case.must
    assert computed <= case.must | case.may


def test_every_check_fails_once():
    assert set().union(*(case.must for case in defects().values())) == set(CHECKS.values())


def test_most_defects_fail_one_check_alone():
    alone = {next(iter(case.must)) for case in defects().values() if len(case.must) == 1 and not case.may}
    companions = {"assembled", "circuit", "at rest", "dead centres"}  # these never fail without another
    assert alone >= set(CHECKS.values()) - companions


@pytest.mark.parametrize("name", ["wrong side", "changes its side", "coupler -1 micrometre", "objective off by 1e-5"])
def test_without_the_defect_the_same_design_passes(name):
    case = defects()[name]
    honest = validate(case.rule, case.design).objective
    assert failed(validate(case.rule, case.design, None, honest, case.rule.linkage)) == set()


@pytest.mark.parametrize("values", [(0.1, 0.3, 0.1, 0.3), (0.1, 0.3, 0.2, 0.4), (0.2, 0.2, 0.3, 0.3), (0.3, 0.1, 0.1, 0.3)])
def test_change_point_with_every_limit_fails_without_a_warning(values):
    """Where two modes meet the rocker has no velocity; the validator says so instead of breaking down."""
    rule = problem(lengths(*values), None, {"swing_angle": ["1 deg", "170 deg"], "time_ratio": [1.0, 2.0]})
    proof = validate(rule, rule.design({}), objective=1.0)
    assert not proof.valid
    assert failed(proof) >= {"grashof", "largest"}


def test_design_without_a_start_fails_and_is_no_crash():
    """phi0 and psi0 are NaN where the dead centre does not exist."""
    design = SHIPPED.design({"coupler": 0.2, "rocker": 0.15})
    assert math.isnan(design["phi0"])
    proof = validate(SHIPPED, design, objective=0.1)
    assert failed(proof) >= {"grashof", "assembled", "at rest", "in line", "psi0", "finite", "objective"}
    assert math.isnan(proof.objective)


# --- random designs ------------------------------------------------------------------------------------------------


def transmission(values: list[float]) -> tuple[float, float]:
    crank, coupler, rocker, frame = values
    both = []
    for diagonal in (frame - crank, frame + crank):
        cosine = (coupler**2 + rocker**2 - diagonal**2) / (2.0 * coupler * rocker)
        both.append(math.degrees(math.acos(cosine)) if abs(cosine) <= 1.0 else math.nan)
    return both[0], both[1]


@examples(120)
@given(st.floats(0.05, 0.95), st.floats(0.05, 0.95))
def test_verdict_on_random_designs_is_that_of_the_formulas(coupler, rocker):
    """Textbook formulas decide; the validator, which sweeps, must come to the same verdict."""
    design = SHIPPED.design({"coupler": coupler, "rocker": rocker})
    values = [design[name] for name in LENGTHS]
    kind_of = grashof(*values)
    assume(abs(kind_of.slack) > SHIPPED.limits.length_margin * max(values))
    least, largest = transmission(values)
    assume(not min(abs(least - 45.0), abs(largest - 135.0)) < 1e-4)
    proof = validate(SHIPPED, design)
    computed = failed(proof)
    assert ("bounds" in computed) == (not (0.1 <= coupler <= 0.9 and 0.1 <= rocker <= 0.9))
    assert ("grashof" in computed) == (kind_of.inversion is not Inversion.CRANK_ROCKER)
    if "grashof" not in computed:
        assert computed <= {"bounds", "smallest", "largest"}
        assert ("smallest" in computed) == (least < 45.0)
        assert ("largest" in computed) == (largest > 135.0)
        assert measured(proof, "smallest") == pytest.approx(least, abs=1e-7)
        assert measured(proof, "largest") == pytest.approx(largest, abs=1e-7)
    else:
        assert "assembled" in computed


WIDE = {"transmission_angle": ["20 deg", "160 deg"]}
SAME_VERDICT = {  # problems whose rows and whose validator must draw the same line
    "revolution": problem(None, None, {"transmission_angle": ["45 deg", "135 deg"]}),
    "only a least angle": problem(None, None, {"transmission_angle": {"min": "60 deg"}}),
    "only a largest angle": problem(None, None, {"transmission_angle": {"max": "120 deg"}}),
    "cosine": problem(None, None, {"transmission_angle": None, "transmission_cosine": [-0.5, 0.6]}),
    "only a least cosine": problem(None, None, {"transmission_angle": None, "transmission_cosine": {"min": -0.5}}),
    "over the span": problem(None, {"span": "200 deg"}, {"transmission_over": "span"}),
    "right, clockwise over the span": problem({"assembly": "right"}, {"span": "-150 deg"}, {"transmission_over": "span"}),
    "swing": problem(None, None, {"transmission_angle": None, "swing_angle": ["25 deg", "90 deg"]}),
    "time ratio": problem(None, None, {"transmission_angle": None, "time_ratio": [1.05, 1.4]}),
    "proportions": problem(None, None, {"transmission_angle": None, "link_ratio": [0.1, 0.9]}),
    "span": problem(None, {"from": "50 deg", "span": "100 deg"}, {"crank": "span", **WIDE}),
    "span, clockwise, right": problem(
        {"assembly": "right", "crank": "300 mm"}, {"from": "-40 deg", "span": "-60 deg"}, {"crank": "span", **WIDE}
    ),
    "span from a dead centre": problem({"crank": "300 mm"}, {"span": "60 deg"}, {"crank": "span", **WIDE}),
    "double-crank": problem(
        {"crank": "500 mm", "frame": "200 mm"},
        {"from": "60 deg"},
        {"crank": "double-crank", "transmission_angle": ["20 deg", "160 deg"]},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SAME_VERDICT)
def test_rows_of_the_programme_and_the_validator_draw_the_same_line(name):
    """Two routes to one verdict: the optimiser's rows by formula, the validator's checks by sweep; both verdicts are met."""
    rule = SAME_VERDICT[name]
    rng = np.random.default_rng(21)
    verdicts = []
    for coupler, rocker in rng.uniform(0.1, 0.9, (80, 2)):
        design = rule.design({"coupler": coupler, "rocker": rocker})
        rows = terms.rows(rule, design, rule.reach(design), 0.5)
        spare = float(np.min([[float(row.value) - row.low, row.high - float(row.value)] for row in rows]))
        if abs(spare) < 1e-3:  # on the line itself tolerances decide
            continue
        verdicts.append(spare > 0.0)
        assert validate(rule, design).valid == verdicts[-1], (coupler, rocker, spare)
    assert len(verdicts) > 70
    assert min(verdicts.count(True), verdicts.count(False)) >= 4


def test_random_designs_meet_both_verdicts():
    rng = np.random.default_rng(8)
    verdicts = set()
    for coupler, rocker in rng.uniform(0.1, 0.9, (40, 2)):
        verdicts.add(frozenset(failed(validate(SHIPPED, SHIPPED.design({"coupler": coupler, "rocker": rocker})))))
    assert frozenset() in verdicts
    assert {"largest"} in verdicts
    assert any("grashof" in verdict for verdict in verdicts)
