"""SPZ, which the library gaussforge writes from a PLY."""

from typing import Any, Literal

from gsynopsis.errors import GsynopsisError, MissingExtraError
from gsynopsis.formats.axes import half_turned
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.records import PlainGaussians

ForgeFormat = Literal["spz", "spz3"]
VERSIONS: dict[ForgeFormat, int] = {"spz": 4, "spz3": 3}


def forge_bytes(gaussians: PlainGaussians, name: ForgeFormat) -> bytes:
    """A file of SPZ; it rounds values and reorders Gaussians.

    Args:
        gaussians: At least one.
        name: Of the format's version.

    Raises:
        MissingExtraError: gaussforge is not installed.
        GsynopsisError: it refuses these Gaussians.
    """
    try:
        import gaussforge  # pyright: ignore[reportMissingTypeStubs]
    except ModuleNotFoundError as error:
        raise MissingExtraError("gaussforge", "export") from error
    # Files of SPZ have y up; gaussforge takes the values for what they are.
    made_from = ply_bytes(half_turned(gaussians))
    forge: Any = gaussforge.GaussForge()  # pyright: ignore[reportUnknownMemberType]
    made: dict[str, Any] = forge.convert(made_from, "ply", "spz", spz_version=VERSIONS[name])
    if "error" in made:
        raise GsynopsisError(f"gaussforge cannot write {name}: {made['error']}")
    return bytes(made["data"])
