"""The wheel holds what it must, and works from outside the checkout."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import optlink
from optlink.errors import extra_remedy
from tests.conftest import FIRST

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory) -> Path:
    """The wheel that is built from the sdist, unpacked; both lie beside it."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
        wheel.extractall(folder / "site")
    return folder / "site"


@pytest.mark.slow
def test_wheel_contains_problems_and_types(unpacked):
    assert (unpacked / "optlink" / "problems" / "crank-rocker.toml").is_file()
    assert (unpacked / "optlink" / "py.typed").is_file()
    assert not (unpacked / "tests").exists()
    assert (unpacked / f"optlink-{optlink.__version__}.dist-info").is_dir()


@pytest.mark.slow
def test_wheel_works_outside_the_checkout(unpacked, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(unpacked)}
    code = "import optlink, sys; assert optlink.__file__.startswith(sys.argv.pop(1)); from optlink.cli.app import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, str(unpacked), "solve", "crank-rocker", "--json"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["valid"] is True


@pytest.mark.slow
def test_wheel_has_every_file_of_the_package_and_no_other(unpacked):
    listing = subprocess.run(
        ["git", "ls-files", "optlink", "problems", "templates"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listing.returncode != 0:
        pytest.skip("not a git checkout")
    tracked = {name if name.startswith("optlink/") else f"optlink/{name}" for name in listing.stdout.splitlines()}
    with zipfile.ZipFile(next(unpacked.parent.glob("*.whl"))) as wheel:
        packed = {name for name in wheel.namelist() if name.startswith("optlink/")}
    assert packed == tracked


def closure(requirements: Iterable[str]) -> dict[str, metadata.Distribution]:
    """The installed packages that requirements name, and all that these need."""
    found, todo = dict[str, metadata.Distribution](), [Requirement(text) for text in requirements]
    while todo:
        one = todo.pop()
        if one.name in found or not (one.marker is None or one.marker.evaluate({"extra": ""})):
            continue
        try:
            found[one.name] = metadata.distribution(one.name)
        except metadata.PackageNotFoundError:
            if one.name != "cvxpy-base":
                raise
            found[one.name] = metadata.distribution("cvxpy")  # has the same files
        todo += map(Requirement, found[one.name].requires or ())
    return found


class Environment:
    """A virtual environment with optlink and nothing but the packages that it declares: links to those of this environment."""

    def __init__(self, folder: Path, wheel: Path) -> None:
        self.folder, self.scripts = folder, folder / "new" / "bin"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder / "new")], check=True, capture_output=True)
        into = [sys.executable, "-m", "pip", "--python", str(self.scripts / "python"), "install"]
        done = self.run(*into, "--no-index", "--no-deps", "--no-compile", str(wheel))
        assert done.returncode == 0, done.stderr
        self.site = Path(self.python("import sysconfig; print(sysconfig.get_path('purelib'))").stdout.strip())
        self.declared = next(iter(metadata.distributions(name="optlink", path=[str(self.site)]))).requires or []
        self.add("")

    def add(self, extra: str) -> None:
        """Add the packages of an extra; of none, what optlink always needs."""
        wanted = [one for one in map(Requirement, self.declared) if one.marker is None or one.marker.evaluate({"extra": extra})]
        for package in closure(f"{one.name}{one.specifier}" for one in wanted).values():
            for top in {file.parts[0] for file in package.files or ()} - {"..", "__pycache__"}:
                if not (self.site / top).exists():
                    (self.site / top).symlink_to(package.locate_file(top))

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a program outside the checkout."""
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        return subprocess.run(words, capture_output=True, encoding="utf-8", cwd=self.folder, env=environment, check=False)

    def optlink(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run the command that the installation made."""
        return self.run(str(self.scripts / "optlink"), *words)

    def python(self, code: str) -> subprocess.CompletedProcess[str]:
        """Run Python of the environment."""
        return self.run(str(self.scripts / "python"), "-c", code)


EXTRAS = {
    "studio": ("optlink studio", "import optlink.studio.server"),
    "dask": (
        "optlink study sweep crank-rocker --vary mechanism.frame=450..550mm:2 --engine dask",
        "from optlink.execution.runner import check; check('dask', 1, None)",
    ),
    "fast": (
        "optlink simulate slider-crank-clearance --revolutions 1 --integrator compiled",
        "from optlink.clearance.control import installed; assert installed()",
    ),
    "notebook": ("import optlink; optlink.explore('crank-rocker')", "from optlink.studio.widget import Canvas"),
}
"""What needs an extra: how it is refused without it, and what works with it."""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="makes symbolic links")
def test_installed_wheel_works_with_the_packages_that_it_declares(unpacked, tmp_path):
    """With pip, and with the command that it makes. What needs an extra names it, and works with the packages of the extra."""
    new = Environment(tmp_path, next(unpacked.parent.glob("*.whl")))
    assert Path(new.python("import optlink; print(optlink.__file__)").stdout).is_relative_to(new.site)
    for words in (
        ("list",),
        ("new", "stroke", "-o", "mine.toml"),
        ("solve", "crank-rocker", "--out", "out"),
        ("report", "out", "-o", "page.html"),
        ("export", "out", "-o", "drawing.dxf"),
        ("solve", "balance-four-bar"),
        ("simulate", "slider-crank-clearance", "--revolutions", "1"),
    ):
        done = new.optlink(*words)
        assert done.returncode == 0, (words, done.stderr)
    assert json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))["valid"] is True
    assert "plotly.js" in (tmp_path / "page.html").read_text("utf-8")
    for extra, (refused, works) in EXTRAS.items():
        command = refused.startswith("optlink ")
        done = new.optlink(*refused.split()[1:]) if command else new.python(refused)
        assert done.returncode == (2 if command else 1), (extra, done.stderr)
        assert extra_remedy(extra) in done.stderr
        assert not command or (done.stderr.count("\n") == 1 and done.stderr.startswith("Error: "))
        try:
            new.add(extra)
        except metadata.PackageNotFoundError:
            continue  # this environment has no such extra
        done = new.python(works)
        assert done.returncode == 0, (extra, done.stderr)


def test_stability_states_the_versions_that_are_needed():
    about = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    least = {one.name: str(one.specifier).removeprefix(">=") for one in map(Requirement, about["dependencies"])}
    assert all(version.replace(".", "").isdecimal() for version in least.values())  # no other bounds
    python = about["requires-python"].removeprefix(">=")
    text = " ".join((ROOT / "docs" / "stability.md").read_text(encoding="utf-8").split())
    assert f"Python {python}, numpy {least['numpy']}, scipy {least['scipy']} or newer" in text


def test_what_is_advised_can_be_installed():
    """There is no package index with optlink: an extra is one of a checkout or of a wheel."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    files = [path for folder in ("docs", "notebooks", "optlink", "examples") for path in (ROOT / folder).rglob("*")]
    texts = [
        path.read_text(encoding="utf-8") for path in (*files, *ROOT.glob("README*")) if path.suffix in (".py", ".md", ".ipynb")
    ]
    advised = [match for text in texts for match in re.findall(r"""pip install (?:-[qe] )*\\*["']([^"'\\]*)\[(\w+)\]""", text)]
    assert {place for place, _ in advised} == {".", "optlink-VERSION-py3-none-any.whl"}
    assert {extra for _, extra in advised} <= extras.keys()
    named = {extra for text in texts for extra in re.findall(r"""extra_remedy\(["'](\w+)["']\)""", text)}
    assert named == {"cad", "dask", "fast", "frame", "notebook", "studio"}
    assert named <= extras.keys()


def test_what_begins_a_run_exists():
    """A name that no test has any longer would leave a long one to the end, when the other cores have no more work."""
    text = "".join(path.name + path.read_text(encoding="utf-8") for path in ROOT.glob("tests/**/test_*.py"))
    assert [name for name in FIRST if name not in text] == []


def test_repository_speaks_of_the_project_alone():
    """No absolute path of a developer's machine in any tracked text."""
    listing = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listing.returncode != 0:
        pytest.skip("not a git checkout")
    for name in listing.stdout.split("\n"):
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".ipynb", ".yml", ".m"} and path.is_file() and path.name != Path(__file__).name:
            text = path.read_text(encoding="utf-8")
            assert str(ROOT) not in text, name
