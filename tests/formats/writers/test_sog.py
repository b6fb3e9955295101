"""SOG as our reader and gaussforge's read it back."""

import io
import json
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers import sog
from gsynopsis.formats.writers.packed import neighbours
from gsynopsis.formats.writers.sog import sog_bytes
from gsynopsis.records import PlainGaussians
from tests.formats.scattered import scattered


def reread(gaussians: PlainGaussians, folder: Path) -> PlainGaussians:
    path = folder / "a.sog"
    path.write_bytes(sog_bytes(gaussians))
    return read_splats(path).levels[-1]


def test_gaussians_come_back_in_morton_order(tmp_path: Path) -> None:
    gaussians = scattered(500)
    order = neighbours(gaussians.means)
    found = reread(gaussians, tmp_path)
    assert np.allclose(found.means, gaussians.means[order], atol=1e-3)
    assert np.allclose(found.log_scales, gaussians.log_scales[order], atol=0.03)
    opacity, wanted = (1 / (1 + np.exp(-x)) for x in (found.logits, gaussians.logits[order]))
    assert np.allclose(opacity, wanted, atol=0.003)
    wanted = gaussians.quaternions[order]
    wanted = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
    assert float(np.abs((found.quaternions * wanted).sum(axis=1)).min()) > 0.9999
    assert np.allclose(found.sh, gaussians.sh[order], atol=0.05)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_every_degree_is_written(degree: int, tmp_path: Path) -> None:
    gaussians = scattered(100)
    gaussians = replace(gaussians, sh=gaussians.sh[:, : (degree + 1) ** 2])
    found = reread(gaussians, tmp_path)
    assert found.sh.shape == gaussians.sh.shape
    assert np.allclose(found.sh, gaussians.sh[neighbours(gaussians.means)], atol=0.05)


def test_one_and_antialiased_ones_are_written(tmp_path: Path) -> None:
    assert len(reread(scattered(1), tmp_path)) == 1
    path = tmp_path / "b.sog"
    path.write_bytes(sog_bytes(scattered(5), antialiased=True))
    assert read_splats(path).antialiased


def test_gaussforge_reads_the_same_places() -> None:
    gaussforge = pytest.importorskip("gaussforge", reason="gaussforge is not installed")
    gaussians = scattered(300)
    read = gaussforge.GaussForge().read(sog_bytes(gaussians), "sog")
    assert "error" not in read
    means = np.frombuffer(read["data"]["positions"], np.float32).reshape(-1, 3)
    distances = np.abs(means[:, None] - gaussians.means[None]).max(axis=2)
    assert len(means) == 300 and float(distances.min(axis=1).max()) < 0.01


def test_many_harmonics_share_centroids_and_take_seconds(tmp_path: Path) -> None:
    """gaussforge does not end within minutes beyond 65,536 splats."""
    count, rng = 70_000, np.random.default_rng(0)
    kinds = 0.3 * rng.standard_normal((200, 15, 3))
    rest = kinds[rng.integers(200, size=count)] + 0.01 * rng.standard_normal((count, 15, 3))
    sh = np.concatenate([rng.standard_normal((count, 1, 3)), rest], axis=1).astype(np.float32)
    few = scattered(7)
    rows = np.arange(count) % 7
    many = PlainGaussians(
        rng.standard_normal((count, 3)).astype(np.float32),
        few.log_scales[rows],
        few.quaternions[rows],
        few.logits[rows],
        sh,
    )
    started = time.process_time()
    found = reread(many, tmp_path)
    assert time.process_time() - started < 60
    away = found.sh - many.sh[neighbours(many.means)]
    assert float(np.square(away[:, 1:]).mean() ** 0.5) < 0.02
    with zipfile.ZipFile(tmp_path / "a.sog") as bundle:
        meta = json.loads(bundle.read("meta.json"))
        with Image.open(io.BytesIO(bundle.read("shN_centroids.webp"))) as image:
            assert image.size == (64 * 15, meta["shN"]["count"] / 64)
    assert meta["shN"]["count"] == 32768


def test_a_palette_larger_than_few_splats_ask_for_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """splat-transform has 65,536 centroids from as many splats on: more pixels than these."""
    monkeypatch.setattr(sog, "SHARE", 1)
    count, rng = 5000, np.random.default_rng(0)
    few = scattered(1)
    noise = PlainGaussians(
        rng.standard_normal((count, 3)).astype(np.float32),
        np.repeat(few.log_scales, count, axis=0),
        np.repeat(few.quaternions, count, axis=0),
        np.zeros(count, np.float32),
        rng.standard_normal((count, 16, 3)).astype(np.float32),
    )
    with zipfile.ZipFile(io.BytesIO(sog_bytes(noise))) as bundle:
        size = bundle.getinfo("shN_centroids.webp").file_size
    assert size > 8 * (2 * count + 8192), "not larger than other images may be"
    assert len(reread(noise, tmp_path)) == count
