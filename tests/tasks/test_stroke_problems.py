"""Stroke problems, judged by the dead-centre synthesis of textbooks: closed forms and searches along one-parameter families."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import optlink
from optlink.errors import InputError
from optlink.validation import validate
from optlink.validation.cycle import Cycle
from optlink.validation.motion import motion_of

Raw = dict[str, object]


def crank_rocker(swing: float, turned: float, ratio: float) -> tuple[float, float, float]:
    """Crank, coupler and rocker on a frame of 1, from the loop equations of both dead centres in complex numbers.

    `swing` of the rocker while the crank turns by `turned` [rad]; `ratio` of coupler to crank. (Freudenstein, Primrose: The
    classical transmission angle problem, IMechE Conference on Mechanisms, 1973.)
    """
    left = np.array([[1.0 + ratio, -1.0], [(1.0 - ratio) * np.exp(1j * turned), -np.exp(1j * swing)]])
    crank, rocker = np.abs(np.linalg.solve(left, np.ones(2)))
    return float(crank), float(ratio * crank), float(rocker)


def worst_cosine(crank: float, coupler: float, rocker: float) -> float:
    """Largest cosine of the transmission angle of a crank-rocker, at crank angles of 0 and 180 deg."""
    square = coupler**2 + rocker**2
    return max(abs(square - (1.0 + way * crank) ** 2) / (2.0 * coupler * rocker) for way in (-1.0, 1.0))


def slider_crank(stroke: float, time_ratio: float, angle: float) -> tuple[float, float, float]:
    """Crank, rod and offset: the crank pivot lies where the stroke is seen at the angle that the time ratio prescribes.

    `angle` [rad] of the pivot on this circle.
    """
    seen = math.pi * (time_ratio - 1.0) / (time_ratio + 1.0)
    radius = stroke / (2.0 * math.sin(seen))
    x, y = radius * math.cos(angle), radius * (math.sin(angle) - math.cos(seen))
    far, near = math.hypot(x + 0.5 * stroke, y), math.hypot(x - 0.5 * stroke, y)
    return 0.5 * abs(far - near), 0.5 * (far + near), abs(y)


def sine_of_pressure(sizes: tuple[float, float, float]) -> float:
    """Sine of the largest pressure angle of an offset slider-crank."""
    crank, rod, offset = sizes
    return (crank + offset) / rod


def least(function: Callable[[float], float], low: float, high: float) -> float:
    """The place of the least value by golden section."""
    return float(minimize_scalar(function, bounds=(low, high), method="bounded", options={"xatol": 1e-13}).x)


SEEN = math.pi / 11.0
SLIDER, BEST = optlink.load("stroke-slider-crank"), least(lambda a: sine_of_pressure(slider_crank(100.0, 1.2, a)), 2.2, 2.4)
ROCKER = optlink.load("stroke-crank-rocker")


@pytest.mark.parametrize("backend", ["ipopt", pytest.param("slsqp", marks=pytest.mark.slow)])
def test_slider_crank_is_the_best_of_its_family(backend: str) -> None:
    result = optlink.solve(SLIDER, backend)
    sizes = slider_crank(100.0, 1.2, BEST)
    assert result.valid
    assert result.objective == pytest.approx(math.asin(sine_of_pressure(sizes)), abs=1e-10)
    assert result.objective == pytest.approx(SLIDER.model.expected.objective, abs=SLIDER.model.expected.objective_tolerance)
    assert [1e3 * result.design[name] for name in result.problem.model.free] == pytest.approx(sizes, abs=1e-3)
    assert result.fit is not None
    assert result.fit.grade == "good"


@pytest.mark.parametrize("backend", ["ipopt", pytest.param("slsqp", marks=pytest.mark.slow)])
def test_crank_rocker_is_the_best_of_its_family(backend: str) -> None:
    result = optlink.solve(ROCKER, backend)
    turned, swing, expected = math.radians(200.0), math.radians(50.0), ROCKER.model.expected
    ratio = least(lambda r: worst_cosine(*crank_rocker(swing, turned, r)), 1.5, 4.0)
    sizes = crank_rocker(swing, turned, ratio)
    assert result.valid
    assert result.objective == pytest.approx(math.asin(worst_cosine(*sizes)), abs=1e-10)
    assert result.objective == pytest.approx(expected.objective, abs=expected.objective_tolerance)
    for name, size in zip(("crank", "coupler", "rocker"), sizes, strict=True):
        assert 1e3 * result.design[name] == pytest.approx(100.0 * size, abs=1e-4)
        assert result.design[name] == pytest.approx(getattr(expected, name).value, abs=expected.length_tolerance.value)


@pytest.mark.slow
def test_crank_rocker_without_quick_return() -> None:
    """Closed form for equal strokes: Brodell and Soni, Journal of Mechanisms 5 (1970)."""
    swing, angle = math.radians(60.0), math.radians(50.0)
    coupler = math.sqrt((1.0 - math.cos(swing)) / (2.0 * math.cos(angle) ** 2))
    rocker = math.sqrt((1.0 - coupler**2) / (1.0 - coupler**2 * math.cos(angle) ** 2))
    crank = math.sqrt(coupler**2 + rocker**2 - 1.0)
    changes = {"mechanism.rocker": f"{100.0 * rocker!r} mm", "requirement.stroke": "60 deg", "requirement.time_ratio": 1.0}
    result = optlink.solve(ROCKER.override(changes))
    assert result.valid
    assert 100.0 * crank == pytest.approx(1e3 * result.design["crank"], abs=1e-5)
    assert 100.0 * coupler == pytest.approx(1e3 * result.design["coupler"], abs=1e-5)
    assert result.objective == pytest.approx(0.5 * math.pi - angle, abs=1e-7)


@pytest.mark.slow
def test_smallest_slider_crank_within_a_pressure_angle() -> None:
    """Along the family the pressure angle falls as the links grow: the smallest ones are at its limit of 50 deg."""
    changes = {"objective.quantity": "total length", "limits.pressure_angle": "50 deg"}
    result = optlink.solve(SLIDER.override(changes))

    def excess(angle: float) -> float:
        return abs(sine_of_pressure(slider_crank(100.0, 1.2, angle)) - math.sin(math.radians(50.0)))

    crank, rod, _ = slider_crank(100.0, 1.2, least(excess, 0.5 * math.pi + SEEN + 0.01, BEST))
    assert result.valid
    assert 1e3 * result.objective == pytest.approx(crank + rod, rel=1e-6)


@pytest.mark.slow
def test_conflict_lists_the_required_relaxations() -> None:
    """The pressure angle to the best one of this time ratio, or the time ratio to that with a best pressure angle of 30 deg."""
    result = optlink.solve(SLIDER.override({"limits.pressure_angle": "30 deg"}))
    assert not result.valid
    relaxed = {one.key: one.relaxed for one in result.conflict}
    best = math.degrees(math.asin(sine_of_pressure(slider_crank(100.0, 1.2, BEST))))
    assert relaxed["limits.pressure_angle"] == pytest.approx(best, abs=1e-4)
    ratio = relaxed["requirement.time_ratio"]

    def sine(angle: float) -> float:
        return sine_of_pressure(slider_crank(100.0, ratio, angle))

    first = 0.5 * math.pi + math.pi * (ratio - 1.0) / (ratio + 1.0)  # there the pivot lies at the end of the stroke
    assert math.degrees(math.asin(sine(least(sine, first + 0.01, math.pi)))) == pytest.approx(30.0, abs=1e-3)


def test_planted_defects_fail_their_checks() -> None:
    crank, rod, offset = (1e-3 * size for size in slider_crank(100.0, 1.2, BEST))
    good = {"crank.length": crank, "rod.length": rod, "G.offset": offset}
    file = SLIDER.override({"limits.transmission_angle": ["47.2 deg", "132.8 deg"]})
    assert optlink.validate(file, good).valid
    for change, words in (({"crank.length": crank + 1e-6}, "stroke"), ({"G.offset": offset + 1e-5}, "time ratio")):
        failed = [check.name for check in optlink.validate(file, good | change).validation.checks if not check.passed]
        assert any(words in name for name in failed)
    tight = optlink.validate(SLIDER.override({"limits.transmission_angle": ["47.202 deg", "132.8 deg"]}), good)
    assert [check.name for check in tight.validation.checks if not check.passed] == [
        "transmission_angle.C.min: least transmission angle at C"
    ]


def test_limits_of_the_transmission_angle_of_a_machine() -> None:
    """Every cycle problem takes them: of all dyads, or by joint."""
    changes = {"limits.pressure_angle": "60 deg", "limits.transmission_angle": {"E": ["40 deg", "140 deg"]}}
    model = optlink.load("press-toggle", changes).model
    computed = [(bound.key, bound.term.words) for bound in model.bounds if "angle" in bound.key and "rod" not in bound.key]
    assert computed == [
        ("limits.pressure_angle", "peak pressure angle at C"),
        ("limits.transmission_angle.E", "least transmission angle at E"),
        ("limits.transmission_angle.E", "largest transmission angle at E"),
    ]


@pytest.mark.parametrize("stroke", ["179 deg", "30..370 deg", "<= 200 deg", "0..60 deg"])
def test_possible_strokes_are_read(stroke: str) -> None:
    assert optlink.load("stroke-crank-rocker", {"requirement.stroke": stroke}).model.bounds  # type: ignore[attr-defined]


def test_other_bodies_may_swing_further() -> None:
    changes = {"requirement.output": "coupler", "requirement.stroke": "200 deg"}
    assert optlink.load("stroke-crank-rocker", changes).model.bounds  # type: ignore[attr-defined]


# --- limits that every design meets, or that depend on one another -----------------------------------------------------------


def free_length(low: float, high: float) -> Raw:
    """A free length between two bounds [mm]."""
    return {"bounds": [f"{low!r} mm", f"{high!r} mm"]}


def in_line(crank: float, rod: tuple[float, float], ratio: bool) -> optlink.ProblemFile:
    """A slider-crank whose stroke, and time ratio, the free rod does not change."""
    changes: Raw = {
        "mechanism.links.crank.length": f"{crank!r} mm",
        "mechanism.links.rod.length": free_length(*rod),
        "mechanism.guides.G.offset": "0 mm",
        "requirement.stroke": f"{2.0 * crank!r} mm",
        "requirement.time_ratio": 1.0 if ratio else None,
    }
    return SLIDER.override(changes)


def drag_link(drag: float, rod: float, bounds: dict[str, tuple[float, float]], ratio: float | None) -> optlink.ProblemFile:
    """A double-crank whose second crank drives a slider: its stroke is twice that crank."""
    raw: Raw = {
        "title": "Drag-link",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 mm", "0 mm"], "D": [free_length(*bounds["D"]), "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": free_length(*bounds["crank"])},
                "coupler": {"joints": ["B", "C"], "length": free_length(*bounds["coupler"])},
                "drag": {"joints": ["D", "C"], "length": f"{drag!r} mm"},
                "rod": {"joints": ["C", "E"], "length": f"{rod!r} mm"},
                "ram": {"joints": ["E"]},
            },
            "guides": {"G": {"slider": "ram", "through": "D", "direction": {"bounds": ["-180 deg", "180 deg"]}}},
            "assembly": {"C": "left of B-D", "E": "forward"},
        },
        "requirement": {"kind": "stroke", "output": "ram", "stroke": f"{2.0 * drag!r} mm"},
    }
    return optlink.read(raw).override({} if ratio is None else {"requirement.time_ratio": ratio})


def drag_link_angles(drag: float, rod: float, frame: np.ndarray, crank: np.ndarray, coupler: np.ndarray) -> np.ndarray:
    """Worst pressure angle [rad] of double-cranks with a rod on the second crank; infinite for other linkages."""
    lengths = np.sort(np.stack(np.broadcast_arrays(frame, crank, coupler, drag)), axis=0)
    turning = (lengths[0] + lengths[3] < lengths[1] + lengths[2] - 0.05) & (frame == lengths[0])
    cosines = [(coupler**2 + drag**2 - (crank + way * frame) ** 2) / (2.0 * coupler * drag) for way in (-1.0, 1.0)]
    worst = np.maximum(np.max(np.abs(cosines), axis=0), drag / rod)
    return np.where(turning & (worst < 0.999), np.arcsin(np.minimum(worst, 1.0)), np.inf)


def time_ratios(drag: float, frame: float, crank: float, coupler: float) -> tuple[float, float]:
    """Least and largest share of the crank's revolution in which the second crank makes half a turn, over all half turns."""
    angles = np.linspace(0.0, math.tau, 721)
    pin = crank * np.exp(1j * angles)
    line = frame - pin
    along = (coupler**2 - drag**2 + np.abs(line) ** 2) / (2.0 * np.abs(line))
    turned = np.unwrap(np.angle(pin + line / np.abs(line) * (along + 1j * np.sqrt(coupler**2 - along**2)) - frame))
    turned = turned if turned[-1] > turned[0] else -turned
    begin = np.linspace(turned[0], turned[-1], 181)
    twice = np.r_[turned, turned[1:] + math.tau], np.r_[angles, angles[1:] + math.tau]
    shares = (np.interp(begin + math.pi, *twice) - np.interp(begin, *twice)) / math.tau
    return float(np.min(shares)), float(np.max(shares))


def best_drag_link(drag: float, rod: float, bounds: dict[str, tuple[float, float]], ratio: float | None) -> float:
    """Least worst pressure angle [rad] on a grid of the lengths; the direction of the guide serves the time ratio alone."""
    count = 41 if ratio is None else 17
    axes = [np.linspace(*bounds[name], count) for name in ("D", "crank", "coupler")]
    frame, crank, coupler = np.meshgrid(*axes, indexing="ij")
    worst = drag_link_angles(drag, rod, frame, crank, coupler).ravel()
    for k in np.argsort(worst).tolist():
        if ratio is None or not math.isfinite(worst[k]):
            return float(worst[k])
        most = time_ratios(drag, *(float(values.ravel()[k]) for values in (frame, crank, coupler)))[1]
        if most > ratio / (1.0 + ratio) + 1e-4:
            return float(worst[k])
    return math.inf


def best_crank_rocker(swing: float, ratio: float) -> tuple[float, float, float]:
    """Crank, coupler and rocker on a frame of 1 for a swing [rad] and a time ratio, with the best transmission angle."""
    turned = math.tau * ratio / (1.0 + ratio)
    return crank_rocker(swing, turned, least(lambda share: worst_cosine(*crank_rocker(swing, turned, share)), 1.2, 6.0))


@pytest.mark.slow
def test_a_stroke_without_gradient_does_not_stop_the_search() -> None:
    result = optlink.solve(in_line(42.5, (110.0, 287.0), True))
    assert result.valid
    assert result.objective == pytest.approx(math.asin(42.5 / 287.0), abs=1e-9)
    assert {limit.name: limit.multiplier for limit in result.solution.limits if limit.sense == "="} == {
        "stroke of slider": math.inf,
        "time ratio of slider": math.inf,
    }


@pytest.mark.slow
def test_drag_link_for_a_time_ratio() -> None:
    """Its stroke is that of every double-crank: the search stalled at 69 deg. With 99 to 101 mm it found this optimum."""
    bounds = {"D": (10.0, 60.0), "crank": (40.0, 120.0), "coupler": (40.0, 120.0)}
    result = optlink.solve(drag_link(50.0, 200.0, bounds, 1.4))
    assert result.valid
    assert math.degrees(result.objective) == pytest.approx(17.0012, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("block", range(5))
def test_dependent_limits_never_stop_a_search(block: int) -> None:
    """50 problems: sliders in line, drag-links, and rockers whose swing is stated twice, against closed forms and grids."""
    random = np.random.default_rng(620 + block)
    for k in range(10):
        if k < 3:
            crank, low = (float(random.uniform(*pair)) for pair in ((20.0, 60.0), (80.0, 150.0)))
            high = low + float(random.uniform(20.0, 200.0))
            result, least_angle = optlink.solve(in_line(crank, (low, high), bool(random.integers(2)))), math.asin(crank / high)
            assert result.valid
            assert result.objective == pytest.approx(least_angle, abs=1e-9)
        elif k < 7:
            drag, rod = float(random.uniform(40.0, 80.0)), float(random.uniform(180.0, 300.0))
            bounds = {"D": (float(random.uniform(8.0, 14.0)), 30.0), "crank": (45.0, 110.0), "coupler": (45.0, 110.0)}
            ratio = None if k < 6 else float(random.uniform(1.15, 1.5))
            result = optlink.solve(drag_link(drag, rod, bounds, ratio))
            least_angle = best_drag_link(drag, rod, bounds, ratio)
            assert result.valid or least_angle == math.inf
            lengths = [1e3 * result.design[name] for name in ("D.x", "crank.length", "coupler.length")]
            own = float(drag_link_angles(drag, rod, *map(np.array, lengths)))
            assert own == math.inf or result.objective == pytest.approx(own, abs=1e-7)
            assert result.objective <= least_angle + 1e-6
        else:
            swing, ratio = float(random.uniform(30.0, 70.0)), float(random.uniform(1.05, 1.25))
            twice = {"quantity": "stroke", "of": "rocker", "exactly": f"{swing!r} deg"}
            changes = {"requirement.stroke": f"{swing!r} deg", "requirement.time_ratio": ratio, "limits.again": twice}
            result, sizes = optlink.solve(ROCKER.override(changes)), best_crank_rocker(math.radians(swing), ratio)
            inside = 5.0 < 100.0 * sizes[0] < 90.0 and all(20.0 < 100.0 * size < 200.0 for size in sizes[1:])
            assert result.valid or not inside
            assert not inside or result.objective <= math.asin(worst_cosine(*sizes)) + 1e-7


def listed(problem: optlink.ProblemFile, *others: Raw) -> optlink.ProblemFile:
    """The problem with its requirement in a list, before others."""
    raw = {key: value for key, value in problem.raw.items() if key != "requirement"}
    return problem.with_tables({**raw, "requirements": [problem.raw["requirement"], *others]})


def test_a_stroke_in_a_list_is_the_same_demand() -> None:
    """Alone in it, it has the same bounds under its name; two strokes of one machine are two demands."""
    alone, one = SLIDER.spec, listed(SLIDER).spec
    assert one.task == "cycle"
    assert not one.parts
    assert [(bound.term, bound.interval) for bound in one.bounds] == [(bound.term, bound.interval) for bound in alone.bounds]
    assert [bound.key for bound in one.required] == ["requirements.0.stroke", "requirements.0.time_ratio"]
    swing = {"kind": "stroke", "output": "rod", "stroke": "10..60 deg"}
    two = listed(SLIDER, {**swing, "name": "rod_swing"}).spec
    assert [bound.name for bound in two.required] == ["stroke.stroke", "stroke.time_ratio", "rod_swing.stroke"]
    assert math.degrees(two.required[2].interval.high) == pytest.approx(60.0)
    assert listed(SLIDER).kind == SLIDER.kind == "dyads, stroke design"


def test_faults_of_a_stroke_in_a_list_name_its_place() -> None:
    for changes, key in (({"output": "slidr"}, "output"), ({"stroke": None}, "stroke"), ({"tolerance": "1 mm"}, "tolerance")):
        with pytest.raises(InputError) as caught:
            listed(SLIDER, {"kind": "stroke", "name": "other", "output": "slider", "stroke": "9 mm", **changes})
        assert caught.value.faults[0].key == f"requirements.1.{key}"


def test_a_limit_of_a_quantity_may_have_the_name_of_a_key() -> None:
    """Its table states the quantity; the order of the file remains."""
    model = optlink.load("shaper-design").spec
    assert list(model.limits.named) == ["stroke", "time_ratio", "guide"]
    assert model.limits.time_ratio is None
    named = {"frame_length": {"quantity": "length", "of": "crank", "max": "80 mm"}}
    law = optlink.load("crank-rocker", {"limits": named}).spec
    assert list(law.limits.named) == ["frame_length"]
    assert law.limits.frame_length is None
    with pytest.raises(InputError) as caught:
        optlink.load("crank-rocker", {"limits": {"frame_length": {"quantity": "length", "off": "crank", "max": "80 mm"}}})
    assert caught.value.faults[0].key == "limits.frame_length.off"
    assert 'Did you mean "of"' in str(caught.value)


def test_a_named_limit_is_part_of_the_identity_of_a_problem() -> None:
    problem = optlink.load("path-within-torque")
    name = next(iter(problem.spec.limits.named))
    assert problem.override({f"limits.{name}.max": "9 N*m"}).hash != problem.hash


@pytest.mark.slow
def test_a_machine_is_checked_for_branch_and_circuit() -> None:
    """In the other assembly mode every joint is on the wrong side; a motion that leaves out half a radian jumps."""
    problem = optlink.load("stroke-crank-rocker").spec
    design = optlink.solve(optlink.load("stroke-crank-rocker")).design
    other = optlink.load("stroke-crank-rocker", {"mechanism.assembly": "right"}).spec
    even = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)
    for check, mechanism, angles in (
        ("one branch: every joint on one side", other.linkage, even),
        ("one circuit: no point jumps", problem.linkage, np.where(even < 1.0, even, even + 0.5)),
    ):
        cycle = Cycle(problem, design)
        assert validate(problem, design, cycle=cycle).valid
        sizes = {name: np.array([[value]]) for name, value in cycle.design.items()}
        vars(cycle)["revolution"] = motion_of(problem.linkage, mechanism, sizes, angles, cycle.longest, closed=True)
        assert check in validate(problem, design, cycle=cycle).failed
