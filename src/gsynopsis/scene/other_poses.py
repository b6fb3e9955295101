"""Poses that other programs left beside photos: those that are read, and those that are named."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gsynopsis.scene.account import listed
from gsynopsis.scene.search import PHOTO_FOLDERS, has_poses

HEAD = 4096
"""First bytes of a file, by which it is recognised."""
MESHROOM = "export COLMAP's model with Meshroom's node ExportColmap"
ALONE = "to use them, take the other poses away"
NERFSTUDIO = "convert it with nerfstudio's ns-process-data"


@dataclass(frozen=True)
class Format:
    """Files of poses that a program writes.

    Attributes:
        program: Its name.
        name: Pattern of the whole file name, lower case.
        begins: Pattern in its first bytes; None: the name says enough.
        advice: What makes poses of it that are read.
        read: `programs` reads it, where no model and no transforms.json is there.
    """

    program: str
    name: str
    advice: str
    begins: bytes | None = None
    read: bool = False


FORMATS = (
    Format(
        "Metashape",
        r".*\.xml",
        ALONE,
        rb"<document[\s>](?s:.*)<chunk[\s>]",
        read=True,
    ),
    Format("Metashape", r".*\.psx|.*\.psz", "export cameras as Colmap (*.txt) there"),
    Format("ContextCapture", r".*\.xml", "export COLMAP's model there", rb"<BlocksExchange[\s>]"),
    Format("Meshroom", r".*\.sfm|(cameras|sfm)\.abc", MESHROOM),
    Format("Meshroom", r".*\.json", MESHROOM, rb'"featuresFolders"|"intrinsicId"|"poseId"'),
    Format("OpenMVG", r"sfm_data.*\.(json|bin)", "export COLMAP's model there"),
    Format(
        "OpenSfM",
        r".*\.json",
        ALONE,
        rb'"shots"\s*:|^\s*\[\s*\{\s*"cameras"\s*:',
        read=True,
    ),
    Format("LLFF", r"poses_bounds.*\.npy", "give COLMAP's sparse/0 that it was made of"),
    Format("IDR or NeuS", r"cameras(_.*)?\.npz", "give COLMAP's sparse/0 that it was made of"),
    Format(
        "RealityCapture",
        r".*\.csv",
        ALONE,
        rb"(?i)\A(\xef\xbb\xbf)?(#?\s*cameras.*\n)?"
        rb"(#?\s*(image_?|file_?)?name\s*[,;]\s*x|[^,;\n]+\.(jpe?g|png|tiff?)[,;]\s*[-\d])",
        read=True,
    ),
    Format("RealityCapture", r".*\.xmp", "export COLMAP's model there", rb"xcr:Position"),
    Format("Bundler", r"bundle.*\.out", "export COLMAP's model", rb"^# Bundle file"),
    Format("VisualSFM", r".*\.nvm", "export COLMAP's model", rb"^NVM_V"),
    Format("Pix4D", r".*calibrated_external_camera_parameters.*\.txt", "export COLMAP's model"),
    Format("Polycam", r"mesh_info\.json", f"{NERFSTUDIO} polycam"),
    Format("Record3D", r"metadata(\.json)?", f"{NERFSTUDIO} record3d", rb'"poses"\s*:'),
    Format("a tracker", r"(.*[_.-])?(poses?|trajectory|traj|groundtruth)\.txt", "make a model"),
)


def pose_files(root: Path, photos: Path) -> list[tuple[str, Path]]:
    """Program and path of each file of poses that `programs` reads, in a fixed order."""
    known = [(known.program, path) for known, path in _files(root, photos) if known.read]
    return sorted(known, key=lambda one: (len(one[1].parts), one[1]))


def other_poses(root: Path, photos: Path, *, read: bool = False) -> tuple[str, ...]:
    """A phrase for each program whose poses lie in a scene's folder, or among its photos.

    Args:
        root: The scene's folder.
        photos: Its folder of photos, perhaps the same.
        read: Without those that `programs` reads.
    """
    found: dict[Format, list[str]] = {}
    for known, path in _files(root, photos):
        if not (read and known.read):
            found.setdefault(known, []).append(path.relative_to(root).as_posix())
    return tuple(
        f"poses of {known.program} are not read ({listed(sorted(names))}): {known.advice}"
        for known, names in found.items()
    )


def _files(root: Path, photos: Path) -> Iterator[tuple[Format, Path]]:
    places = (root, root / "opensfm", root / "keyframes", photos)
    for folder in dict.fromkeys(place for place in places if place.is_dir()):
        for path in folder.iterdir():
            known = next((each for each in FORMATS if _matches(each, path)), None)
            if known:
                yield known, path


def models_above(folder: Path) -> tuple[str, ...]:
    """A phrase where a folder of photos lies in a scene with poses, which should be given."""
    above = folder.resolve().parent
    if folder.name not in PHOTO_FOLDERS:
        return ()
    said = f"the folder above has poses that are not read: give {above}"
    return (said,) if has_poses(above) else ()


def _matches(known: Format, path: Path) -> bool:
    if not re.fullmatch(known.name, path.name.lower()) or not path.is_file():
        return False
    if known.begins is None:
        return True
    try:
        with path.open("rb") as file:
            return re.search(known.begins, file.read(HEAD)) is not None
    except OSError:
        return False
