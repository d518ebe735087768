"""Limits that sizes within the tolerances of a sheet could violate, against the cosine rule."""

import math

import ezdxf
import pytest

import optlink
from optlink.presentation.export.export import Options, export
from optlink.presentation.report_model import report_model_of
from optlink.studies.tolerances.general import general_tolerance, violations
from tests.solved import solution

GENERAL = {"crank": 0.3e-3, "coupler": 0.8e-3, "rocker": 0.5e-3, "frame": 0.8e-3}  # ISO 2768-1, class m


def largest_angle(crank, coupler, rocker, frame):
    """Largest transmission angle [deg] of a crank-rocker."""
    return math.degrees(math.acos((coupler**2 + rocker**2 - (frame + crank) ** 2) / (2.0 * coupler * rocker)))


def test_the_class_is_that_of_the_standard():
    lengths = [0.4, 0.5, 6.0, 6.1, 30.0, 100.0, 120.1, 400.1, 1000.1, 3000.0, 4001.0]
    assert [general_tolerance(length) for length in lengths] == [0.0, 0.1, 0.1, 0.2, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0, 0.0]


def test_an_active_limit_is_violated_by_what_the_sizes_change():
    best = solution("crank-rocker").best
    sizes = {name: best.values[name] for name in GENERAL}
    angle, up = largest_angle(**sizes), {}
    for name, by in GENERAL.items():
        up[name] = max(largest_angle(**sizes | {name: sizes[name] + sign * by}) - angle for sign in (-1.0, 1.0))
    (found,) = violations(best, GENERAL)
    assert found.limit.name == "largest transmission angle"
    assert found.by == pytest.approx(sum(up.values()) - (135.0 - angle), rel=1e-6)
    assert found.size == max(up, key=up.get) == "frame"
    assert str(found) == "largest transmission angle by 1.2 deg, mainly due to frame"
    assert not violations(best, {})


@pytest.mark.slow
def test_the_sheet_and_the_command_tell_it(tmp_path):
    told = []
    for design in (None, {"coupler": 0.42, "rocker": 0.25}):  # at the limit of the transmission angle, and 10 deg away from it
        result = solution("crank-rocker") if design is None else optlink.validate("crank-rocker", design)
        notes = export(report_model_of(result), tmp_path / "sheet.dxf", Options(content="sheet"))
        told.append([note for note in notes if "may violate limits" in note])
        words = " ".join(one.dxf.text for one in ezdxf.readfile(tmp_path / "sheet.dxf").query("TEXT"))
        assert ("violate" in words) == bool(told[-1])
    assert told[0] == [
        "Sizes at the ends of the tolerances of these sheets may violate limits: "
        "largest transmission angle by 1.2 deg, mainly due to frame."
    ]
    assert told[1] == []
