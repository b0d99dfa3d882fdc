"""What is installed: built as an archive of the source and as a wheel, put into an empty environment, and used from there."""

import email
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

import diffeed

ROOT = Path(__file__).parent.parent
PACKAGES = ("diffeed", "optimize")


def shipped() -> set[str]:
    """Every file of the packages."""
    files = (p for package in PACKAGES for p in (ROOT / package).rglob("*") if p.is_file())
    return {p.relative_to(ROOT).as_posix() for p in files if "__pycache__" not in p.parts}


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """The wheel, made from the archive of the source, and that archive."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--outdir", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def test_the_version_stands_in_one_place():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["dynamic"] == ["version"]
    assert "version" not in project
    assert re.search(rf"^## {re.escape(diffeed.__version__)}\b", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert not re.search(r"^version:", (ROOT / "CITATION.cff").read_text(), re.M)


@pytest.mark.slow
def test_the_wheel_holds_every_file_of_the_packages_and_nothing_else(archives):
    names = {n for n in zipfile.ZipFile(archives[0]).namelist() if ".dist-info/" not in n}
    assert names == shipped()
    assert {f"{package}/py.typed" for package in PACKAGES} <= names


@pytest.mark.slow
def test_the_wheel_says_what_it_is(archives):
    with zipfile.ZipFile(archives[0]) as wheel:
        names = wheel.namelist()
        told = email.message_from_bytes(wheel.read(next(n for n in names if n.endswith("METADATA"))))
    assert told["Version"] == diffeed.__version__
    assert told["License-Expression"] == "Apache-2.0"
    assert sum("licenses/" in n for n in names) == 2  # its own, and that of the charts in the player


@pytest.mark.slow
def test_the_archive_of_the_source_can_be_tested(archives):
    with tarfile.open(archives[1]) as archive:
        names = {n.split("/", 1)[1] for n in archive.getnames() if "/" in n}
    assert shipped() | {"README.md", "CHANGELOG.md", "LICENSE", "tests/conftest.py", "pyproject.toml"} <= names


@pytest.mark.slow
def test_an_empty_environment_runs_the_wheel(archives, tmp_path):
    """From a folder of its own, so that nothing is found in the checkout."""
    venv.create(tmp_path / "env", with_pip=True)
    tools = tmp_path / "env" / ("Scripts" if os.name == "nt" else "bin")
    subprocess.run([tools / "python", "-m", "pip", "install", "-q", archives[0]], check=True, cwd=tmp_path)

    def told(*command: str) -> str:
        return subprocess.run(
            [tools / command[0], *command[1:]], check=True, cwd=tmp_path, capture_output=True, text=True
        ).stdout

    assert diffeed.__version__ in told("diffeed", "--version")
    assert set(diffeed.shipped_scenes()) <= set(told("diffeed", "scenes").split())
    assert "nip_slip" in told("python", "-m", "optimize", "studies")
    told("diffeed", "run", "gap_bridge", "--duration", "0.002", "--out", "out")
    made = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"player.html", "data.npz", "scene.toml", "summary.json"} <= made
    assert "site-packages" in told("python", "-c", "import diffeed; print(diffeed.__file__)")
