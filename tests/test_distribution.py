"""The wheel and the source distribution, built as an installer builds them: complete without the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import campaigns
import pytest

ROOT = Path(__file__).resolve().parent.parent
LEFT_OUT = (".git", ".venv", "out", "outputs", "build", "dist", "*.egg-info", "__pycache__", ".*_cache", ".hypothesis")
BUILD = "import sys; from setuptools import build_meta as b; print(getattr(b, f'build_{sys.argv[1]}')(sys.argv[2]))"


def _built(kind: str, source: Path, into: Path) -> Path:
    """A distribution of a source tree, built by the declared backend."""
    into.mkdir(exist_ok=True)
    command = [sys.executable, "-c", BUILD, kind, str(into)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=True)
    return into / done.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("sdist")
    shutil.copytree(ROOT, home / "source", ignore=shutil.ignore_patterns(*LEFT_OUT))
    return _built("sdist", home / "source", home / "dist")


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of what the source distribution holds: what one lacks, so does the other."""
    home = tmp_path_factory.mktemp("wheel")
    with tarfile.open(sdist) as archive:
        archive.extractall(home, filter="data")
    return _built("wheel", next(home.glob("phnn-*")), home / "dist")


def _sources(folder: str, *patterns: str) -> set[str]:
    found = (path for pattern in patterns for path in (ROOT / folder).rglob(pattern))
    return {str(path.relative_to(ROOT)) for path in found if "__pycache__" not in path.parts}


@pytest.mark.slow
def test_wheel_holds_the_package_its_data_and_its_licence_and_nothing_else(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    code = _sources("phnn", "*.py", "*.html", "*.css", "py.typed")
    settings = {f"phnn/{name}" for name in _sources("configs", "*.yaml")}
    inside = {name for name in names if not name.split("/")[0].endswith(".dist-info")}
    assert inside == code | settings
    assert "phnn/py.typed" in inside
    info = wheel.name.replace("-py3-none-any.whl", ".dist-info")
    with zipfile.ZipFile(wheel) as archive:
        assert archive.read(f"{info}/licenses/LICENSE") == (ROOT / "LICENSE").read_bytes()
        assert "phnn = phnn.start:main" in archive.read(f"{info}/entry_points.txt").decode()


@pytest.mark.slow
def test_source_distribution_holds_tests_documents_and_pins(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = (
        _sources("tests", "*.py") | _sources("docs", "*.md") | _sources("phnn", "*.py") | _sources("configs", "*.yaml")
    )
    assert (
        wanted | {"constraints.txt", "LICENSE", "CHANGELOG.md", "CITATION.cff", "conda/meta.yaml", "Makefile"} <= names
    )


@pytest.mark.slow
def test_commands_run_from_the_wheel_alone(wheel: Path, tmp_path: Path) -> None:
    # Without the commands that integrate: an unpacked wheel has its kernels compiled anew, which takes minutes.
    home, (folder, _) = tmp_path / "site", campaigns.concealed()
    zipfile.ZipFile(wheel).extractall(home)
    code = "import sys, phnn; print(phnn.__file__); from phnn.start import main; sys.exit(main())"
    environment = {**os.environ, "PYTHONPATH": str(home)}
    for arguments, word in (
        (["check", str(folder), "--out", str(tmp_path / "out")], "noise floor"),
        (["template", str(folder)], "recordings:"),
        # Its settings come from the files of the package.
        (["modes", "--help"], "experiments: 2"),
    ):
        command = [sys.executable, "-c", code, *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith(str(home))
        assert word in done.stdout
    assert (tmp_path / "out" / "check.json").is_file()
