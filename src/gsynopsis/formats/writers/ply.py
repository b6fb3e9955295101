"""PLY as 3DGS writes it: binary little-endian, float32 properties, values before activation."""

import numpy as np

from gsynopsis.formats.axes import DOWN, Up, nearest_axis, up_text
from gsynopsis.records import PlainGaussians

ANTIALIASED_COMMENT = "comment SplatRenderMode: mip"
"""By which Brush, Postshot and SuperSplat know Gaussians that are drawn antialiased."""


def ply_bytes(
    gaussians: PlainGaussians,
    *,
    antialiased: bool = False,
    up: Up = DOWN,
    shift: Up = (0.0, 0.0, 0.0),
) -> bytes:
    """A PLY file of Gaussians: one element `vertex`, normals as zeros as in 3DGS.

    Args:
        gaussians: May be none; the file's coefficients go red first, then green, then blue.
        antialiased: Say that they are to be drawn antialiased.
        up: Away from the ground; said where its nearest axis is not the usual one.
        shift: Added to positions, which are doubles then.
    """
    coefficients = gaussians.sh.shape[1]
    names = property_names(coefficients)
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [ANTIALIASED_COMMENT] if antialiased else []
    lines += up_comments(up)
    kinds = ["double" if any(shift) and name in "xyz" else "float" for name in names]
    rows = [f"property {kind} {name}" for kind, name in zip(kinds, names, strict=True)]
    lines += [f"element vertex {len(gaussians)}", *rows]
    header = "\n".join([*lines, "end_header", ""]).encode()
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(len(gaussians), 3 * (coefficients - 1))
    columns = (
        np.zeros_like(gaussians.means),
        gaussians.sh[:, 0],
        rest,
        gaussians.logits[:, None],
        gaussians.log_scales,
        gaussians.quaternions,
    )
    values = np.concatenate(columns, axis=1, dtype="<f4")
    if not any(shift):
        return header + np.concatenate([gaussians.means, values], axis=1, dtype="<f4").tobytes()
    table = np.empty(len(gaussians), [("place", "<f8", 3), ("rest", "<f4", values.shape[1])])
    table["place"], table["rest"] = gaussians.means.astype(np.float64) + shift, values
    return header + table.tobytes()


def up_comments(up: Up) -> list[str]:
    """The line of a header by which Brush, nerfstudio and we know up; none for that of 3DGS."""
    return [] if nearest_axis(up) == DOWN else [f"comment Vertical axis: {up_text(up)}"]


def property_names(coefficients: int) -> list[str]:
    """Names of the properties in the order of 3DGS, for `coefficients` coefficients a colour."""
    rest = [f"f_rest_{k}" for k in range(3 * (coefficients - 1))]
    turn = [f"rot_{k}" for k in range(4)]
    scale = [f"scale_{k}" for k in range(3)]
    first = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    return [*first, *rest, "opacity", *scale, *turn]
