"""Pictures of --out as PNG, SVG or PDF: the same bytes in every run, and no other format."""

from __future__ import annotations

import inspect

import pytest

from optlink.cli import simulate, solve, study
from optlink.presentation.style import figure, save
from tests.cli.test_cli import run

BEGINS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.mark.parametrize("kind", BEGINS)
def test_the_same_picture_is_the_same_file(tmp_path, kind):
    for name in ("a", "b"):
        drawn = figure(3.0, 2.0)
        axes = drawn.subplots()
        axes.plot([0.0, 1.0], [1.0, 0.0], label="line")
        axes.fill_between([0.0, 1.0], [0.0, 1.0])
        axes.legend()
        save(drawn, tmp_path / f"{name}.{kind}")
    data = (tmp_path / f"a.{kind}").read_bytes()
    assert data.startswith(BEGINS[kind])
    assert data == (tmp_path / f"b.{kind}").read_bytes()
    assert b"CreationDate" not in data
    assert b"<dc:date>" not in data


@pytest.mark.slow
def test_a_command_writes_pictures_in_the_format_of_the_option(tmp_path):
    for kind in ("svg", "png"):  # the pictures of an earlier run are replaced
        done = run("study", "sensitivity", "crank-rocker", "--out", str(tmp_path / "out"), "--format", kind, "--json")
        assert done.exit_code == 0, done.stderr
        suffixes = {path.suffix for path in (tmp_path / "out").iterdir()} - {".json", ".csv", ".toml", ".gif", ".lock", ""}
        assert suffixes == {f".{kind}"}
    refused = run("study", "sensitivity", "crank-rocker", "--out", str(tmp_path / "new"), "--format", "bmp")
    assert refused.exit_code == 2
    assert "'png', 'svg', 'pdf'" in refused.stderr
    assert not (tmp_path / "new").exists()


def test_every_command_with_pictures_has_the_option():
    commands = [
        one
        for module in (simulate, solve, study)
        for name, one in vars(module).items()
        if inspect.isfunction(one) and not name.startswith("_") and "as_json" in inspect.signature(one).parameters
    ]
    asked = [set(inspect.signature(one).parameters) for one in commands if "out" in inspect.signature(one).parameters]
    assert len(asked) >= 9
    assert all("picture" in names for names in asked)
