"""PLY files hold every value, in the layout of 3DGS."""

import numpy as np
import pytest

from gsynopsis.formats.writers.ply import ANTIALIASED_COMMENT, ply_bytes, property_names
from tests.formats.scattered import scattered


def columns(data: bytes) -> tuple[str, dict[str, np.ndarray]]:
    """Header and values by property, read without our own code."""
    header, body = data.split(b"end_header\n", 1)
    names = [line.split()[-1] for line in header.decode().splitlines() if "property" in line]
    table = np.frombuffer(body, np.dtype([(name, "<f4") for name in names]))
    return header.decode(), {name: table[name] for name in names}


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_value_is_where_3dgs_has_it(degree: int) -> None:
    gaussians = scattered(degree=degree)
    header, found = columns(ply_bytes(gaussians))
    assert f"element vertex {len(gaussians)}" in header
    assert np.array_equal(found["y"], gaussians.means[:, 1])
    assert np.array_equal(found["opacity"], gaussians.logits)
    assert np.array_equal(found["scale_2"], gaussians.log_scales[:, 2])
    assert np.array_equal(found["rot_0"], gaussians.quaternions[:, 0])
    assert np.array_equal(found["f_dc_1"], gaussians.sh[:, 0, 1])
    rest = (degree + 1) ** 2 - 1
    for channel in range(3):
        for k in range(rest):
            stored = found[f"f_rest_{channel * rest + k}"]
            assert np.array_equal(stored, gaussians.sh[:, 1 + k, channel])


def test_no_gaussians_are_a_header_alone() -> None:
    header, found = columns(ply_bytes(scattered(0)))
    assert "element vertex 0" in header
    assert list(found) == property_names(16)


def test_a_comment_says_how_gaussians_are_drawn() -> None:
    plain, drawn = (ply_bytes(scattered(3), antialiased=flag) for flag in (False, True))
    assert ANTIALIASED_COMMENT.encode() not in plain
    assert ANTIALIASED_COMMENT.encode() in drawn.split(b"end_header")[0]
