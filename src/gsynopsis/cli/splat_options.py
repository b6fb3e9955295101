"""Options that commands on finished splats share."""

from pathlib import Path
from typing import Annotated, TypeAlias

from tyro.conf import arg

from gsynopsis.cli.defaults import said
from gsynopsis.errors import SettingError
from gsynopsis.formats.axes import Up, parse_up

AskedUp: TypeAlias = Annotated[
    tuple[str, ...] | None, arg(metavar="X Y Z|AXIS"), said("as the file says, else found")
]
AskedCameras: TypeAlias = Annotated[
    Path | None, arg(metavar="FILE|FOLDER"), said("those beside the file, else found")
]


def asked_up(words: tuple[str, ...] | None) -> Up | None:
    """The direction that `--up` names; None where it was not given.

    Raises:
        SettingError: it is none.
    """
    if words is None:
        return None
    up = parse_up(" ".join(words))
    if up is None:
        expected = "three numbers, not all 0, or an axis as +z or -y"
        raise SettingError("--up", found=" ".join(words), expected=expected)
    return up
