"""Masks of photos without poses."""

from dataclasses import replace
from pathlib import Path

from gsynopsis.capture.photo_set import PhotoSet
from gsynopsis.scene.masks import MaskFolder, check_mask_shape, mask_folders, no_mask


def gathered_with_masks(root: Path, gathered: PhotoSet) -> PhotoSet:
    """Photos without poses, with the masks that lie in their folder or the scene's.

    Raises:
        SceneError: A mask is unreadable or of another shape than its photo as people see it; or
            there is a folder of masks, and none is of any photo.
    """
    folders = [
        *mask_folders(root),
        *(mask_folders(gathered.folder) if gathered.folder != root else ()),
    ]
    if not folders:
        return gathered
    masks, found = MaskFolder(folders[0]), dict[str, Path]()
    for photo in gathered.photos:
        mask = masks.find(photo.path.relative_to(gathered.folder).as_posix())
        if mask is not None:
            check_mask_shape(mask, photo.size)
            found[photo.name] = mask
    if not found:
        raise no_mask(folders[0], gathered.photos[0].name)
    count = f"{len(found)} of {len(gathered.photos)} photos, in {folders[0].name}/"
    beside = (f"{folder.name}/ is not read" for folder in folders[1:])
    account = replace(gathered.account.with_unread_models(*beside), masks=count)
    return replace(gathered, masks=found, account=account)
