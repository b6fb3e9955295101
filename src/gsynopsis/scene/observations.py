"""Photos that really show a point: the tracks of a COLMAP model, or points that nothing hides."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.colmap.model import SparseModel
from gsynopsis.scene.colmap.read import read_sparse
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.search import find_models

MOST = 200_000
"""Most observations that are used; of more, those of every nth point."""
CELL_PIXELS = 16
"""Side of the squares within which the nearest points hide others."""
GRID_WIDTH = 256
"""Width of the image that is divided into these squares."""
BEHIND = 1.1
"""Times the depth of the nearest point in its square up to which a point counts as seen."""


@dataclass(frozen=True)
class Observations:
    """Points that training photos show.

    Attributes:
        places: Of points, float64 [P, 3], world units.
        views: Place in `scene.train` of each observation's photo, int64 [O].
        points: Row of its point, int64 [O].
    """

    places: NDArray[np.float64]
    views: NDArray[np.int64]
    points: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.views)

    def of(self, which: NDArray[np.bool_]) -> "Observations":
        """Those observations for which `which` [O] is true."""
        return Observations(self.places, self.views[which], self.points[which])


def observed(scene: Scene) -> Observations:
    """Observations of a scene's training photos: its tracks, else its front-most points."""
    tracked = [_tracked(scene, model) for model in _models(scene)]
    found = max(tracked, key=len, default=None)
    found = found if found is not None and len(found) else _front_most(scene)
    step = -(-len(found) // MOST)
    return found.of(found.points % step == 0) if step > 1 else found


def _models(scene: Scene) -> list[SparseModel]:
    """Sparse models whose images are views of the scene: that one which was read."""
    names, found = {view.name for view in scene.views}, list[SparseModel]()
    for folder in find_models(scene.root):
        try:
            model = read_sparse(folder)
        except SceneError:  # damaged: another one was read
            continue
        if {image.name for image in model.images} >= names:
            found.append(model)
    return found


def _tracked(scene: Scene, model: SparseModel) -> Observations:
    """Observations of training photos as tracks say them."""
    rows = {scene.views[view].name: row for row, view in enumerate(scene.train)}
    row_of = {image.number: rows.get(image.name, -1) for image in model.images}
    numbers, inverse = np.unique(model.tracks.images, return_inverse=True)
    views = np.array([row_of.get(int(number), -1) for number in numbers], np.int64)[inverse]
    places = model.points - np.array(scene.shift)
    return Observations(places, views, model.tracks.points).of(views >= 0)


def _front_most(scene: Scene) -> Observations:
    views, points = list[NDArray[np.int64]](), list[NDArray[np.int64]]()
    for row, view in enumerate(scene.train):
        shown = np.flatnonzero(front_most(scene.views[view].camera, scene.points))
        views.append(np.full(len(shown), row, np.int64))
        points.append(shown)
    return Observations(scene.points, np.concatenate(views), np.concatenate(points))


def front_most(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask of points [P, 3] in frame and hardly behind the nearest one around them, bool [P]."""
    small = camera.scaled(max(1.0, camera.width / GRID_WIDTH))
    framed = small.framed(points)
    across = small.width // CELL_PIXELS + 1
    cells = framed.rows // CELL_PIXELS * across + framed.columns // CELL_PIXELS
    nearest = np.full(int(cells.max(initial=0)) + 1, np.inf)
    np.minimum.at(nearest, cells, framed.depths)
    seen = framed.which.copy()
    seen[framed.which] = framed.depths <= BEHIND * nearest[cells]
    return seen
