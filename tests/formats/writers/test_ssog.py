"""Streamed SOG: the index promises what its specification asks for."""

import io
import json
import zipfile
from collections.abc import Iterator

import pytest

from gsynopsis.formats.writers import ssog
from gsynopsis.formats.writers.sog import zipped
from gsynopsis.formats.writers.ssog import INDEX, ssog_files
from tests.formats.scattered import scattered


def leaves(node: dict) -> Iterator[dict]:
    if "lods" in node:
        yield node
    for child in node.get("children", ()):
        assert all(a <= b for a, b in zip(node["bound"]["min"], child["bound"]["min"], strict=True))
        yield from leaves(child)


@pytest.mark.parametrize("leaf", [1 << 16, 40])
def test_each_lod_is_whole_and_the_finest_is_the_first(
    leaf: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ssog, "LEAF", leaf)
    levels = [scattered(n, degree=1, seed=n) for n in (20, 60, 200)]
    files = ssog_files(levels, [0.3, 0.1, 0.0])
    meta = json.loads(files[INDEX])
    assert meta["counts"] == [200, 60, 20] and meta["count"] == 280
    assert (meta["version"], meta["lodLevels"], meta["lodErrors"]) == (1, 3, True)
    totals = [0, 0, 0]
    for node in leaves(meta["tree"]):
        for lod, entry in node["lods"].items():
            stored = json.loads(files[meta["filenames"][entry["file"]]])
            assert (entry["offset"], entry["count"]) == (0, stored["count"])
            totals[int(lod)] += entry["count"]
        known = [node["errors"][int(lod)] for lod in sorted(node["lods"])]
        assert known == sorted(known) and known[0] == 0
    assert totals == meta["counts"]
    assert (len([*leaves(meta["tree"])]) > 1) == (leaf == 40)


def test_without_measured_errors_the_index_says_so() -> None:
    meta = json.loads(ssog_files([scattered(4)])[INDEX])
    assert meta["lodErrors"] is False and "errors" not in meta["tree"]


def test_the_bundle_holds_the_same_files() -> None:
    files = ssog_files([scattered(4), scattered(9)])
    with zipfile.ZipFile(io.BytesIO(zipped(files))) as archive:
        assert {name: archive.read(name) for name in archive.namelist()} == files
