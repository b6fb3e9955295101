"""The rooms have one-way doors, and a name has one owner."""

import ast
from collections import defaultdict
from pathlib import Path

import pytest

import gsynopsis

SOURCE = Path(__file__).parent.parent / "src" / "gsynopsis"
ROOT = SOURCE.parent.parent
LEAVES = {"errors", "files", "config", "records", "_native"}
RENDERED = LEAVES | {
    *("formats", "scene", "render", "model", "training", "container", "stream"),
}
MAY_IMPORT = {
    "errors": set(),
    "files": {"errors"},
    "config": {"errors"},
    "records": {"errors"},
    "_native": set(),
    "formats": {"errors", "files", "records"},
    "scene": LEAVES,
    "render": LEAVES | {"scene"},
    "model": LEAVES | {"scene", "render"},
    "training": LEAVES | {"scene", "render", "model"},
    "container": {"errors", "files", "config", "records"},
    "stream": {"errors", "files", "config", "records", "container"},
    "serve": {"errors", "files", "config", "records", "container", "stream"},
    "evaluation": RENDERED,
    "pipeline": RENDERED | {"evaluation", "serve"},
    "baselines": RENDERED | {"evaluation"},
    "bench": RENDERED | {"evaluation", "pipeline", "baselines"},
    "cli": RENDERED | {"evaluation", "pipeline", "bench", "serve"},
    "__init__": RENDERED | {"evaluation", "pipeline"},
    "__main__": {"cli"},
}
FREE_OF_TORCH = {
    *("errors", "files", "config", "records", "formats", "scene", "container", "stream", "serve"),
}
MODULES = sorted(SOURCE.rglob("*.py"))
PYTHON = sorted([*MODULES, *(ROOT / "tests").rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")])


def room_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imported_names(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    return names


def test_every_room_that_may_be_imported_is_there() -> None:
    assert {room_of(path) for path in MODULES} == set(MAY_IMPORT)
    assert set().union(*MAY_IMPORT.values()) <= set(MAY_IMPORT)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_a_room_imports_only_what_stands_before_it(path: Path) -> None:
    room = room_of(path)
    rooms = {n.split(".")[1] for n in imported_names(path) if n.startswith("gsynopsis.")}
    rooms -= {"__version__"}
    assert rooms - {room} <= MAY_IMPORT[room], f"{room} must not import {rooms}"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_scene_pack_and_stream_live_without_torch(path: Path) -> None:
    if room_of(path) in FREE_OF_TORCH:
        assert not {n for n in imported_names(path) if n.split(".")[0] == "torch"}


def test_a_class_has_a_name_of_its_own() -> None:
    """One name for one thing, across all rooms."""
    owners: dict[str, list[str]] = defaultdict(list)
    for path in MODULES:
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                owners[node.name].append(str(path.relative_to(SOURCE)))
    assert {name: paths for name, paths in owners.items() if len(paths) > 1} == {}


def test_no_room_has_the_name_of_a_public_function() -> None:
    """An import of a room would hide the function behind the module."""
    assert not set(gsynopsis.__all__) & set(MAY_IMPORT)


def test_no_module_is_named_after_a_drawer() -> None:
    drawers = {"utils", "util", "helpers", "helper", "misc", "common"}
    assert not [p for p in PYTHON if p.stem in drawers or p.stem.endswith("utils")]
