"""Layers of links, pins and heads: collisions in space, found by separating axes of their polygons at other crank angles."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import optlink
from optlink.errors import InputError
from optlink.presentation.parts.layers import Stack, Stacked, stacked
from optlink.presentation.parts.model import part_set
from optlink.presentation.report_model import report_model_of
from optlink.problem.file import read
from tests.presentation.test_parts import of
from tests.tiers import mostly_slow

STACKED = ("crank-rocker", "shaper", "slider-crank", "watt-i", "toggle-press", "slotted-quick-return", "two-wipers", "six-bar")
UNSTACKED = ("function-sin", "whitworth")
CORNERS = 24  # of a circle: the polygon lies within it
ANGLES = 360


def rounded(centres: np.ndarray, radius: float) -> np.ndarray:
    """Corners of the convex hull of discs about points, counter-clockwise."""
    turns = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    corners = (centres[:, None] + radius * np.column_stack([np.cos(turns), np.sin(turns)])).reshape(-1, 2)
    return corners[ConvexHull(corners).vertices]


def pieces(stack: Stacked) -> list[tuple[str, str, np.ndarray, float, float]]:
    """Name, body, corners and heights of every part, pin and head."""
    found = []
    for name, part in stack.parts.parts.items():
        low = stack.layers[name] * stack.parts.pitch
        corners = rounded(part.core, 0.5 * part.width) if part.end == "round" else np.array(part.outline)[:, :2]
        found.append((name, name, corners, low, low + part.thickness))
    for pin in stack.parts.pins:
        low, high = stack.span(pin)
        found.append((f"pin {pin.name}", pin.on, rounded(pin.at[None], 0.5 * pin.diameter), low, high))
        for begin in (low - pin.height, high) if pin.height else ():
            found.append((f"pin {pin.name}", pin.on, rounded(pin.at[None], 0.5 * pin.head), begin, begin + pin.height))
    for pin, low, tube in stack.spacers:
        found.append((f"pin {pin.name}", pin.on, rounded(pin.at[None], 0.5 * tube.width), low, low + tube.thickness))
    return found


def moved(motion, body: str, corners: np.ndarray) -> np.ndarray:
    """Corners at all positions (positions, n, 2)."""
    count = len(motion.crank_angle)
    if body == "frame":
        return np.broadcast_to(corners, (count, *corners.shape))
    turned = np.exp(1j * np.broadcast_to(np.asarray(motion.body_angle(body).value), count))
    at = turned[:, None] * (corners @ [1.0, 1j]) + 1e3 * (motion.position(motion.mechanism.origin(body)) @ [1.0, 1j])[:, None]
    return np.stack([at.real, at.imag], axis=2)


def apart(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether a side of one of two convex polygons separates them (positions,); false where one cannot be assembled."""
    result = np.zeros(len(first), dtype=bool)
    for one, other in ((first, second), (second, first)):
        sides = np.roll(one, -1, axis=1) - one
        normals = np.stack([sides[..., 1], -sides[..., 0]], axis=2)
        heights = np.einsum("kij,klj->kil", normals, other).min(axis=2) - np.sum(normals * one, axis=2)
        result |= np.any(heights > 0.0, axis=1)
    return result


def collisions(stack: Stacked) -> set[frozenset[str]]:
    """Pairs of parts and pins that share a place at some crank angle halfway between two of those of the search."""
    searched = np.asarray(stack.parts.motion.crank_angle)
    angles = np.linspace(searched[0], searched[-1], ANGLES, endpoint=False) + 0.5 * (searched[1] - searched[0])
    motion = optlink.linkage.sweep(stack.parts.motion.mechanism, stack.parts.motion.sizes, angles)
    joined = {f"pin {pin.name}": pin.parts for pin in stack.parts.pins}
    placed = [(name, moved(motion, body, corners), low, high) for name, body, corners, low, high in pieces(stack)]
    found = set()
    for (one, first, low, high), (other, second, bottom, top) in itertools.combinations(placed, 2):
        fixed = one == other or one in joined.get(other, ()) or other in joined.get(one, ())
        if not fixed and min(high, top) - max(low, bottom) > 1e-9:
            assembled = np.isfinite(first).all(axis=(1, 2)) & np.isfinite(second).all(axis=(1, 2))
            if not np.all(apart(first, second)[assembled]):
                found.add(frozenset({one, other}))
    return found


@pytest.mark.parametrize("name", mostly_slow(STACKED, "crank-rocker", "slotted-quick-return"))
def test_nothing_collides_in_the_layers(name):
    stack = stacked(part_set(of(name).cycle))
    assert stack.layers["frame"] == 0
    assert min(layer for body, layer in stack.layers.items() if body != "frame") > 0
    assert collisions(stack) == set()


@pytest.mark.parametrize("end", ["square", "chamfered"])
def test_nothing_collides_in_the_layers_of_parts_with_straight_ends(end):
    stack = stacked(part_set(of("crank-rocker", {"parts.end": end}).cycle))
    assert collisions(stack) == set()
    flat = {**stack.layers, "coupler": stack.layers["crank"]}
    assert {"crank", "coupler"} in collisions(Stacked(stack.parts, flat, stack.room))
    assert any({one.one, one.other} == {"crank", "coupler"} for one in Stack(stack.parts).collisions(flat))


def test_a_corner_collides_where_a_round_end_does_not():
    """A rocker whose corner reaches a pin that a round end passes at some distance: gaps are those of the true outlines."""
    gaps = {}
    for end in ("round", "chamfered", "square"):
        stack = Stack(part_set(of("crank-rocker", {"parts.end": end}).cycle))
        one, other = (stack.parts.parts[name] for name in ("crank", "rocker"))
        gaps[end] = stack._gap("crank", "rocker").least - one.reach - other.reach
    assert gaps["square"] < gaps["chamfered"] - 1.0
    assert gaps["chamfered"] < gaps["round"] - 0.1


def test_a_link_in_the_layer_of_another_collides():
    """The oracle of these tests sees the defect, and so does the search."""
    stack = stacked(part_set(of("crank-rocker").cycle))
    flat = {**stack.layers, "coupler": stack.layers["crank"]}
    assert {"crank", "coupler"} in collisions(Stacked(stack.parts, flat, stack.room))
    assert any({one.one, one.other} == {"crank", "coupler"} for one in Stack(stack.parts).collisions(flat))


@pytest.mark.parametrize("thickness", ["1 mm", "3 mm", "12 mm"])
def test_heads_that_are_higher_than_a_layer_keep_apart(thickness):
    """Pins of 20 mm have heads of 12 mm: layers of thin sheet are further apart than sheet and washer."""
    made = part_set(of("crank-rocker", {"parts": {"thickness": thickness, "spacer": "0.5 mm"}}).cycle)
    stack = stacked(made)
    assert collisions(stack) == set()
    assert (made.pitch > made.parts["crank"].thickness + made.spacer) == (thickness != "12 mm")


@pytest.mark.parametrize(("coupler", "collides"), [(2, True), (4, False)])
def test_heads_that_meet_in_the_gap_between_two_layers_collide(coupler, collides):
    """The upper head of A above the crank, and the lower one of C below the coupler, wider than C comes near to A."""
    motion = part_set(of("crank-rocker").cycle).motion
    near = 1e3 * np.linalg.norm(motion.position("C") - motion.position("A"), axis=1).min()
    made = part_set(of("crank-rocker", {"parts": {"head": f"{1.02 * near} mm"}}).cycle)
    layers = {"frame": 0, "crank": 1, "coupler": coupler, "rocker": coupler + 1}
    pair = {"pin A", "pin C"}
    assert (pair in collisions(Stacked(made, layers, dict.fromkeys(("A", "B", "C", "D"), 0.0)))) == collides
    assert any({one.one, one.other} == pair for one in Stack(made).collisions(layers)) == collides


@pytest.mark.parametrize("name", UNSTACKED)
def test_without_layers_a_collision_is_named(name):
    """Two full turns about one plate: every order of the links collides."""
    parts = part_set(of(name).cycle)
    with pytest.raises(InputError, match=r"cannot be stacked: .* collide at a crank angle of [\d.]+ deg"):
        stacked(parts)


def random_six_bar(seed: int) -> dict[str, Any]:
    """A Watt I, a Stephenson III or a four-bar with a slider at its coupler, in turn; some cannot be assembled."""
    rng = np.random.default_rng([seed, 43])

    def span(low: float, high: float) -> str:
        return f"{rng.uniform(low, high):.6f} mm"

    links: dict[str, Any] = {
        "crank": {"joints": ["A", "B"], "length": span(15, 40)},
        "coupler": {"joints": ["B", "C"], "length": span(60, 160), "points": {"E": [span(-40, 160), span(-80, 80)]}},
        "rocker": {"joints": ["D", "C"], "length": span(60, 160)},
        "one": {"joints": ["E", "G"], "length": span(60, 300)},
        "other": {"joints": ["F", "G"], "length": span(60, 200)},
    }
    section = {"type": "dyads", "ground": {"A": ["0 mm", "0 mm"], "D": [span(80, 160), span(-40, 40)]}, "links": links}
    section["assembly"] = {"C": f"{rng.choice(['left', 'right'])} of B-D", "G": f"{rng.choice(['left', 'right'])} of E-F"}
    if seed % 3 == 0:
        links["rocker"]["points"] = {"F": [span(-60, 120), span(-80, 80)]}
    elif seed % 3 == 1:
        section["ground"]["F"] = [span(-150, 250), span(-150, 150)]
    else:
        links["other"] = {"joints": ["G"]}
        section["assembly"]["G"] = "forward"
        through = [span(0, 200), span(-150, 150)]
        guide = {"slider": "other", "on": "frame", "through": through, "direction": f"{rng.uniform(-180, 180):.3f} deg"}
        section["guides"] = {"S": guide}
    drive = {"body": "crank", "speed": "1 rad/s"}
    return {"title": "Random six-bar", "source": "Random numbers.", "mechanism": section, "drive": drive}


def stack_of(seed: int) -> Stacked | str | None:
    """The layers of a random six-bar, the sentence that refuses them, or nothing where it cannot be assembled."""
    try:
        cycle = report_model_of(optlink.analyze(read(random_six_bar(seed)))).cycle
    except InputError:
        return None
    try:
        return stacked(part_set(cycle))
    except InputError as error:
        return str(error)


@pytest.mark.slow
@pytest.mark.parametrize("first", [120, 270])
def test_random_six_bars_are_stacked(first):
    """One of them, 276, needs nine layers for its five links."""
    found = {seed: made for seed in range(first, first + 10) if (made := stack_of(seed)) is not None}
    assert len(found) > 5
    assert {seed: made for seed, made in found.items() if isinstance(made, str)} == {}
    assert {seed: hits for seed, made in found.items() if (hits := collisions(made))} == {}
