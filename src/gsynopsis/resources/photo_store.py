"""Store of a training's decoded photos: memory, or files where they are too many."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from gsynopsis.errors import SettingError
from gsynopsis.evaluation.formatting import memory
from gsynopsis.files import inner_folder
from gsynopsis.scene.photo_files import PhotoStore
from gsynopsis.training.context import TrainContext
from gsynopsis.training.regularize.jitter import photo_bytes

PHOTOS = "photos"
"""Folder in a run's: decoded photos, until it is finished."""


@contextmanager
def photo_store(
    context: TrainContext, out: Path, folder: Path | None, tell: Callable[[str], None]
) -> Generator[Callable[[], None]]:
    """Within it the scene's photos come from files, if they are too many for memory.

    Args:
        context: Of the training; its scene's cache says how much memory there is for photos.
        out: Folder of the run.
        folder: Where all decoded photos are kept, for other trainings too; None: only those of this
            training, where they do not fit into memory.
        tell: Told why files are not used, if they should be.

    Yields:
        What removes the files of this run, once it is finished; those of `folder` stay.

    Raises:
        SettingError: `folder` cannot be made.
    """
    cache, size = context.scene.cache, photo_bytes(context.scene, context.config)
    if folder is None and size <= cache.budget:
        yield lambda: None
        return

    def failed(error: OSError) -> None:
        tell(
            f"note: {memory(size)} of decoded photos cannot be kept in {folder or out / PHOTOS}: "
            f"{error.strerror}; those that are missing are decoded each time, which takes longer"
        )

    try:
        store = PhotoStore(folder or inner_folder(out, PHOTOS), failed)
    except ValueError as error:  # a NUL in its name
        expected = "the name of a folder"
        raise SettingError("--cache", found=ascii(str(folder)), expected=expected) from error
    except OSError as error:
        if folder is not None:
            wanted = "a folder that can be made"
            raise SettingError(
                "--cache", found=f"{folder}: {error.strerror}", expected=wanted
            ) from error
        failed(error)
        yield lambda: None
        return
    before, cache.store = cache.store, store
    try:
        yield lambda: None if folder else store.remove()
    finally:
        cache.store = before
        store.close()
