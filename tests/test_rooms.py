"""The rooms of the package: imports point one way, between files and between rooms."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "phnn"
# Entry points: they name what they lead to, and nothing imports them but the package's own first file.
FACADE = "phnn"


def _modules() -> dict[str, Path]:
    """Path of every module by its dotted name; a package has the name of its folder."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = (PACKAGE.name, *path.relative_to(PACKAGE).with_suffix("").parts)
        if "configs" not in parts:
            found[".".join(parts).removesuffix(".__init__")] = path
    return found


MODULES = _modules()


def _module_of(name: str) -> str:
    """The module that a dotted name stands for, or in which it is defined; empty outside the package."""
    while name and name not in MODULES:
        name = name.rpartition(".")[0]
    return name


def _imports(tree: ast.AST, inside: bool = False) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    """All imports but those under ``if TYPE_CHECKING``, and whether each is inside a function: what that imports is
    loaded when it is called."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node, inside
        elif isinstance(node, ast.stmt | ast.excepthandler | ast.match_case):
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
                continue
            yield from _imports(node, inside or isinstance(node, ast.FunctionDef))


@cache
def _imports_of(name: str) -> list[tuple[ast.Import | ast.ImportFrom, bool]]:
    return list(_imports(ast.parse(MODULES[name].read_text(encoding="utf-8"))))


def _imported(name: str, within_functions: bool) -> Iterator[str]:
    """Modules of the package that a module imports."""
    for node, inside in _imports_of(name):
        if inside and not within_functions:
            continue
        named: list[str] = []
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            named = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            named = [alias.name for alias in node.names]
        yield from (m for m in map(_module_of, named) if m not in ("", name))


def _room(module: str) -> str:
    """The room of a module: the package or file right under ``phnn``."""
    return ".".join(module.split(".")[:2])


def _cycle(graph: Mapping[str, set[str]]) -> list[str]:
    """One cycle of a graph; empty where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_file_imports_itself_through_others() -> None:
    assert _cycle({name: set(_imported(name, within_functions=False)) for name in MODULES}) == []


def test_no_room_imports_itself_through_others() -> None:
    rooms: dict[str, set[str]] = {}
    for name in MODULES:
        if name != FACADE:
            others = {_room(m) for m in _imported(name, within_functions=True)} - {_room(name), FACADE}
            rooms.setdefault(_room(name), set()).update(others)
    assert _cycle(rooms) == []


def _imported_names(path: Path) -> set[str]:
    """Dotted names of all modules, and of what is taken from them, that a file imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return names


def test_the_generators_share_no_code_with_the_models() -> None:
    generator = sorted((PACKAGE.parent / "studies" / "generator").rglob("*.py"))
    assert len(generator) > 1
    for path in (PACKAGE / "demo.py", *generator):
        allowed = ("phnn.errors.", *(("studies.generator.",) if path in generator else ()))
        own = {n for n in _imported_names(path) if n.split(".")[0] in ("phnn", "studies")}
        assert {n for n in own if not n.startswith(allowed)} == set(), path


def test_the_package_imports_nothing_of_the_studies() -> None:
    found = {name: n for name, path in MODULES.items() for n in _imported_names(path) if n.split(".")[0] == "studies"}
    assert found == {}


def test_a_cycle_is_found() -> None:
    assert _cycle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": set()}) != []
