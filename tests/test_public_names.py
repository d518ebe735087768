"""The names that a program may rely on: one is added in one line, and none disappears without a deprecation."""

import importlib
import inspect
import warnings

import pytest

import optlink

PUBLIC = [
    "Analysis",
    "Balance",
    "ClearanceSimulation",
    "Comparison",
    "DesignResult",
    "InputError",
    "InverseMotion",
    "LinkageDesign",
    "OptlinkError",
    "ProblemFile",
    "Programme",
    "Simulation",
    "SolverError",
    "Status",
    "SynthesisResult",
    "Tuning",
    "UnknownName",
    "analyze",
    "analyze_batch",
    "balance",
    "build",
    "compare",
    "explore",
    "four_bar",
    "grashof",
    "inverse_model",
    "load",
    "new",
    "read",
    "read_design",
    "read_result",
    "shipped",
    "simulate",
    "simulate_clearance",
    "solve",
    "sweep",
    "tune",
    "validate",
]
"""Public names. One that goes stays here, deprecated in `optlink._DEPRECATED`, for as long as docs/stability.md states."""


def test_the_public_names_are_those_of_the_table():
    """A new name is one line above; a name that goes is first deprecated."""
    assert sorted(PUBLIC) == sorted({*optlink.__all__, *optlink._DEPRECATED} - {"__version__"})
    assert set(dir(optlink)) >= set(optlink.__all__)


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_name_is_there_and_says_what_it_is(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if name in optlink._DEPRECATED else "error", DeprecationWarning)
        item = getattr(optlink, name)
    assert inspect.getdoc(item)


def test_a_deprecated_name_works_and_names_its_successor(monkeypatch):
    monkeypatch.setitem(optlink._DEPRECATED, "synthesise", "solve")
    with pytest.warns(DeprecationWarning, match=r"optlink\.synthesise is deprecated: use optlink\.solve") as caught:
        assert optlink.synthesise is optlink.solve
    assert caught[0].filename == __file__  # the line of the user
    assert "synthesise" not in dir(optlink)
    with pytest.raises(AttributeError, match="synthesize"):
        importlib.import_module("optlink").synthesize  # noqa: B018
