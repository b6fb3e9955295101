"""The rooms have one-way doors."""

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import gsynopsis

SOURCE = Path(__file__).parent.parent / "src" / "gsynopsis"
ROOT = SOURCE.parent.parent
LEAVES = {"errors", "files", "interrupt", "config", "records", "_native"}
CODED = LEAVES | {"container", "stream"}
SHOWN = CODED | {"formats", "scene", "render", "model"}
TRAINED = SHOWN | {"training", "evaluation", "cameras"}
MAY_IMPORT = {
    "errors": set(),
    "files": {"errors"},
    "interrupt": set(),
    "config": {"errors"},
    "records": {"errors"},
    "_native": {"errors"},
    "formats": {"errors", "files", "records"},
    "scene": LEAVES,
    "capture": LEAVES | {"scene"},
    "synthetic": LEAVES | {"scene"},
    "render": LEAVES | {"scene"},
    "model": LEAVES | {"scene", "render"},
    "container": LEAVES - {"_native"},
    "stream": LEAVES - {"_native"} | {"container"},
    "serve": LEAVES - {"_native"} | {"container", "stream"},
    "training": LEAVES | {"scene", "render", "model"},
    "evaluation": SHOWN,
    "cameras": SHOWN | {"capture"},
    "teacher": SHOWN | {"evaluation"},
    "runs": SHOWN | {"evaluation", "cameras", "serve"},
    "resources": SHOWN | {"training", "evaluation"},
    "playback": SHOWN | {"evaluation", "cameras"},
    "monitor": TRAINED | {"serve"},
    "jobs": TRAINED | {"capture", "runs", "resources", "playback", "monitor", "teacher"},
    "selftest": TRAINED | {"synthetic", "runs", "jobs"},
    "cli": TRAINED
    | {"capture", "synthetic", "serve", "runs", "resources", "playback", "monitor", "jobs"}
    | {"selftest"},
    "__init__": TRAINED | {"synthetic", "runs", "jobs"},
    "__main__": {"_native", "cli"},
}
FREE_OF_TORCH = {
    *("errors", "files", "interrupt", "config", "records", "formats", "scene", "capture"),
    *("synthetic", "container", "stream", "serve"),
}
AROUND = ("tests", "benchmarks", "research")
MODULES = sorted(SOURCE.rglob("*.py"))
PYTHON = sorted(
    [*MODULES, *(path for name in AROUND for path in (ROOT / name).rglob("*.py"))],
)


def room_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


@cache
def imports_of(path: Path) -> list[ast.Import | ast.ImportFrom]:
    tree = ast.parse(path.read_text())
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


@cache
def imported_names(path: Path) -> set[str]:
    names: set[str] = set()
    for node in imports_of(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    return names


def test_every_room_that_may_be_imported_is_there() -> None:
    assert {room_of(path) for path in MODULES} == set(MAY_IMPORT)
    assert set().union(*MAY_IMPORT.values()) <= set(MAY_IMPORT)


def test_a_room_imports_only_what_stands_before_it() -> None:
    wrong: dict[str, set[str]] = {}
    for path in MODULES:
        room = room_of(path)
        rooms = {n.split(".")[1] for n in imported_names(path) if n.startswith("gsynopsis.")}
        beyond = rooms - {"__version__", room} - MAY_IMPORT[room]
        if beyond:
            wrong[str(path.relative_to(SOURCE))] = beyond
    assert wrong == {}


def test_rooms_that_only_read_and_stream_live_without_torch() -> None:
    free = [path for path in MODULES if room_of(path) in FREE_OF_TORCH]
    assert len(free) > 100
    assert not [p for p in free if {n for n in imported_names(p) if n.split(".")[0] == "torch"}]


def module_of(path: Path) -> str:
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_modules(path: Path, modules: set[str]) -> set[str]:
    """Modules that a module imports anywhere, also late and for types alone."""
    found: set[str] = set()
    for node in imports_of(path):
        if isinstance(node, ast.ImportFrom) and node.module:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= inner & modules or {node.module}
    return found & modules


def test_modules_import_each_other_in_no_circle_types_included() -> None:
    modules = {module_of(path): path for path in MODULES}
    left = {name: imported_modules(path, modules.keys() - {name}) for name, path in modules.items()}
    del left["gsynopsis"]  # its names are loaded when they are first used
    for name in left:
        left[name].discard("gsynopsis")
    while free := {name for name, wants in left.items() if not wants & left.keys()}:
        for name in free:
            del left[name]
    wanted = set().union(*left.values())
    assert {name: wants & left.keys() for name, wants in left.items() if name in wanted} == {}


def test_the_product_knows_nothing_of_research() -> None:
    for path in MODULES:
        assert not {n for n in imported_names(path) if n.split(".")[0] == "research"}, path


def test_no_folder_has_more_than_25_source_files() -> None:
    folders = Counter(path.parent for path in MODULES)
    assert {folder: count for folder, count in folders.items() if count > 25} == {}


def test_no_room_has_the_name_of_a_public_function() -> None:
    """An import of a room would hide the function behind the module."""
    assert not set(gsynopsis.__all__) & set(MAY_IMPORT)


def test_no_module_is_named_after_a_drawer() -> None:
    drawers = {"utils", "util", "helpers", "helper", "misc", "common"}
    assert not [p for p in PYTHON if p.stem in drawers or p.stem.endswith("utils")]


def test_modules_of_more_than_150_lines_have_a_test_file_of_their_name() -> None:
    tested = {path.stem.removeprefix("test_") for path in (ROOT / "tests").rglob("test_*.py")}
    long = [path for path in MODULES if len(path.read_text().splitlines()) > 150]
    assert len(long) > 60
    assert [str(path.relative_to(SOURCE)) for path in long if path.stem not in tested] == []
