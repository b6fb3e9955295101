"""Masks of photos without poses."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from gsynopsis.capture.photo_set import PhotoSet
from gsynopsis.scene.masks import (
    MaskFolder,
    check_mask_shape,
    mask_beside,
    mask_folders,
    no_mask,
    no_masks,
)
from gsynopsis.scene.stored import read_header


def gathered_with_masks(root: Path, gathered: PhotoSet, *, alpha: bool = False) -> PhotoSet:
    """Photos without poses, with the masks that lie in their folder or the scene's.

    Args:
        root: The scene's folder.
        gathered: The photos.
        alpha: Photos with an alpha channel are their own masks instead.

    Raises:
        SceneError: A mask is unreadable or of another shape than its photo as people see it; or
            there is a folder of masks, and none is of any photo.
    """
    if alpha:
        own = {p.name: p.path for p in gathered.photos if read_header(p.path).alpha}
        if not own:
            raise no_masks(root, "alpha")
        count = f"{len(own)} of {len(gathered.photos)} photos, their alpha channels"
        return replace(gathered, masks=own, account=replace(gathered.account, masks=count))
    folders = [
        *mask_folders(root),
        *(mask_folders(gathered.folder) if gathered.folder != root else ()),
    ]
    found = dict[str, Path]()
    if not folders:
        beside = {photo.name: mask_beside(photo.path) for photo in gathered.photos}
        return _with(gathered, {n: m for n, m in beside.items() if m}, "beside the photos", [])
    masks = MaskFolder(folders[0])
    for photo in gathered.photos:
        mask = masks.find(photo.path.relative_to(gathered.folder).as_posix())
        if mask is not None:
            found[photo.name] = mask
    if not found:
        raise no_mask(folders[0], gathered.photos[0].name)
    return _with(gathered, found, f"in {folders[0].name}/", folders[1:])


def _with(
    gathered: PhotoSet, masks: Mapping[str, Path], source: str, unread: Sequence[Path]
) -> PhotoSet:
    if not masks:
        return gathered
    for photo in gathered.photos:
        if photo.name in masks:
            check_mask_shape(masks[photo.name], photo.size)
    beside = (f"{folder.name}/ is not read" for folder in unread)
    account = gathered.account.with_unread_models(*beside)
    account = replace(account, masks=f"{len(masks)} of {len(gathered.photos)} photos, {source}")
    return replace(gathered, masks=masks, account=account)
