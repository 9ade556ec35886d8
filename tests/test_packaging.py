"""What a normal installation must carry, what describes it, and the distributions as an installer builds them."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import campaigns
import jinja2
import pytest
import yaml
from packaging.requirements import Requirement
from packaging.version import Version

import phnn

ROOT = Path(__file__).resolve().parent.parent
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Names of conda-forge that differ from those of PyPI, and names of modules that differ from those of distributions.
CONDA = {"torch": "pytorch", "matplotlib": "matplotlib-base"}
MODULES = {"pillow": "PIL", "hydra-core": "hydra", "pyyaml": "yaml", "nptdms": "nptdms", "scikit-learn": "sklearn"}


def test_every_folder_of_code_is_a_package() -> None:
    # setup.py finds packages by their __init__.py: a folder without one works from the source tree and is then lost.
    folders = {path.parent for path in (ROOT / "phnn").rglob("*.py")}
    lost = sorted(str(folder.relative_to(ROOT)) for folder in folders if not (folder / "__init__.py").exists())
    assert lost == []


def test_package_data_exists() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    for package, patterns in project["tool"]["setuptools"]["package-data"].items():
        folder = ROOT / ("configs" if package == "phnn.configs" else package.replace(".", "/"))
        for pattern in patterns:
            assert list(folder.glob(pattern)), f"{package}: no {pattern}"


def test_constraints_pin_every_requirement_inside_its_range() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    pins = {_name(name): version for name, version in pins.items()}
    groups = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    for requirement in (Requirement(text) for group in groups for text in group):
        version = Version(pins[_name(requirement.name)])
        assert requirement.specifier.contains(version), f"{requirement}: {version}"


def test_everything_that_the_package_imports_is_declared() -> None:
    # Another package may bring it today and no longer tomorrow.
    extras = [text for name, group in PROJECT["optional-dependencies"].items() if name != "dev" for text in group]
    declared = {_name(Requirement(text).name) for text in [*PROJECT["dependencies"], *extras]}
    declared = {MODULES.get(name, name.replace("-", "_")) for name in declared}
    imported = {module for path in (ROOT / "phnn").rglob("*.py") for module in _imports(path)}
    assert sorted(imported - declared - set(sys.stdlib_module_names) - {"phnn"}) == []


def test_the_version_stands_in_one_place() -> None:
    version = PROJECT["version"]
    assert phnn.__version__ == version
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    assert _recipe()["package"] == {"name": PROJECT["name"], "version": version}
    said = subprocess.run([sys.executable, "-m", "phnn.cli", "--version"], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == f"phnn {version}"


def test_conda_recipe_asks_for_what_the_project_asks_for() -> None:
    recipe = _recipe()
    asked = {"python": PROJECT["requires-python"]}
    for requirement in map(Requirement, PROJECT["dependencies"]):
        asked[CONDA.get(requirement.name, requirement.name)] = str(requirement.specifier)
    found = dict(text.split(" ", 1) for text in recipe["requirements"]["run"])
    assert {n: set(s.split(",")) for n, s in found.items()} == {n: set(s.split(",")) for n, s in asked.items()}
    scripts = [f"{name} = {target}" for name, target in PROJECT["scripts"].items()]
    assert recipe["build"]["entry_points"] == scripts
    about = {"summary": PROJECT["description"], "license": PROJECT["license"]}
    assert about.items() <= recipe["about"].items()


def _recipe() -> dict[str, Any]:
    text = (ROOT / "conda" / "meta.yaml").read_text()
    recipe: dict[str, Any] = yaml.safe_load(
        jinja2.Template(text, undefined=jinja2.StrictUndefined).render(PYTHON="python")
    )
    return recipe


def _name(distribution: str) -> str:
    """The normal form of a distribution's name."""
    return re.sub(r"[-_.]+", "-", distribution).lower()


def _imports(path: Path) -> Iterator[str]:
    """First parts of the names of all modules that a file imports."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]


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
    code = _sources("phnn", "*.py", "*.html", "*.css", "*.c", "*.yaml", "py.typed")
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
