"""The rooms have one-way doors and a size budget."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent.parent / "src" / "gsynopsis"
ROOT = SOURCE.parent.parent
LEAVES = {"errors", "config", "records", "_native"}
MAY_IMPORT = {
    "errors": set(),
    "config": {"errors"},
    "records": {"errors"},
    "_native": {"errors"},
    "scene": LEAVES,
    "render": LEAVES | {"scene"},
    "model": LEAVES | {"scene", "render"},
    "train": LEAVES | {"scene", "render", "model"},
    "pack": {"errors", "config", "records"},
    "stream": {"errors", "config", "records", "pack"},
    "serve": {"errors", "config", "records", "pack", "stream"},
    "export": LEAVES | {"scene", "render", "model", "pack"},
    "evaluate": LEAVES | {"scene", "render", "model", "train", "pack", "stream", "export"},
    "baselines": LEAVES | {"scene", "render", "model", "train", "pack", "evaluate"},
}
FREE_OF_TORCH = {"errors", "config", "records", "scene", "pack", "stream", "serve"}
MODULES = sorted(SOURCE.rglob("*.py"))
PYTHON = sorted([*MODULES, *(ROOT / "tests").rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")])
NATIVE = sorted([*SOURCE.rglob("*.cpp"), *SOURCE.rglob("*.hpp")])


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


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_a_room_imports_only_what_stands_before_it(path: Path) -> None:
    room = room_of(path)
    if room in {"cli", "__init__", "__main__"}:
        return
    rooms = {n.split(".")[1] for n in imported_names(path) if n.startswith("gsynopsis.")}
    rooms -= {"__version__"}
    assert rooms - {room} <= MAY_IMPORT[room], f"{room} must not import {rooms}"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_scene_pack_and_stream_live_without_torch(path: Path) -> None:
    if room_of(path) in FREE_OF_TORCH:
        assert not {n for n in imported_names(path) if n.split(".")[0] == "torch"}


@pytest.mark.parametrize("path", [*PYTHON, *NATIVE], ids=lambda p: str(p.relative_to(ROOT)))
def test_files_have_at_most_400_lines(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 400


@pytest.mark.parametrize("path", PYTHON, ids=lambda p: str(p.relative_to(ROOT)))
def test_functions_have_at_most_50_lines(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            assert lines <= 50, f"{node.name} has {lines} lines"


def test_no_module_is_named_after_a_drawer() -> None:
    drawers = {"utils", "util", "helpers", "helper", "misc", "common"}
    assert not [p for p in PYTHON if p.stem in drawers or p.stem.endswith("utils")]
