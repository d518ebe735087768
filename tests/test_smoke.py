"""Everything that ships, through every command: each ends with its exit code, never with a traceback.

What a command answers follows from the kind of the problem; what it refuses is refused with the exit code 2 and one sentence.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.presentation import labels, style
from optlink.presentation.views.search_tables import LINES
from optlink.problem.file import ProblemFile
from optlink.problem.templates import template, templates
from optlink.tasks.run import design_task
from tests.solved import shared_searches

SHIPPED = [("problem", name) for name in optlink.shipped()] + [("template", name) for name in templates()]
FEW = ("--starts", "3")
ROWS = ("--points", "24")
SHORT = ("--duration", "20 ms")
LAW, MACHINE = "error,limits.transmission_angle.max", "peak torque,rms torque"
"""Two objectives of a motion law, and of a machine with masses or loads."""


class Session:
    """Commands on one problem, in its own folder; `wrong` has what ended otherwise than it should."""

    def __init__(self, file: ProblemFile, name: str) -> None:
        self.file, self.name, self.wrong = file, name, list[str]()
        self.codes: dict[str, int] = {}

    def run(self, code: int | tuple[int, ...], *words: str) -> str:
        """Run a command that should end with an exit code; return its output."""
        done = CliRunner().invoke(app, list(words), env={"COLUMNS": "80"})
        line = " ".join(words)
        if "--out" in words:
            self.codes[words[words.index("--out") + 1]] = done.exit_code
        if done.exit_code not in (code if isinstance(code, tuple) else (code,)) or not isinstance(
            done.exception, SystemExit | None
        ):
            self.wrong.append(f"{line}: exit code {done.exit_code}, not {code}: {done.stderr[-300:]}")
        elif done.exit_code == 2 and not (done.stderr.startswith("Error: ") and done.stderr.count("\n") == 1):
            self.wrong.append(f"{line}: not one sentence: {done.stderr}")
        return done.stdout

    def moved(self, folder: str) -> None:
        """Report on a saved result, after its folder was moved elsewhere."""
        if not Path(folder, "result.json").exists():
            self.wrong.append(f"{folder}: no result")
            return
        place = shutil.move(folder, f"moved/{folder}")
        self.run(self.codes[folder], "report", place, "-o", f"{folder}.html")


@pytest.fixture
def cheap(kind: str) -> Iterator[None]:
    """Search a problem with the same options once for all commands and tests, and a changed one from few starts.

    Every picture is composed; only those of templates are laid out and drawn, which takes most of the time.
    """
    with shared_searches(changed=3), pytest.MonkeyPatch.context() as patch:
        if kind == "problem":
            patch.setattr(labels, "lay_out", lambda figure: None)
            patch.setattr(labels, "_place", lambda axes, group: None)
            patch.setattr(style, "save", lambda figure, path: path.touch())
        yield


def design_of(folder: str) -> dict[str, float]:
    """The lengths of a saved design [mm]."""
    document = json.loads(Path(folder, "result.json").read_text(encoding="utf-8"))
    design = document["design"] if "design" in document else document["designs"][0]["design"]
    return {key.removesuffix("_mm"): value for key, value in design.items() if key.endswith("_mm")}


def key_of(file: ProblemFile, name: str) -> str:
    """The key of a length in the file."""
    body, _, rest = name.partition(".")
    return f"mechanism.links.{body}.{rest}" if body in getattr(file.model.mechanism, "links", {}) else f"mechanism.{name}"


def commands(session: Session) -> None:
    """Run all commands on a problem."""
    file, name, run = session.file, session.name, session.run
    designed, balanced = file.task not in ("analysis", "balance"), file.task == "balance"
    solvable, of = designed or balanced, ("--design", "solved/result.json") if designed else ()
    for words in ((), ("--json",), ("--toml",)):
        run(0, "show", name, *words)

    text = run(0 if solvable else 2, "solve", name, *(("--out", "solved") if solvable else ()))
    if solvable and text.count("\n") > LINES:
        session.wrong.append(f"solve prints {text.count(chr(10))} lines")
    if solvable:
        assert json.loads(run(0, "solve", name, "--json"))["valid"]
    run(0 if balanced else 2, "balance", name)
    run(2, "validate", name)
    if designed:
        run(0, "validate", name, *of)
        run(0, "validate", "solved")
        run(0, "validate", "solved/design.toml")
        run(motion_codes(session), "analyze", "solved", *ROWS)

    run(motion_codes(session), "analyze", name, *ROWS, *of, "--out", "analysed")
    simulations(session, of)
    exports(session, designed, of)
    studies(session, designed, of)
    for folder in sorted(path.name for path in Path().iterdir() if (path / "result.json").is_file()):
        session.moved(folder)


def motion_codes(session: Session) -> tuple[int, ...]:
    """Exit codes of the motion of a whole revolution.

    A design for a part of it may be singular, or lock, in the rest.
    """
    return (0,) if session.file.task in ("analysis", "balance") else (0, 1)


def simulations(session: Session, of: tuple[str, ...]) -> None:
    """Simulate a machine, an ideal one, and one with clearance."""
    file, name = session.file, session.name
    if file.model.has_clearance:
        session.run(0, "simulate", name, "--revolutions", "1", "--points", "60", "--tolerance", "1e-6", "--out", "simulated")
        session.run(0, "simulate", name, "--ideal", *SHORT, *ROWS, "--out", "ideal")
    else:
        session.run(0, "simulate", name, *SHORT, *ROWS, *of, "--out", "simulated")
        session.run(2, "simulate", name, *SHORT, "--revolutions", "1")


def exports(session: Session, designed: bool, of: tuple[str, ...]) -> None:
    """Write a page and every format, from the file and from the saved result."""
    name = session.name
    session.run(0, "report", name, "-o", "file.html")
    for suffix in ("dxf", "svg", "csv", "json"):
        session.run(0, "export", name, *of, "-o", f"file.{suffix}")
        if session.file.task != "analysis":  # a balancing is not a single design
            session.run(0 if designed else 2, "export", "solved", "-o", f"saved.{suffix}")


def studies(session: Session, designed: bool, of: tuple[str, ...]) -> None:
    """Run every study, small."""
    file, name, run = session.file, session.name, session.run
    links, driving = [link for link in file.model.linkage.links if link.length in file.model.quantities], file.model.driving
    low, high = (driving.shown(at) for at in driving.mechanism.limits or (0.0, 0.5 * math.pi))
    angles = f"{low!r} {driving.unit}, {0.5 * (low + high)!r} {driving.unit}"
    run(0 if designed else 2, "study", "sensitivity", name, *(("--out", "sensitivity") if designed else ()))
    if not links:  # a cam has no length
        return
    output = f"{links[0].end}.x"  # it depends on the first length of the linkage, most often that of the crank
    run(0, "study", "sensitivity", name, "--quantity", output, "--angles", angles, *of)

    length = links[0].length
    value = (design_of("solved") if designed else {}).get(length) or 1e3 * file.model.quantities[length].value
    vary = ("--vary", f"{key_of(file, length)}={value!r}..{1.0005 * value!r} mm:2", "--workers", "1")
    swept = (0, "--out", "swept") if designed else (2,)
    run(swept[0], "study", "sweep", name, *vary, *swept[1:])
    run(motion_codes(session), "study", "sweep", name, *vary, "--analyze", *ROWS, *of, "--out", "analyses")

    deviation = ("--tolerance", f"{length}=0.1 mm", "--samples", "64", *of)
    run(0, "study", "tolerance", name, *deviation, "--quantity", output, "--angles", angles, "--out", "tolerance")

    model, cycle = file.model, file.task == "cycle"
    front = designed and (not cycle or bool(model.bodies or model.loads))
    run(2, "study", "pareto", name)
    if designed and not cycle and (file.spec.composed or file.spec.everywhere):
        return  # each point takes as long as all other commands
    machine = MACHINE if driving.ends is None else MACHINE.replace("torque", "drive force")
    asked = ("--objectives", machine if cycle else LAW, "--points", "2", "--workers", "1")
    code = 2 if not front else 0 if cycle or file.spec.law_given else (0, 1)  # so few starts may find no point of a front
    run(code, "study", "pareto", name, *asked, *(("--out", "front") if front else ()))


def given(kind: str, name: str) -> Iterator[str]:
    """Write a template to a file; yield what names the problem on the command line."""
    if kind == "template":
        Path(f"{name}.toml").write_text(template(name).text, encoding="utf-8")
    yield name if kind == "problem" else f"{name}.toml"


@pytest.mark.slow
@pytest.mark.usefixtures("cheap")
@pytest.mark.parametrize(("kind", "name"), SHIPPED, ids=lambda value: value)
def test_every_command_ends_with_its_exit_code(kind, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("moved").mkdir()
    [place] = given(kind, name)
    session = Session(optlink.load(place), place)
    commands(session)
    assert session.wrong == []


def test_every_task_is_among_what_ships():
    tasks = {optlink.load(path).task for path in (*optlink.shipped().values(), *templates().values())}
    assert tasks == {"function", "path", "cycle", "balance", "analysis"}
    assert all(design_task(optlink.load(name)) for name in optlink.shipped() if optlink.load(name).task != "analysis")


# --- faults that the matrix has found, on other data ---------------------------------------------------------------------------

SQUARE = """
[mechanism]
crank = "80 mm"
coupler = "80 mm"
rocker = "80 mm"
frame = "80 mm"
"""


def cli(*words: str) -> Any:
    return CliRunner().invoke(app, list(words))


@pytest.mark.slow
def test_a_motion_without_a_position_at_a_singular_angle_has_a_page(tmp_path, monkeypatch):
    """All links are of one length: at a crank angle of zero the coupler can have any angle."""
    monkeypatch.chdir(tmp_path)
    Path("square.toml").write_text(SQUARE, encoding="utf-8")
    assert cli("analyze", "square.toml", *ROWS, "--out", "out").exit_code == 1
    done = cli("report", "out", "-o", "square.html")
    assert done.exit_code == 1, done.stderr
    assert (
        "NaN" not in Path("square.html").read_text(encoding="utf-8").partition('id="motion-data">')[2].partition("</script>")[0]
    )


@pytest.mark.slow
def test_the_analysis_of_a_law_at_its_start_has_a_page(tmp_path, monkeypatch):
    """Its design has the start angle of the law, which no linkage has."""
    monkeypatch.chdir(tmp_path)
    assert "phi0" in optlink.load("law-slider-crank").model.free or "start" in optlink.load("law-slider-crank").model.free
    assert cli("analyze", "law-slider-crank", *ROWS, "--out", "out").exit_code in (0, 1)
    done = cli("report", "out", "-o", "law.html")
    assert done.exit_code in (0, 1), done.stderr


@pytest.mark.slow
def test_a_result_is_read_with_the_problem_beside_it_though_another_one_of_its_name_ships(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = template("wiper").text.replace("right", "left")
    Path("crank-rocker.toml").write_text(text, encoding="utf-8")
    change = ("--set", "limits.swing_angle=88 deg")
    assert cli("solve", "crank-rocker.toml", *FEW, *change, "--out", "out").exit_code == 0
    done = cli("report", "out", "-o", "page.html")
    assert done.exit_code == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["left", "right"])
def test_a_design_is_validated_in_its_own_assembly_mode(mode, tmp_path, monkeypatch):
    """Both modes of a linkage for a swing are equally good; the strokes are those of the one that was stored."""
    monkeypatch.chdir(tmp_path)
    Path("wiper.toml").write_text(template("wiper").text, encoding="utf-8")
    cli("solve", "wiper.toml", *FEW, "--out", "out")
    document = json.loads(Path("out/result.json").read_text(encoding="utf-8"))
    [chosen] = [design for design in document["designs"] if design["assembly"] == mode][:1]
    other = cli("solve", "wiper.toml", *FEW, "--set", f"mechanism.assembly={mode}", "--json").stdout
    document |= {"designs": [chosen], "strokes": json.loads(other)["strokes"]}
    Path("mine.json").write_text(json.dumps(document), encoding="utf-8")
    done = cli("validate", "wiper.toml", "--design", "mine.json")
    assert done.exit_code == 0, done.stdout
