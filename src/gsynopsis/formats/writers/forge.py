"""SPZ and SOG, which the library gaussforge writes from a PLY."""

from typing import Any, Literal

from gsynopsis.errors import GsynopsisError, MissingExtraError
from gsynopsis.formats.axes import half_turned
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.records import PlainGaussians

ForgeFormat = Literal["spz", "spz3", "sog"]
NAMES: dict[ForgeFormat, tuple[str, int]] = {
    "spz": ("spz", 4),
    "spz3": ("spz", 3),
    "sog": ("sog", 3),
}
"""Names of formats there, and the version of SPZ (which the others ignore)."""


def forge_bytes(gaussians: PlainGaussians, name: ForgeFormat) -> bytes:
    """A file in one of the library's formats; all of them round values and reorder Gaussians.

    Args:
        gaussians: At least one.
        name: Of the format.

    Raises:
        MissingExtraError: gaussforge is not installed.
        GsynopsisError: it refuses these Gaussians.
    """
    try:
        import gaussforge  # pyright: ignore[reportMissingTypeStubs]
    except ModuleNotFoundError as error:
        raise MissingExtraError("gaussforge", "export") from error
    theirs, version = NAMES[name]
    if theirs == "spz":
        # Files of SPZ have y up; gaussforge takes the values for what they are.
        gaussians = half_turned(gaussians)
    forge: Any = gaussforge.GaussForge()  # pyright: ignore[reportUnknownMemberType]
    made: dict[str, Any] = forge.convert(ply_bytes(gaussians), "ply", theirs, spz_version=version)
    if "error" in made:
        raise GsynopsisError(f"gaussforge cannot write {name}: {made['error']}")
    return bytes(made["data"])
