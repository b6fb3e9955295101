"""Files that we write, as programs that are not ours read them."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.interop import readers
from benchmarks.interop.matrix import OPENED, SPZ
from gsynopsis.formats.axes import half_turned
from gsynopsis.formats.writers.ssog import INDEX, ssog_files
from gsynopsis.jobs.export import ENDINGS, Format, encoded
from gsynopsis.records import PlainGaussians
from tests.formats.scattered import scattered

pytest.importorskip("gaussforge", reason="gaussforge is not installed: nothing to read")

WITHOUT_BROWSER = ("splat-transform", "gaussforge", "gsply")
STEPS: dict[str, tuple[float, float, float]] = {
    "ply": (1e-6, 1e-6, 1e-6),
    "compressed-ply": (0.01, 0.02, 4 / 256 + 1e-6),
    "spz": (0.001, 0.07, 0.07),
    "spz3": (0.001, 0.07, 0.07),
    "sog": (0.01, 0.2, 0.6),
    "ssog": (0.01, 0.2, 0.6),
}
"""How far positions, logarithms of scales and harmonics may be off: what each format rounds to; SOG
takes the harmonics of few splats to a codebook."""


def file_of(gaussians: PlainGaussians, name: Format, folder: Path) -> Path:
    if name != "ssog":
        path = folder / f"a{ENDINGS[name]}"
        path.write_bytes(encoded(gaussians, name, False))
        return path
    files = ssog_files([scattered(40), gaussians], [1, 0])
    for inner, data in files.items():
        path = folder / inner
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
    return folder / INDEX


@pytest.mark.parametrize(
    ("reader", "name"), [(reader, name) for reader in WITHOUT_BROWSER for name in OPENED[reader]]
)
def test_other_programs_read_the_values_that_were_written(
    reader: str, name: Format, tmp_path: Path
) -> None:
    if lacking := readers.missing(reader):
        pytest.skip(f"no {lacking}: {reader} does NOT read {name} here")
    given = scattered(300)
    given.sh[:, 1:] *= 0.5  # SPZ holds harmonics from -1 to 1
    path = file_of(given, name, tmp_path)
    if reader == "splat-transform":
        found = readers.by_splat_transform(path, tmp_path)
    elif reader == "gsply":
        found = readers.by_gsply(path, name)
    else:
        found = readers.by_gaussforge(path, name, tmp_path)
    found = half_turned(found) if name in SPZ else found
    compare(given, found, STEPS[name])


def compare(
    given: PlainGaussians, found: PlainGaussians, steps: tuple[float, float, float]
) -> None:
    """Splats in any order have the values of those nearest to them."""
    assert len(found) == len(given)
    distances = np.linalg.norm(found.means[:, None] - given.means[None], axis=2)
    nearest = distances.argmin(axis=1)
    assert sorted(nearest) == list(range(len(given)))
    assert np.abs(found.means - given.means[nearest]).max() <= steps[0]
    assert np.abs(found.log_scales - given.log_scales[nearest]).max() <= steps[1]
    assert np.abs(found.sh[:, 1:] - given.sh[nearest, 1:]).max() <= steps[2]


def test_usd_core_reads_the_values_that_were_written(tmp_path: Path) -> None:
    if lacking := readers.missing("usd-core"):
        pytest.skip(f"no {lacking}: USD is NOT read")
    given = scattered(300)
    compare(given, readers.by_usd(file_of(given, "usd", tmp_path)), (1e-6, 1e-5, 1e-6))


def test_the_validator_of_gltf_finds_nothing_but_names_that_it_does_not_know(
    tmp_path: Path,
) -> None:
    if lacking := readers.missing("glTF-Validator"):
        pytest.skip(f"no {lacking}: GLB is NOT validated")
    report = readers.validated(file_of(scattered(300), "glb", tmp_path))
    assert report["info"]["totalVertexCount"] == 300
    codes = {message["code"] for message in report["issues"]["messages"]}
    assert codes == {"UNSUPPORTED_EXTENSION", "MESH_PRIMITIVE_INVALID_ATTRIBUTE"}
