"""Designs of any requirement and any linkage, validated many at once; the largest error of a law over its whole range."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.linkage.dyads import RRP, RRR, rrr
from optlink.linkage.fourbar import LENGTHS, whole_four_bar
from optlink.linkage.jet import Jet
from optlink.linkage.mechanism import Link, Mechanism, Pose
from optlink.linkage.vector2d import Value
from optlink.problem.design import DesignProblem
from optlink.problem.requirements.laws import DEAD_CENTRES
from optlink.validation import validate, validate_batch
from optlink.validation.motion import FourBarMotion, LinkageMotion, motion_of

COUNT = 12


def model_of(name: str, **changes: Any) -> DesignProblem:
    """A shipped problem with definite assembly modes."""
    file = optlink.load(name, changes)
    model = file.variants()[0].model
    assert isinstance(model, DesignProblem)
    return model


def random_designs(problem: DesignProblem, seed: int) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Designs about the start of a file, near and far, with a value missing in the last one, and crank angles of free timing."""
    rng = np.random.default_rng(seed)
    spread = np.array([1e-6, 0.02, 0.4])[np.arange(COUNT) % 3]
    free = {name: q.value * (1.0 + spread * rng.uniform(-1.0, 1.0, COUNT)) for name, q in problem.quantities.items() if q.free}
    free[problem.free[0]][-1] = math.nan
    designs = {name: np.broadcast_to(value, COUNT) for name, value in problem.complete(free).items()}
    if problem.data.offsets is not None:
        return designs, None
    points = len(problem.data.columns)
    begin, span = rng.uniform(-3.0, 3.0, (COUNT, 1)), rng.uniform(3.0, 6.2, (COUNT, 1)) * rng.choice([-1.0, 1.0], (COUNT, 1))
    return designs, begin + span * np.sort(rng.uniform(0.0, 1.0, (COUNT, points)), axis=1)


CASES: dict[str, dict[str, Any]] = {
    "path-bean": {},
    "path-bean over the points": {"limits.crank": "span"},
    "path-closed18": {},
    "path-stephenson-dwell": {},
    "path-scott-russell": {},
    "motion-3-poses-region": {},
    "transmission-optimal": {},
    "law-six-bar": {},
    "law-slider-crank": {},
    "path-watt-leg": {},
}


@pytest.mark.parametrize("name", CASES)
def test_a_batch_validates_each_design_as_a_single_one(name: str) -> None:
    problem = model_of(name.split()[0], **CASES[name])
    designs, angles = random_designs(problem, 3)
    batch = validate_batch(problem, designs, angles, np.full(COUNT, 0.5))
    verdicts = set()
    for k in range(COUNT):
        one = {key: float(values[k]) for key, values in designs.items()}
        single = validate(problem, one, None if angles is None else angles[k], 0.5)
        assert repr(batch.of(k).checks) == repr(single.checks)
        assert repr(batch.of(k).objective) == repr(single.objective)
        assert batch.valid[k] == single.valid
        verdicts.add(single.failed)
    assert len(verdicts) > 1
    assert not batch.valid[-1]


# --- two records of the same four-bars ---------------------------------------------------------------------------------------


def four_bar_files(lengths: dict[str, float], requirement: dict[str, Any], limits: dict[str, Any]) -> list[DesignProblem]:
    """The same requirement of the same four-bar [mm], by its lengths and as dyads."""
    sizes = {name: {"start": f"{value!r} mm", "bounds": ["1 mm", "900 mm"]} for name, value in lengths.items()}
    joints = {"crank": ["A", "B"], "coupler": ["B", "C"], "rocker": ["D", "C"]}
    dyads = {
        "ground": {"A": ["0 mm", "0 mm"], "D": [sizes["frame"], "0 mm"]},
        "links": {name: {"joints": pair, "length": sizes[name]} for name, pair in joints.items()},
        "assembly": {"C": "left of B-D"},
    }
    base = {"requirement": {"kind": "function", "output": "rocker", **requirement}, "limits": limits}
    mechanisms = {"type": "four-bar", **sizes, "assembly": "left"}, {"type": "dyads", **dyads}
    return [DesignProblem.model_validate({"title": "four-bar", **base, "mechanism": mechanism}) for mechanism in mechanisms]


CRANK_ROCKER = {"crank": 35.0, "coupler": 90.0, "rocker": 80.0, "frame": 100.0}
LAW = {"law": "psi0 + 0.2*(phi - phi0)^2", "span": "90 deg", "start": "40 deg", "psi0": "80 deg"}


@pytest.mark.parametrize("limits", [{"transmission_angle": ["30 deg", "150 deg"]}, {"crank": "span"}])
@pytest.mark.parametrize("measure", ["sum of squares", "rms", "max"])
def test_a_four_bar_has_the_same_figures_however_it_is_written(limits: dict[str, Any], measure: str) -> None:
    section, dyads = four_bar_files(CRANK_ROCKER, {**LAW, "measure": measure}, limits)
    assert whole_four_bar(dyads.linkage) is not None
    proofs = [validate(problem, problem.design({})) for problem in (section, dyads)]
    figures = [{c.name: c.value for c in p.checks if not c.name.endswith("bounds")} for p in proofs]
    assert set(figures[0]) == set(figures[1])
    assert all(figures[0][name] == pytest.approx(value, rel=1e-12, abs=1e-13) for name, value in figures[1].items())
    assert proofs[0].objective == pytest.approx(proofs[1].objective, rel=1e-13)
    assert all(proof.valid for proof in proofs)


@pytest.mark.parametrize("start", ["outer dead centre", "inner dead centre"])
def test_a_four_bar_of_dyads_starts_at_its_dead_centre(start: str) -> None:
    requirement = {"law": LAW["law"], "span": LAW["span"], "start": start, "psi0": "output at the start"}
    section, dyads = four_bar_files(CRANK_ROCKER, requirement, {})
    designs = [problem.design({}) for problem in (section, dyads)]
    proofs = [validate(problem, design) for problem, design in zip((section, dyads), designs, strict=True)]
    names = {"rocker at rest at its dead centre", "crank and coupler in line there"}
    names |= {"inner dead centre: C apart from A"} if start.startswith("inner") else set()
    for proof, own in zip(proofs, ("psi0 is the rocker angle at phi0", "zero is the rocker angle at start"), strict=True):
        assert proof.valid, proof.failed
        assert names | {own} <= {check.name for check in proof.checks}
    assert proofs[0].objective == pytest.approx(proofs[1].objective, rel=1e-12)
    moved = validate(dyads, {**designs[1], "start": designs[1]["start"] + 1e-3})
    assert moved.failed[0] == "rocker at rest at its dead centre"
    turned = validate(dyads, {**designs[1], "zero": designs[1]["zero"] + 1e-6})
    assert turned.failed == ("zero is the rocker angle at start",)
    other = next(name for name in DEAD_CENTRES if name != start)
    there = four_bar_files(CRANK_ROCKER, {**requirement, "start": other}, {})[1].design({})
    assert validate(dyads, there).failed == ("crank and coupler in line there",)


@pytest.mark.parametrize("closed", [True, False])
def test_the_two_records_of_a_four_bar_agree(closed: bool) -> None:
    section = four_bar_files(CRANK_ROCKER, LAW, {})[0]
    rng = np.random.default_rng(2)
    sizes = {name: 1e-3 * rng.uniform(0.9, 1.1, (20, 1)) * CRANK_ROCKER[name] for name in LENGTHS}
    begin, span = rng.uniform(-3.0, 3.0, (20, 1)), rng.uniform(1.0, 5.0, (20, 1))
    angles = np.linspace(0.0, math.tau, 1440, endpoint=False) if closed else begin + np.linspace(0.0, 1.0, 1441) * span
    more: dict[str, Any] = {"closed": closed} if closed else {"span": span}
    fast = motion_of(section.linkage, section.linkage, sizes, angles, 0.1, **more)
    plain = LinkageMotion(section.linkage, section.linkage, sizes, angles, 0.1, **more)
    assert isinstance(fast, FourBarMotion)
    np.testing.assert_allclose(fast.least_height, plain.least_height, rtol=1e-12)
    np.testing.assert_allclose(fast.least_squared_sines, plain.least_squared_sines, rtol=1e-11)
    np.testing.assert_allclose(fast.transmission_extremes, plain.transmission_extremes, rtol=1e-12)
    assert np.all(np.abs(fast.link_lengths(0.1).value) < 1e-12)
    assert np.all(np.abs(plain.link_lengths(0.1).value) < 1e-12)
    assert np.all((fast.largest_jump > 0.1) & (fast.largest_jump < 1.0))
    assert np.all((plain.largest_jump > 0.1) & (plain.largest_jump < 1.0))


# --- planted defects of a six-bar ---------------------------------------------------------------------------------------------

SIX_BAR = {
    **{"A.x": 0.0, "A.y": 0.0, "D.x": 0.4, "D.y": 0.0, "G.direction": 0.0, "G.offset": 0.3249547566904335},
    **{"crank.length": 0.1041702654882727, "coupler.length": 0.32435323673868566, "rocker.length": 0.21057291600557762},
    **{"rod.length": 0.319896579371856, "start": -2.6119822493138285, "zero": -0.009061372863618352},
}


@dataclass(frozen=True)
class Flipping(RRR):
    """A group that changes its assembly mode while the crank passes the frame line, as a linkage after a collision would."""

    def solve(self, pose: Pose) -> Value:
        """Place C on the side on which B is."""
        height, lengths = pose.points["B"][1], [pose.sizes[f"{name}.length"] for name in ("coupler", "rocker")]
        side = np.where((height.value if isinstance(height, Jet) else height) > 0.0, 1, -1)
        pose.points["C"], margin = rrr(pose.points["B"], pose.points["D"], *lengths, side)
        pose.fit(self.first, "B", "C")
        pose.fit(self.second, "D", "C")
        return margin


def six_bar_defects(honest: Mechanism) -> dict[str, tuple[Mechanism, set[str]]]:
    """Mechanisms with a defect, and the checks that must fail, by parts of their names."""

    def stretched(body: str) -> Mechanism:
        def link(old: Link) -> Link:
            return replace(old, length=SIX_BAR[f"{body}.length"] + 1e-6) if old.body == body else old

        groups = tuple(replace(group, first=link(group.first), second=link(group.second)) for group in honest.groups)
        return replace(honest, crank=link(honest.crank), groups=groups)

    first, second = honest.groups
    assert isinstance(first, RRR)
    assert isinstance(second, RRP)
    defects = {body: (stretched(body), {"link lengths", "objective"}) for body in ("crank", "coupler", "rocker", "rod")}
    defects["wrong side of C"] = replace(honest, groups=(replace(first, side=-1), second)), {"one branch", "objective"}
    defects["changing side of C"] = replace(honest, groups=(Flipping(**vars(first)), second)), {"one branch", "one circuit"}
    defects["slider backward"] = replace(honest, groups=(first, replace(second, side=-1))), {"objective"}
    return defects


def test_the_six_bar_is_valid_and_each_planted_defect_fails_its_check() -> None:
    problem = model_of("law-six-bar")
    proof = validate(problem, SIX_BAR, objective=1.5290696988306757e-3)
    assert proof.valid, proof.failed
    for mechanism, must in six_bar_defects(problem.linkage).values():
        proof = validate(problem, SIX_BAR, None, 1.5290696988306757e-3, mechanism)
        assert all(any(name.startswith(word) for name in proof.failed) for word in must), (must, proof.failed)
        if "one branch" not in must:  # with C on its other side the rod is too short
            assert all(name.startswith((*must, "smallest transmission", "largest transmission")) for name in proof.failed)


@pytest.mark.parametrize(
    ("changes", "must"),
    [
        ({"rod.length": 0.22}, {"E off alignment", "link lengths", "output error"}),
        ({"rocker.length": 0.14}, {"rocker.length within its bounds"}),
        ({"G.direction": 1e-6}, {"G.direction within its bounds", "objective"}),
        ({"start": -2.6}, {"objective"}),
        ({"coupler.length": 0.3243}, {"largest transmission angle at C", "objective"}),
    ],
)
def test_a_wrong_size_of_the_six_bar_fails_its_check(changes: dict[str, float], must: set[str]) -> None:
    proof = validate(model_of("law-six-bar"), {**SIX_BAR, **changes}, objective=1.5290696988306757e-3)
    assert all(any(name.startswith(word) for name in proof.failed) for word in must), (must, proof.failed)


# --- the largest error over the whole range ----------------------------------------------------------------------------------


def rocker(lengths: dict[str, float], crank: np.ndarray) -> np.ndarray:
    """Angle of the rocker [rad], C to the left of B-D, by complex numbers and the cosine rule."""
    z = lengths["frame"] - lengths["crank"] * np.exp(1j * crank)  # from B to D
    a, b = lengths["coupler"], lengths["rocker"]
    to_c = a * np.exp(1j * (np.angle(z) + np.arccos((a * a + np.abs(z) ** 2 - b * b) / (2.0 * a * np.abs(z)))))
    return np.angle(to_c - z)


@pytest.mark.parametrize("law", ["psi0 + 0.2*(phi - phi0)^2", "psi0 + 0.3*sin(phi - phi0)", "log10"])
def test_the_largest_error_of_a_formula_is_that_over_its_whole_range(law: str) -> None:
    """At six positions it is less; by 200,001 positions of the loop closed independently."""
    requirement: dict[str, Any] = {**LAW, "law": law, "measure": "max", "points": 5}
    if law == "log10":
        requirement["law"] = {"function": "log10(x)", "x": [1, 2], "input": "90 deg", "output": "30 deg"}
        del requirement["span"]
    at = np.linspace(0.0, math.pi / 2.0, 200_001)
    wanted = {
        "log10": np.log10(1.0 + at / at[-1]) / math.log10(2.0) * math.pi / 6.0,
        "psi0 + 0.2*(phi - phi0)^2": 0.2 * at**2,
    }.get(law, 0.3 * np.sin(at))
    error = rocker(CRANK_ROCKER, math.radians(40.0) + at) - wanted
    base = 0.5 * (error[0] + error[-1])  # so that the largest error does not lie at an end
    requirement["psi0"] = f"{math.degrees(base)!r} deg"
    error -= base
    expected, at_positions = np.max(np.abs(error)), np.max(np.abs(error[::40_000]))
    assert expected > 1.0001 * at_positions
    for problem in four_bar_files(CRANK_ROCKER, requirement, {}):
        design = problem.design({})
        assert validate(problem, design).objective == pytest.approx(expected, rel=1e-9)
        designs = {name: value * (1.0 + 1e-3 * np.arange(5)) for name, value in design.items()}
        batch = validate_batch(problem, designs).objective
        single = [validate(problem, {name: float(v[k]) for name, v in designs.items()}).objective for k in range(5)]
        assert batch.tolist() == single


def test_the_largest_slide_error_is_that_over_its_whole_range() -> None:
    """A slider-crank, by its own formula."""
    raw = {
        "mechanism": {
            "ground": {"A": ["0 mm", "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": {"start": "40 mm", "bounds": ["10 mm", "80 mm"]}},
                "rod": {"joints": ["B", "C"], "length": "150 mm"},
                "slider": {"joints": ["C"]},
            },
            "guides": {"G": {"slider": "slider", "through": ["0 mm", "10 mm"]}},
            "assembly": {"C": "forward"},
        },
        "requirement": {
            "kind": "function",
            "output": "G",
            "law": {"slide": "s0 - 40*(1 - cos(phi - phi0))", "unit": "mm"},
            "span": "120 deg",
            "start": "10 deg",
            "zero": "186 mm",
            "points": 3,
            "measure": "max",
        },
    }
    problem = optlink.read(raw).model
    assert isinstance(problem, DesignProblem)
    at = np.linspace(0.0, math.radians(120.0), 200_001)
    phi = math.radians(10.0) + at
    slide = 40.0 * np.cos(phi) + np.sqrt(150.0**2 - (40.0 * np.sin(phi) - 10.0) ** 2)
    error = np.abs(slide - 186.0 + 40.0 * (1.0 - np.cos(at)))
    design = problem.design({})
    assert np.max(error) > 1.001 * np.max(error[::66_666])  # at the positions
    assert 1e3 * validate(problem, design).objective == pytest.approx(np.max(error), rel=1e-9)
