"""Every shipped problem loads, round-trips, cites its source and reaches what it expects; of machines the power balances.

Linkages that were found for points or poses are judged by `synthesis_oracle`, which has nothing of optlink.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.dynamics import inverse as reactions_module
from optlink.io import data_folder
from optlink.linkage.mechanism import FRAME, Mechanism, Pose
from optlink.problem.file import dump
from optlink.problem.mechanism import FourBarSection
from optlink.problem.targets.expression import parse as parse_expression
from optlink.tasks.analyze import Analysis, analyze
from optlink.units import factor, parse
from tests import synthesis_oracle as oracle
from tests.solved import loaded, solution

NAMES = sorted(optlink.shipped())
LONG = ("function-exp", "function-log10", "function-sin", "crank-rocker-robust")
"""With both back ends they take three to twelve seconds."""
DESIGNS = [name for name in NAMES if loaded(name).task == "function"]
GENERATED = [name for name in NAMES if loaded(name).task == "path"]
POINTED = [name for name in GENERATED if name.startswith(("path-", "motion-"))]
MACHINES = [name for name in NAMES if name not in (*DESIGNS, *GENERATED) and loaded(name).task != "cycle"]


def test_problems_are_found():
    assert "crank-rocker" in DESIGNS
    assert {"six-bar", "shaper"} < set(MACHINES)
    assert {"path-closed18", "path-watt-leg", "motion-5-poses"} < set(POINTED)
    assert data_folder("problems").is_dir()


@pytest.mark.parametrize("name", NAMES)
def test_round_trip(name, tmp_path):
    problem = optlink.load(name)
    copy = tmp_path / "copy.toml"
    copy.write_text(dump(problem), encoding="utf-8")
    again = optlink.load(copy)
    assert again.model == problem.model
    assert again.hash == problem.hash
    assert tomllib.loads(dump(again)) == dict(problem.raw)


@pytest.mark.parametrize("name", NAMES)
def test_source_is_cited(name):
    problem = optlink.load(name).model
    assert len(problem.source) > 20
    assert problem.about
    assert problem.expected is not None
    assert len(problem.expected.source) > 20


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in DESIGNS])
def test_expected_design_is_reached(name):
    problem = optlink.load(name)
    expected = problem.spec.expected
    result = solution(name) if name in LONG[:2] else optlink.solve(problem, "both")
    assert result.valid
    checked = 0
    for quantity in ("crank", "coupler", "rocker", "frame"):
        reference = getattr(expected, quantity)
        if reference is not None:
            assert result.design[quantity] == pytest.approx(reference.value, abs=expected.length_tolerance.value)
            checked += 1
    if expected.objective is not None:
        assert result.objective == pytest.approx(expected.objective, abs=expected.objective_tolerance)
        checked += 1
    assert checked > 0


# --- linkages for points and poses --------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", GENERATED)
def test_best_known_objective_is_reached_or_beaten(name):
    result, expected = solution(name), optlink.load(name).model.expected
    assert result.valid
    assert expected.objective is not None
    assert expected.objective_tolerance <= 2e-6 * expected.objective or expected.objective == 0.0
    assert result.objective <= expected.objective + expected.objective_tolerance
    objectives = [design.objective for design in result.designs]
    assert objectives == pytest.approx(sorted(objectives), rel=1e-7) or expected.objective == 0.0
    for quantity in ("crank", "coupler", "rocker"):
        reference = getattr(expected, quantity)
        if reference is not None:
            assert result.best.values[quantity] == pytest.approx(reference.value, abs=expected.length_tolerance.value)


def judged(design: optlink.LinkageDesign) -> oracle.Report:
    """A four-bar of optlink before the oracle."""
    task, result, data = design.task, design.coupler_linkage, design.task.data
    assert result is not None
    linkage = oracle.four_bar(
        result.frame,
        result.crank,
        result.coupler,
        result.rocker,
        x=result.x,
        y=result.y,
        direction=result.direction,
        along=result.along,
        across=result.across,
        mode=result.side,
    )
    if task.requirement.kind == "path":
        return oracle.judge_path(linkage, data.columns, design.crank_angles, closed=task.closed, timed=data.offsets)
    poses = np.column_stack([data.columns[:, :2], np.arctan2(data.columns[:, 3], data.columns[:, 2])])
    how = {"weight": task.radian, "closed": task.closed, "timed": data.offsets}
    return oracle.judge_motion(linkage, poses, design.crank_angles, design.values["mark"], **how)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in POINTED if isinstance(loaded(name).model.mechanism, FourBarSection)])
def test_four_bars_are_free_of_defects_before_the_oracle(name):
    for design in solution(name).designs:
        report, task = judged(design), design.task
        data, size = task.data, task.size
        assert report.free
        assert report.errors == pytest.approx(design.measured.distances, abs=1e-9 * size)
        angles = report.angle_errors if task.requirement.kind == "motion" else np.zeros(len(report.errors))
        squares = data.roots**2 * (report.errors**2 + (task.radian * angles) ** 2)
        assert float(np.sum(squares)) == pytest.approx(design.objective, rel=1e-6, abs=1e-20 * size**2)
        assert report.timing <= 1e-9
        assert np.all(report.errors <= data.tolerances * (1.0 + 1e-6))
        if data.offsets is None:
            assert report.gain <= 1e-6 * size, "a point could be met more closely at another crank angle"


@cache
def analysed(name: str) -> Analysis:
    return analyze(optlink.load(name))


@pytest.mark.parametrize("name", MACHINES)
def test_expected_figures_are_reached(name):
    """Relative to `figure_tolerance`; absolute where zero is expected."""
    analysis = analysed(name)
    expected = analysis.problem.model.expected
    assert len(expected.figures) >= 8
    for figure, reference in expected.figures.items():
        assert analysis.figures[figure] == pytest.approx(reference, rel=expected.figure_tolerance, abs=1e-9), figure


@pytest.mark.parametrize("name", MACHINES)
def test_machine_runs_without_a_note(name):
    analysis = analysed(name)
    assert analysis.full
    assert analysis.valid
    with_clearance = [joint for joint, section in optlink.load(name).model.joints.items() if section.has_clearance]
    assert len(analysis.notes) == bool(with_clearance)
    assert all(joint in analysis.notes[0] for joint in with_clearance)


@pytest.mark.slow
def test_every_dyad_and_load_is_shipped():
    groups = {group.kind for name in MACHINES for group in analysed(name).machine.mechanism.groups}
    assert groups == {"RRR", "RRP", "RPR", "RPP", "PRP"}
    loads = [load for name in MACHINES for load in optlink.load(name).raw.get("loads", {}).values()]
    for key in ("force", "torque", "between", "torsional_stiffness", "torsional_damping", "damping", "stroke", "direction"):
        assert any(key in load for load in loads), key
    sizes = [load[key] for load in loads for key in ("force", "torque") if key in load]
    assert {"phi", "s"} <= {size["over"] for size in sizes if isinstance(size, dict) and "over" in size}
    assert any(isinstance(size, dict) and "expression" in size for size in sizes)
    assert any("torque" in load and load.get("acts") == "opposing" for load in loads)
    assert any(
        "friction" in guide for name in MACHINES for guide in optlink.load(name).raw["mechanism"].get("guides", {}).values()
    )


# --- the power balance ------------------------------------------------------------------------------------------------------
#
# At every position the drive gives what the kinetic and potential energy gain and what loads and friction take. Here the file is
# read by other code than the package's: of the package are used where the points are (`pose`), the units and the expressions, and
# the normal forces that make friction. Velocities are derivatives of positions by a complex step (exact), the rates of the
# energies are central differences of eighth order. No accelerations, wrenches or joint forces enter.

STEP = 2e-3  # rad: the error of the differences is below 1e-12 of the energies
TINY = 1e-30
EIGHTH = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}


def si(text: object, kind: str) -> float:
    return parse(text, kind)[0]


class Places:
    """Where everything is at crank angles, and its slope per radian of the crank: the real and imaginary part of one value."""

    def __init__(self, mechanism: Mechanism, sizes: Mapping[str, float], phi: np.ndarray) -> None:
        step = phi + 1j * TINY
        self.phi, self.mechanism = phi, mechanism
        self.pose: Pose = mechanism.pose(sizes, (np.cos(step), np.sin(step)))

    def both(self, value: Any) -> np.ndarray:
        full = np.asarray(value) + 0j * self.phi
        return np.array([full.real, full.imag / TINY])

    def turned(self, body: str) -> np.ndarray:
        """Angle of a body; its slope by the cross product of its axis and its slope."""
        if body == FRAME:
            return np.zeros((2, len(self.phi)))
        (x, dx), (y, dy) = (self.both(part) for part in self.pose.direction(body))
        return np.array([np.arctan2(y, x), x * dy - y * dx])

    def on_body(self, body: str, along: float, across: float) -> tuple[np.ndarray, np.ndarray]:
        (x, y), (c, s) = self.pose.point(self.mechanism.bodies[body].start), self.pose.direction(body)
        return self.both(x + along * c - across * s), self.both(y + along * s + across * c)

    def point(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        x, y = self.pose.point(name)
        return self.both(x), self.both(y)

    def slide(self, guide: str) -> np.ndarray:
        return self.both(self.pose.slide(next(g for g in self.mechanism.guides if g.name == guide)))


class Energy:
    """Energies of a machine, and what its loads feed in, from the raw tables of its file."""

    def __init__(self, analysis: Analysis) -> None:
        self.analysis, self.raw = analysis, analysis.problem.raw
        self.machine = analysis.machine
        self.speed = si(self.raw["drive"]["speed"], "angular velocity")
        self.phi = np.radians(analysis["crank_angle_deg"])
        self.gravity = si(self.raw["gravity"], "acceleration") if "gravity" in self.raw else 0.0

    def at(self, phi: np.ndarray) -> Places:
        return Places(self.machine.mechanism, self.machine.sizes, phi)

    def stored(self, phi: np.ndarray) -> np.ndarray:
        """Kinetic and potential energy."""
        places, total = self.at(phi), np.zeros_like(phi)
        for body, own in self.raw["bodies"].items():
            mass, (along, across) = si(own["mass"], "mass"), self.centroid(body, own.get("centroid"))
            (_, vx), (y, vy) = places.on_body(body, along, across)
            moment = self.moment(body, own, mass)
            turning = places.turned(body)[1] * self.speed
            total = total + 0.5 * mass * (vx**2 + vy**2) * self.speed**2 + 0.5 * moment * turning**2 + mass * self.gravity * y
        for load in self.loads():
            if "stiffness" in load:
                stretch = self.between(places, load)[0] - (si(load["free_length"], "length") if "free_length" in load else 0.0)
                total = total + 0.5 * si(load["stiffness"], "stiffness") * stretch**2
            if "torsional_stiffness" in load:
                free = si(load["free_angle"], "angle") if "free_angle" in load else 0.0
                turned = places.turned(load["on"])[0] - places.turned(load.get("against", FRAME))[0] - free
                turned = np.angle(np.exp(1j * turned))
                total = total + 0.5 * si(load["torsional_stiffness"], "torsional stiffness") * turned**2
        return total

    def length(self, body: str) -> float:
        return self.machine.sizes.get(f"{body}.length", self.machine.sizes.get(body, 0.0))  # of a four-bar by its name

    def centroid(self, body: str, stated: object) -> tuple[float, float]:
        if isinstance(stated, list):
            return si(stated[0], "coordinate"), si(stated[1], "coordinate")
        return (0.0 if stated == self.machine.mechanism.bodies[body].start else 0.5 * self.length(body)), 0.0

    def moment(self, body: str, own: Mapping[str, Any], mass: float) -> float:
        if own.get("inertia") == "uniform bar":
            return mass * self.length(body) ** 2 / 12.0
        return si(own["inertia"], "moment of inertia") if "inertia" in own else 0.0

    def loads(self) -> Iterator[Mapping[str, Any]]:
        yield from self.raw.get("loads", {}).values()

    def between(self, places: Places, load: Mapping[str, Any]) -> np.ndarray:
        (px, py), (qx, qy) = (places.point(name) for name in load["between"])
        length = np.hypot(qx[0] - px[0], qy[0] - py[0])
        return np.array([length, ((qx[0] - px[0]) * (qx[1] - px[1]) + (qy[0] - py[0]) * (qy[1] - py[1])) / length])

    def size(self, stated: Any, kind: str, known: Mapping[str, np.ndarray]) -> np.ndarray:
        if not isinstance(stated, dict):
            return np.full_like(self.phi, si(stated, kind))
        if "expression" in stated:
            expression = parse_expression(stated["expression"], known)
            return expression(known) * factor(stated["unit"], kind) + 0.0 * self.phi
        at = [si(cell, {"phi": "angle", "s": "coordinate"}[stated["over"]]) for cell in stated["at"]]
        values = [si(cell, kind) for cell in stated["values"]]
        period = 2 * math.pi if stated["over"] == "phi" else None
        return np.interp(known[stated["over"]], at, values, period=period)

    def motion(self, places: Places, load: Mapping[str, Any]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Velocity of what a force or torque acts on, along it, and what its size may depend on."""
        known = {"phi": places.phi, "omega": np.full_like(places.phi, self.speed)}
        if "torque" in load:
            angle, slope = places.turned(load["on"])
            return slope * self.speed, {**known, "theta": angle, "w": slope * self.speed}
        if "direction" in load:
            link = self.machine.mechanism.bodies[load["on"]]
            angle = si(load["direction"], "angle")
            x, y = places.point(load.get("at", link.start))
            return (math.cos(angle) * x[1] + math.sin(angle) * y[1]) * self.speed, known
        guide = next(name for name, own in self.raw["mechanism"]["guides"].items() if own["slider"] == load["on"])
        assert self.raw["mechanism"]["guides"][guide].get("on", FRAME) == FRAME, "the power along a moving line is another"
        s, slope = places.slide(guide)
        return slope * self.speed, {**known, "s": s, "v": slope * self.speed}

    def fed_in(self) -> np.ndarray:
        """Power of loads that store nothing, and of friction."""
        places, total = self.at(self.phi), np.zeros_like(self.phi)
        for load in self.loads():
            kind = next((kind for kind in ("force", "torque") if kind in load), "")
            if kind:
                velocity, known = self.motion(places, load)
                size = self.size(load[kind], kind, known)
                stroke = load.get("stroke", "both")
                if stroke in ("slow", "fast"):
                    forward = np.count_nonzero(velocity > 0.0) > len(velocity) / 2
                    stroke = "forward" if forward == (stroke == "slow") else "backward"
                if stroke != "both":
                    size = np.where(velocity > 0.0 if stroke == "forward" else velocity < 0.0, size, 0.0)
                total = total + size * (-np.abs(velocity) if load.get("acts") == "opposing" else velocity)
            elif "between" in load:
                rate = self.between(places, load)[1] * self.speed
                total = total - (si(load["damping"], "damping") if "damping" in load else 0.0) * rate**2
            elif "damping" in load:
                guide = next(name for name, own in self.raw["mechanism"]["guides"].items() if own["slider"] == load["on"])
                total = total - si(load["damping"], "damping") * (places.slide(guide)[1] * self.speed) ** 2
            if "torsional_damping" in load:
                rate = (places.turned(load["on"])[1] - places.turned(load.get("against", FRAME))[1]) * self.speed
                total = total - si(load["torsional_damping"], "torsional damping") * rate**2
        for name, guide in self.raw["mechanism"].get("guides", {}).items():
            if "friction" in guide:
                normal = np.abs(self.analysis[f"{name}.normal_N"])
                total = total - guide["friction"] * normal * np.abs(places.slide(name)[1] * self.speed)
        return total

    def gained(self) -> np.ndarray:
        """Rate of the stored energy: central differences of eighth order over the crank angle."""
        slope = sum(
            weight * (self.stored(self.phi + k * STEP) - self.stored(self.phi - k * STEP)) for k, weight in EIGHTH.items()
        )
        return slope / STEP * self.speed

    def imbalance(self, power: np.ndarray) -> float:
        """Largest difference over the largest power that is at work anywhere in the machine."""
        gained, fed = self.gained(), self.fed_in()
        largest = max(float(np.max(np.abs(part))) for part in (power, gained, fed))
        return float(np.max(np.abs(power - (gained - fed)))) / largest


@pytest.mark.parametrize("name", MACHINES)
def test_power_balances(name):
    analysis = analysed(name)
    assert Energy(analysis).imbalance(analysis["input.power_W"]) < 1e-9


def power_of(energy: Energy, problem: optlink.ProblemFile) -> np.ndarray:
    """Power of the drive of another machine at the same positions."""
    torque = reactions_module.reactions(problem.model.machine().moving(energy.phi, energy.speed)).torque
    return np.asarray(torque * energy.speed)


@pytest.mark.parametrize("name", MACHINES)
def test_power_balance_detects_a_mass_error_of_one_in_100000(name):
    energy = Energy(analysed(name))
    problem = energy.analysis.problem
    masses = {f"bodies.{body}.mass": si(own["mass"], "mass") for body, own in problem.raw["bodies"].items()}
    wrong = problem.override({key: f"{mass * (1 + 1e-5)!r} kg" for key, mass in masses.items()})
    assert energy.imbalance(power_of(energy, problem)) < 1e-9
    assert energy.imbalance(power_of(energy, wrong)) > 1e-8


def forgotten_lever(self: Any, body: str, point: Any, force: Any, moment: Any) -> None:
    """What is handed on, without the moment of the force about the start of the body: a fault of a published example."""
    if body != FRAME:
        self.needed[body] = self.needed[body] + reactions_module.Wrench(force, moment)


def without_centripetal(parameters: Any, state: Any, gravity: Any) -> Any:
    return true_wrench(parameters, state._replace(omega=0.0), gravity)


true_wrench = reactions_module.wrench
TURNING_ABOUT_PIVOTS = ("scotch-yoke", "slotted-quick-return")  # with a fixed start the centripetal force does no work


@pytest.mark.parametrize("name", MACHINES)
def test_power_balance_fails_with_a_planted_defect(name, monkeypatch):
    energy = Energy(analysed(name))
    problem = energy.analysis.problem
    with monkeypatch.context() as patch:
        patch.setattr(reactions_module.ForceBalance, "_carry", forgotten_lever)
        assert energy.imbalance(power_of(energy, problem)) > 1e-3
    with monkeypatch.context() as patch:
        patch.setattr(reactions_module, "wrench", without_centripetal)
        computed = energy.imbalance(power_of(energy, problem))
    assert computed < 1e-9 if name in TURNING_ABOUT_PIVOTS else computed > 1e-6


# --- the file as data -------------------------------------------------------------------------------------------------------


def test_hash_changes_with_the_problem_and_not_with_its_words(crank_rocker):
    assert crank_rocker.override({"title": "Another title"}).hash == crank_rocker.hash
    assert crank_rocker.override({"mechanism.frame": "501 mm"}).hash != crank_rocker.hash
    assert crank_rocker.override({"requirement.points": 31}).hash != crank_rocker.hash


def test_none_removes_a_key(crank_rocker):
    without = crank_rocker.override({"limits.transmission_angle": None})
    assert without.spec.limits.transmission_angle is None
    assert "transmission_angle" not in tomllib.loads(dump(without))["limits"]


def test_expected_values_are_dropped_when_the_problem_changes(crank_rocker):
    assert crank_rocker.spec.expected is not None
    assert crank_rocker.override({"mechanism.frame": "501 mm"}).spec.expected is None
    assert crank_rocker.override({"title": "Another title"}).spec.expected is not None
