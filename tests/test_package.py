"""The wheel holds what it must, and works from outside the checkout."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import optlink
from tests.conftest import FIRST

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
        wheel.extractall(folder / "site")
    return folder / "site"


def test_wheel_contains_problems_and_types(unpacked):
    assert (unpacked / "optlink" / "problems" / "crank-rocker.toml").is_file()
    assert (unpacked / "optlink" / "py.typed").is_file()
    assert not (unpacked / "tests").exists()
    assert (unpacked / f"optlink-{optlink.__version__}.dist-info").is_dir()


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
def test_installed_wheel_works_in_a_clean_environment(unpacked, tmp_path):
    """With pip, and with the command that it makes; the libraries are those of this environment."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "new")], check=True, capture_output=True)
    scripts = tmp_path / "new" / ("Scripts" if os.name == "nt" else "bin")
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    options = {"capture_output": True, "encoding": "utf-8", "cwd": tmp_path, "env": environment}
    wheel = next(unpacked.parent.glob("*.whl"))
    python = str(scripts / "python")
    into = [sys.executable, "-m", "pip", "--python", python, "install", "--no-index", "--no-deps", "--no-compile"]
    done = subprocess.run([*into, str(wheel)], check=False, **options)
    assert done.returncode == 0, done.stderr
    site = Path(
        subprocess.run(
            [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], check=False, **options
        ).stdout.strip()
    )
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    (site / "libraries.pth").write_text("\n".join(libraries) + "\n", encoding="utf-8")
    done = subprocess.run([str(scripts / "optlink"), "solve", "crank-rocker", "--json"], check=False, **options)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["valid"] is True
    place = subprocess.run([python, "-c", "import optlink; print(optlink.__file__)"], check=False, **options).stdout.strip()
    assert Path(place).is_relative_to(site)


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
