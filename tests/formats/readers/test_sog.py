"""SOG by hand: a file of one of ours comes back, and what is not one is refused by field."""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers.sog import sog_bytes
from tests.formats.scattered import scattered

COUNT = 60


@pytest.fixture(scope="module")
def whole() -> bytes:
    return sog_bytes(scattered(COUNT))


def folder_of(data: bytes, path: Path, **changed: Any) -> Path:
    """The files of a bundle in a folder, with other values in its `meta.json`."""
    with zipfile.ZipFile(io.BytesIO(data)) as bundle:
        bundle.extractall(path)
    meta = json.loads((path / "meta.json").read_text())
    (path / "meta.json").write_text(json.dumps(meta | changed))
    return path / "meta.json"


def test_a_folder_holds_what_its_bundle_does(whole: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.sog").write_bytes(whole)
    bundled = read_splats(tmp_path / "a.sog")
    found = read_splats(folder_of(whole, tmp_path / "a"))
    assert bundled.kind == found.kind == "SOG" and len(found.levels[0]) == COUNT
    for name, values in vars(found.levels[0]).items():
        assert np.array_equal(values, getattr(bundled.levels[0], name)), name
    # Order is the writer's: the same positions, within 16 bits of the logarithm.
    given = np.sort(scattered(COUNT).means, axis=0)
    assert np.allclose(np.sort(found.levels[0].means, axis=0), given, atol=2e-3)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"version": 7}, "version"),
        ({"version": True}, "version"),
        ({"count": "many"}, "count"),
        ({"count": 10**12}, "count"),
        ({"count": 100_000}, "about 100,000 pixels"),
        ({"means": None}, "that of a SOG"),
    ],
)
def test_a_meta_that_cannot_be_is_refused_by_field(
    whole: bytes, tmp_path: Path, changed: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_splats(folder_of(whole, tmp_path, **changed))
    assert words in str(caught.value)


def test_a_picture_that_is_missing_or_none_is_named(whole: bytes, tmp_path: Path) -> None:
    meta = folder_of(whole, tmp_path)
    quats = json.loads(meta.read_text())["quats"]["files"][0]
    (tmp_path / quats).write_bytes(b"RIFF")
    with pytest.raises(InputError, match=quats):
        read_splats(meta)
    (tmp_path / quats).unlink()
    with pytest.raises(InputError):
        read_splats(meta)
