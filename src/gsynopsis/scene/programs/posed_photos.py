"""Photos with poses of another program → a `SceneRecords`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.scene.account import Account
from gsynopsis.scene.camera import nearest_rotation
from gsynopsis.scene.colmap.model import LARGEST, NO_POINTS, Pinhole
from gsynopsis.scene.photos import is_photo
from gsynopsis.scene.ply import read_ply
from gsynopsis.scene.search import files_in, folded, photo_folder, unused_files
from gsynopsis.scene.views import LOST, MISSING, UNPOSED, SceneRecords, View, view_of

POINTS = "points3D.ply"
"""Points beside poses that have none, in the same world."""
MOST_BYTES = 1 << 28
"""Most bytes of a file of poses; OpenSfM's holds the points too, some 150 bytes each."""
RIGID = 1e-3
"""Largest distance of RᵀR from the identity in any element; it is then brought to a rotation."""


@dataclass(frozen=True)
class PosedPhoto:
    """A photo as another program places it.

    Attributes:
        label: Its file name, perhaps without the ending or with folders of another machine.
        camera: Its intrinsics; None where the program has none that can be used.
        w2c: World to camera, OpenCV axes, [4, 4]; not finite where the pose was lost.
        field: The camera in the file, for messages.
    """

    label: str
    camera: Pinhole | None
    w2c: NDArray[np.float64]
    field: str = "camera"


@dataclass(frozen=True)
class Poses:
    """Contents of a file of poses.

    Attributes:
        path: The file.
        photos: In any order.
        points: Sparse points, float64 [P, 3], world units, and their colours, uint8 [P, 3].
        notes: Sentences on what was assumed.
        beside: Phrases on what of the file is not read.
        unknown: Labels whose camera model is not read, by the model's name.
    """

    path: Path
    photos: tuple[PosedPhoto, ...]
    points: tuple[NDArray[np.float64], NDArray[np.uint8]] = NO_POINTS
    notes: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    unknown: tuple[tuple[str, str], ...] = ()


class PhotosByLabel:
    """The photos of a scene's folder by the labels that programs give them."""

    def __init__(self, root: Path) -> None:
        """Looks through the folder of photos once."""
        self.folder = photo_folder(root)
        self._names: dict[str, list[Path]] = {}
        inside = self.folder.iterdir() if self.folder == root else files_in(self.folder)
        for path in filter(is_photo, inside):
            for key in {folded(path.name), folded(path.stem)}:
                self._names.setdefault(key, []).append(path)

    def find(self, label: str) -> Path | None:
        """The photo that a label means; None if there is none, or more than one."""
        parts = label.replace("\\", "/").split("/")
        found = self._names.get(folded(parts[-1]), [])
        if len(found) > 1:  # folders tell photos of one name apart
            ends = [f"/{folded('/'.join(parts[-n:]))}" for n in range(len(parts), 1, -1)]
            longer = [[p for p in found if folded(p.as_posix()).endswith(end)] for end in ends]
            found = next((some for some in longer if some), found)
        return found[0] if len(found) == 1 else None


def records_of(root: Path, poses: Poses, photographs: PhotosByLabel) -> SceneRecords:
    """The scene of poses and the photos in its folder `root`.

    Photos without a finite pose, a known camera or a file are left out.

    Raises:
        SceneError: a lens folds over within its photo, a pose is not rigid, or a photo is damaged.
    """
    views, used = list[View](), list[Path]()
    lost, missing = list[str](), list[str]()
    unknown: dict[str, list[str]] = {}
    for label, model in poses.unknown:
        unknown.setdefault(f"with a camera that is not read ({model})", []).append(label)
    for photo in poses.photos:
        path = photographs.find(photo.label)
        if path is None:
            missing.append(photo.label)
            continue
        used.append(path)
        if photo.camera is None or not np.isfinite(photo.w2c).all():
            lost.append(photo.label)
            continue
        name = path.relative_to(photographs.folder).as_posix()
        w2c = _rigid(poses.path, photo)
        views.append(view_of(poses.path, photo.field, (name, path), photo.camera, w2c))
    left = [path for label, _ in poses.unknown if (path := photographs.find(label)) is not None]
    rest = unused_files(root, [photographs.folder], [*used, *left], photographs.folder)
    account = Account(source=poses.path.relative_to(root).as_posix(), unread=rest.endings)
    account = account.without(LOST, lost).without(MISSING, missing).without(UNPOSED, rest.photos)
    for reason, labels in unknown.items():
        account = account.without(reason, labels)
    account = account.with_unread_models(*poses.beside)
    points, colors = poses.points
    if not len(points) and (root / POINTS).is_file():
        points, colors = read_ply(root / POINTS)
    return SceneRecords(
        poses.path, tuple(views), points, colors, notes=poses.notes, account=account
    )


def _rigid(path: Path, photo: PosedPhoto) -> NDArray[np.float64]:
    """The pose with its rotation free of rounding."""
    w2c = photo.w2c.copy()
    nearest, off = nearest_rotation(w2c[:3, :3], RIGID)
    if nearest is None or not (np.abs(w2c) < LARGEST).all():
        wanted = "a rigid pose (a rotation, no scale)"
        raise SceneError(path, photo.field, found=f"RᵀR off by {off:.3g}", expected=wanted)
    w2c[:3, :3] = nearest
    return w2c
