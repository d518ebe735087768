"""The sentence that states which limits exclude each other."""

import json
import math
import re

import pytest

import optlink
from optlink.presentation import terminal
from optlink.presentation.registry import read_result, table_of
from optlink.presentation.report_model import report_model_of
from optlink.presentation.views import conclusions
from optlink.presentation.views.design_view import best, title_of
from optlink.solvers.solution import Relaxation
from optlink.tasks.results.conflict import LARGER_SWING, opposed_limits, refutation


def limit(name: str, sense: str, bound: float, relaxed: float, unit: str, *, both: bool = False) -> Relaxation:
    return Relaxation(name, name, sense, bound, relaxed, abs(relaxed - bound), unit, both_sides=both)


SWING = limit("swing angle of the rocker", "=", 100.0, 89.8159, "deg")
GUIDE = limit("peak guide force in F", "<=", 200.0, 695.83, "N")
COUPLER = limit("coupler", ">=", 300.0, 212.34, "mm")
TURNS = limit("crank + frame <= coupler + rocker", ">=", 0.0, -12.346, "mm")
NEVER = limit("time ratio", ">=", 1.5, math.nan, "")


@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        ((), ""),
        ((GUIDE,), "peak guide force in F at most 200 N cannot be met; the peak guide force in F is 695.8 N at best."),
        ((NEVER,), "time ratio at least 1.5 cannot be met."),
        (
            (SWING, COUPLER),
            "100 deg of swing and coupler at least 300 mm exclude each other. "
            "With 300 mm the rocker swings 89.82 deg; with 100 deg the coupler is 212.3 mm. "
            f"{LARGER_SWING}",
        ),
        (
            (TURNS, COUPLER),
            f"the condition {TURNS.name} and coupler at least 300 mm exclude each other. "
            f"With 300 mm the condition {TURNS.name} is missed by 12.35 mm; "
            f"with the condition {TURNS.name} the coupler is 212.3 mm.",
        ),
        (
            (NEVER, SWING),
            "time ratio at least 1.5 and 100 deg of swing exclude each other. With 1.5 the rocker swings 89.82 deg. "
            f"{LARGER_SWING}",
        ),
        (
            (SWING, NEVER, COUPLER, GUIDE),
            "100 deg of swing (89.81 deg is possible otherwise), time ratio at least 1.5, coupler at least 300 mm (212.3 mm is "
            "possible otherwise) and peak guide force in F at most 200 N (695.9 N is possible otherwise) exclude one another. "
            f"{LARGER_SWING}",
        ),
    ],
)
def test_every_conflict_is_stated_in_one_form(limits: tuple[Relaxation, ...], sentence: str) -> None:
    assert refutation(limits) == (f"No such linkage: {sentence}" if limits else "")


def test_equal_values_are_told_apart_by_their_names() -> None:
    text = refutation([limit("frame length", "<=", 80.0, 95.0, "mm"), limit("coupler", ">=", 80.0, 71.0, "mm")])
    assert text.endswith("With coupler at least 80 mm the frame length is 95 mm; with frame length at most 80 mm "
                         "the coupler is 71 mm.")  # fmt: skip


def test_a_range_of_transmission_angles_is_one_angle_if_it_lies_around_90_deg() -> None:
    name = "transmission angle at E"
    around = [limit(name, ">=", 50.0, 43.21, "deg", both=True), limit(name, "<=", 130.0, 136.79, "deg", both=True)]
    assert refutation(around) == (
        "No such linkage: 50 deg of transmission angle at E cannot be met; "
        "the transmission angle at E falls to 43.21 deg at best."
    )
    aside = [around[0], limit(name, "<=", 120.0, 126.79, "deg", both=True)]
    assert "covers 43.21 ... 126.8 deg at best" in refutation(aside)
    (above,) = opposed_limits([limit("largest transmission angle", "<=", 130.0, 136.79, "deg")])
    assert (above.named, above.outcome) == (
        "at most 130 deg of transmission angle",
        "the transmission angle rises to 136.8 deg",
    )


PUMP = {
    "title": "pump drive",
    "mechanism": {
        "type": "four-bar",
        "frame": "180 mm",
        "crank": {"bounds": ["15 mm", "90 mm"]},
        "coupler": {"bounds": ["60 mm", "320 mm"]},
        "rocker": {"bounds": ["60 mm", "320 mm"]},
        "assembly": "left",
    },
    "requirement": {"kind": "transmission"},
    "limits": {"swing_angle": "110 deg", "transmission_angle": ["48 deg", "132 deg"], "crank": "full rotation"},
}


def text_of(result: object) -> str:
    console = terminal.console()
    with console.capture() as caught:
        console.print(terminal.rendered(table_of("design")(result).short))
    return " ".join(caught.get().split())


@pytest.mark.slow
def test_the_sentence_leads_in_every_place(tmp_path) -> None:
    result = optlink.solve(optlink.read(PUMP), starts=20)
    swing, angle = opposed_limits(result.conflict)
    short = [limit.sides[0].amount for limit in (swing, angle)]
    sentence = (
        "No such linkage: 110 deg of swing and 48 deg of transmission angle exclude each other. "
        f"With 48 deg the rocker swings {110.0 - short[0]:.4g} deg; "
        f"with 110 deg the transmission angle falls to {48.0 - short[1]:.4g} deg. "
        f"{LARGER_SWING}"
    )
    assert result.refuted == sentence
    assert result.to_dict()["message"] == sentence
    text = text_of(result)
    assert text.startswith(f"pump drive {sentence} no feasible design found")
    assert "FAIL" not in text  # a consequence
    page = conclusions.design(result, ())
    assert page == re.sub(r"(\d) deg", r"\1°", sentence)
    assert report_model_of(result).verdict == "No feasible design found"
    view = best(result)
    assert view is not None
    assert sentence in " ".join(title_of(view, 7.0, "pump drive").split())
    path = tmp_path / "result.json"
    path.write_text(json.dumps(result.to_dict()), encoding="utf-8")
    assert read_result(path).refuted == sentence
    for key, value in {
        "swing_angle": swing.possible,
        "transmission_angle": [angle.possible, f"{180 - float(angle.possible[:-4])} deg"],
    }.items():
        eased = optlink.read({**PUMP, "limits": {**PUMP["limits"], key: value}})  # type: ignore[dict-item]
        assert optlink.solve(eased, starts=20).valid, key


@pytest.mark.parametrize(
    ("bound", "relaxed", "words"), [(470.0, 480.001, "480"), (480.0, 480.001, "480.001"), (480.0, 479.96, "479.96")]
)
def test_what_is_reached_agrees_with_the_table_and_differs_from_its_limit(bound: float, relaxed: float, words: str) -> None:
    (one,) = opposed_limits([limit("mean power", "<=", bound, relaxed, "W")])
    assert one.outcome == f"the mean power is {words} W"
