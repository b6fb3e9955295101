"""Cameras for splats that come without photos: those that are given, else such as are found.

found = for_splats(read_splats(path), count=40)
found.cameras, found.up, found.lines
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gsynopsis.cameras.found import Search, upright
from gsynopsis.cameras.placement import lens_of, subject_of
from gsynopsis.cameras.sketch import OPAQUE, Sketcher, thinned
from gsynopsis.cameras.up import guesses, up_of_cameras
from gsynopsis.errors import InputError
from gsynopsis.formats.axes import Up, up_text
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.render.base import Renderer
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.camera import Camera

VIEWS_WIDTH = 480
"""Width of images from found cameras, pixels."""
ALMOST_ALL = 0.99
"""Share of splats that are faint in fog."""
DROPPED = 1 / 3
"""A larger share of found cameras that see too little says that the rest tell little."""
LITTLE, EMPTY = 0.01, 0.002
"""Least share of the scene's points that a camera sees, and of its picture that is filled."""


@dataclass(frozen=True)
class Viewpoints:
    """Cameras of a scene of splats.

    Attributes:
        cameras: Not empty. Found ones come best first: any number of the first see as much as so
            many can. Given ones come in their file's order.
        up: Away from the ground, unit length.
        given: They were given, not found.
        lines: Cameras and up that were taken, and by what evidence, in one line; before it a line
            for each thing that was passed over.
        doubt: Why pictures from these cameras tell little of the scene; empty if they do tell.
        fog: Splats are faint, and nothing is opaque from any place that was tried.
    """

    cameras: tuple[Camera, ...]
    up: Up
    given: bool
    lines: tuple[str, ...] = ()
    doubt: str = ""
    fog: bool = False


def for_splats(
    splats: SplatFile,
    up: Up | None = None,
    given: Sequence[Camera] | None = None,
    count: int = 40,
    width: int = VIEWS_WIDTH,
    *,
    given_by: str = "the caller",
    renderer: Renderer | None = None,
) -> Viewpoints:
    """Cameras for splats.

    Args:
        splats: The scene; its finest level counts.
        up: Away from the ground; None: as the file says, else as given cameras were held, else as
            found, see `up.guesses`.
        given: Cameras that are known, see `given.read_cameras`; None: cameras are found.
        count: Of found cameras; given ones are all taken.
        width: Of found cameras' pictures, pixels.
        given_by: Whence given cameras come, for messages.
        renderer: Draws small pictures; None: the CPU's.

    Raises:
        InputError: given cameras see nothing of the scene.
    """
    finest, renderer = splats.levels[-1], renderer or make_renderer("cpu")
    subject = subject_of(finest, splats.up if up is None else up, splats.environment)
    drawn = thinned(finest)
    sketcher = Sketcher(drawn, subject, renderer)
    evidence = "as asked for" if up is not None else "as the file says" if splats.up_said else ""
    if given is not None:
        return _given(given, given_by, sketcher, splats.up if up is None else up, evidence)
    lens, hint = lens_of(width), ""
    if not evidence:
        subject, best = upright(subject, sketcher, guesses(drawn, subject, splats.up), lens)
        evidence = f"assumed, by custom of {splats.kind} files"
        if (subject.up != splats.up).any():
            evidence = "by how surfaces of the scene lie"
            evidence += " and where its photos were taken from" if best.photos else ""
        elif (best.up != splats.up).any():
            a, b, c = best.up.round(3).tolist()
            hint = f"; the scene itself speaks a little more for {up_text((a, b, c))}"
    search = Search(subject, sketcher, lens)
    tries = search.tries()
    chosen = search.best_first(tries, search.chosen(tries, count))
    x, y, z = subject.up.tolist()
    dropped, doubt = count - len(chosen), ""
    if dropped > DROPPED * count:
        doubt = f"{dropped} of {count} made-up cameras show too little (too near, or nothing)"
    if not chosen:
        # Splats are ranked from somewhere all the same.
        chosen = np.linspace(0, len(tries) - 1, min(count, len(tries))).astype(int).tolist()
    line = f"no cameras were given: {len(chosen)} were found, of {len(tries)} tried"
    line = with_up(line, (x, y, z), evidence) + hint
    cameras = tuple(tries[row].camera for row in chosen)
    opacity = np.quantile(1 / (1 + np.exp(-finest.logits.astype(np.float64))), ALMOST_ALL)
    fog = bool(opacity < OPAQUE) and not any(each.sight.opaque for each in tries)
    return Viewpoints(cameras, (x, y, z), False, (line,), doubt, fog)


def with_up(line: str, up: Up, evidence: str) -> str:
    """A line on cameras, with the up that was taken and why."""
    return f"{line}; up is taken as {up_text(up)}, {evidence} (--up says another)"


def _given(
    given: Sequence[Camera], given_by: str, sketcher: Sketcher, up: Up, evidence: str
) -> Viewpoints:
    """Given cameras, if they see something of the scene."""
    some = given[:: max(1, len(given) // 24)]
    seen = [float(camera.framed(sketcher.points).which.mean()) for camera in some]
    filled = [sketcher.look(camera, 1.0).filled for camera in some]
    if max(seen) < LITTLE or max(filled) < EMPTY:
        found = f"nothing in view of {len(given)} cameras"
        advice = "give those from which this scene was trained, or none"
        raise InputError(given_by, found=found, expected="cameras of this scene", advice=advice)
    if not evidence:
        x, y, z = up_of_cameras(given).tolist()
        up, evidence = (x, y, z), "as these cameras were held"
    line = f"cameras: {len(given)} of {given_by}"
    return Viewpoints(tuple(given), up, True, (with_up(line, up, evidence),))
