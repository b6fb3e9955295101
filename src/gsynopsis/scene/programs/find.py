"""The poses of another program that a scene's folder is read by."""

from pathlib import Path

from gsynopsis.errors import SceneError
from gsynopsis.scene.account import listed
from gsynopsis.scene.other_poses import pose_files
from gsynopsis.scene.programs.metashape import read_metashape
from gsynopsis.scene.programs.opensfm import read_opensfm
from gsynopsis.scene.programs.posed_photos import PhotosByLabel, Poses, records_of
from gsynopsis.scene.programs.realitycapture import read_realitycapture
from gsynopsis.scene.search import photo_folder
from gsynopsis.scene.views import SceneRecords


def find_program(root: Path) -> tuple[SceneRecords | None, tuple[str, ...]]:
    """The scene of the file with most photos, and a phrase on each other one that could be.

    None where no file places two photos of the folder; then every phrase says why.

    Args:
        root: The scene's folder.
    """
    files = pose_files(root, photo_folder(root))
    if not files:
        return None, ()
    found, phrases, photographs = list[SceneRecords](), list[str](), PhotosByLabel(root)
    for program, path in files:
        name = path.relative_to(root).as_posix()
        try:
            records = records_of(root, _read(program, path, photographs), photographs)
        except SceneError as error:
            phrases.append(f"poses of {program} are not read ({name}): {error}")
            continue
        if len(records.views) >= 2:
            found.append(records)
            continue
        left = [f"{len(n)} {why} ({listed(n)})" for why, n in records.account.left_out.items()]
        count = f"{len(records.views)} photos have poses in it"
        phrases.append(f"poses of {program} are not read ({name}): {', '.join([count, *left])}")
    if not found:
        return None, tuple(phrases)
    best = max(found, key=lambda records: len(records.views))
    for other in found:
        if other is not best:
            advice = f"to use it, take {best.account.source} away"
            count = f"{other.account.source} with {len(other.views)} photos"
            phrases.append(f"{count} is not read: {advice}")
    return best, tuple(phrases)


def _read(program: str, path: Path, photographs: PhotosByLabel) -> Poses:
    if program == "Metashape":
        return read_metashape(path)
    if program == "OpenSfM":
        return read_opensfm(path)
    return read_realitycapture(path, photographs)
