"""The viewer's sources: folders that import one way, types too, and no circle of files."""

import re
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

from tests.viewer.node import HERE

SOURCES = HERE.parent.parent / "viewer" / "src"
ORDER = (
    "base", "format", "policy", "fetch", "decode", "camera", "render", "ui", "element", "engines",
    "entry",
)  # fmt: skip
"""A folder imports from itself and from those before it."""
FILES_MAX = 25
IMPORT = re.compile(r"(?:\bfrom|\bimport\()\s*[\"'](\.[^\"']+)[\"']")


def imports_of(path: Path) -> set[Path]:
    """The files that one names, for code or types."""
    found = {(path.parent / name).resolve() for name in IMPORT.findall(path.read_text("utf-8"))}
    return {place.with_name(f"{place.name}.ts") for place in found}


GRAPH = {path: imports_of(path) for path in sorted(SOURCES.rglob("*.ts"))}


def folder_of(path: Path) -> str:
    return path.relative_to(SOURCES).parts[0]


def test_every_import_is_a_file_that_is_there() -> None:
    missing = [(path.name, str(target)) for path in GRAPH for target in GRAPH[path] - set(GRAPH)]
    assert len(GRAPH) > 80 and not missing


def test_folders_import_one_way() -> None:
    assert {folder_of(path) for path in GRAPH} == set(ORDER)
    back = [
        f"{path.relative_to(SOURCES)} imports {target.relative_to(SOURCES)}"
        for path, targets in GRAPH.items()
        for target in targets
        if ORDER.index(folder_of(target)) > ORDER.index(folder_of(path))
    ]
    assert not back


def test_no_file_imports_itself_by_way_of_others() -> None:
    # CycleError names the circle.
    TopologicalSorter(GRAPH).prepare()


def test_a_folder_can_be_read_at_a_glance() -> None:
    counts = Counter(path.parent for path in GRAPH)
    assert max(counts.values()) <= FILES_MAX
