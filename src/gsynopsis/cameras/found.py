"""Cameras for a scene of which nobody says from where it was photographed (ours).

Many are tried, around what there is and anywhere before it; each is told by a small picture how
much it sees and how well; and of those, one after the other, the one is taken that adds most to
what the others see.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gsynopsis.cameras.placement import WHOLE, Subject, camera_at
from gsynopsis.cameras.sketch import Sight, Sketcher
from gsynopsis.cameras.up import Guess
from gsynopsis.scene.camera import Camera, look_from, positions_of

Float64 = NDArray[np.float64]
TURNS, TILTS, ZOOMS = 12, (0.05, 0.4, 0.8, 1.3), (1.05, 0.7)
"""Cameras around everything: sides, radians above it, and factors on the distance to see it."""
TRIED = 240
"""Cameras that are tried anywhere."""
AGAIN = ((40, 4, 0.35), (40, 4, 0.2))
"""Then beside the best: of how many, how many each, and how far off, of their distance."""
NEAREST, FARTHEST = 0.05, 2.5
"""Distances of such a camera from what it looks at, of the radius."""
LOWEST, HIGHEST = -0.6, 1.4
"""Elevations from there, radians."""
QUICK, QUICK_BEST = 64, 8
"""Cameras that only compare candidates for up, and how many of the best count."""
LIKELY, MARGIN = 0.25, 0.05
"""Weight of the logarithm of their worth beside surfaces and customs; and by so much another
direction must be better than the custom of the format."""
SAME_AXIS = 0.99
"""Cosine of the angle between two axes from which on they are taken for one."""
BEST = 0.1
"""Share of tried cameras that tell how large splats are in good pictures."""
UNEVEN = 0.5
"""Spread of the logarithm of splats' angles that halves, about, what a picture is worth."""
USUAL = 0.9
"""Likewise of its difference from the usual one."""
NEAR_MAX = 0.5
"""Share of a picture with something in the way from which on it is worth nothing."""
COARSE_MAX = 0.3
"""Likewise of a picture with splats that look too large there."""
EMPTY = 16.0
"""Exponent by which an image is worth less for more empty parts than good images have."""
ASIDE = 0.4
"""Distance of what is in a picture from its middle, of half its width, that halves its worth."""
DEPENDENCE = 3.0
"""Power of the change of colors from there, where that is less than usual."""
OPEN = 0.5
"""Power of the share of the points in the frame that is seen, where that is less than usual."""
FILLED, SEEN = 0.002, 0.01
"""Least share of a camera's picture that is filled, and of the points that it sees."""
OUTWARD = 5
"""Every so many of the cameras anywhere look at what is around the subject, where there is such."""
LEVEL, STEEP = 3.0, 0.15
"""Power of the cosine squared of a camera's pitch, as most photos are taken nearly level; and what
those straight down are worth at least."""
MOST, WIDE = 0.0, 0.5
"""A splat that looks larger than usual, by this logarithm, counts no more; and the power of what a
camera sees, as people photograph most of a scene rather than a part."""
BACKDROP = 0.3
"""Weight of all of that, beside all of the subject."""
HIDDEN = 0.13
"""Share of the points that is hidden from around, from which on a scene may be a closed one."""
AMONG, CELLS = 0.6, 3
"""Share of directions with something in them from which on a place is among things; they are told
apart by a cube's faces of so many cells each way."""
ENCLOSED = 0.95
"""Likewise, of the subject itself, from which on a place is within a closed thing."""
WHOLE_EVERY = 3
"""One in so many chosen cameras has the whole scene in its picture, where such look right."""
RIGHT = 0.25
"""Share of the best camera's worth below which an image does not look right."""
SECTORS = 6
"""Directions, around the vertical, from which a point wants to be seen."""
UNDER = 0.02
"""Quantile of heights near by, below which a place is under the ground."""
SLAB, SPANNED = 0.1, 0.7
"""Share of the heights that is one level, and least share of the width and depth that it has where
all stands on it."""


@dataclass(frozen=True)
class Try:
    """A camera, how far away is what it looks at, and what it sees."""

    camera: Camera
    distance: float
    sight: Sight
    pitch: float = 0.0


def upright(
    subject: Subject, sketcher: Sketcher, guesses: Sequence[Guess], lens: Camera
) -> tuple[Subject, Guess]:
    """The subject with the up that is taken, and the best of some guesses at it.

    The first guess, the custom, is taken unless another leads it by `MARGIN`.

    A scene looks right from where it was photographed. But from below its ground nothing hides it,
    so looks do not tell a direction from its opposite, and both have the better of theirs: what
    stands on surfaces tells them apart.
    """
    if len(guesses) == 1:
        return replace(subject, up=guesses[0].up), guesses[0]
    # In a square picture a figure that lies looks no better than one that stands.
    lens = replace(lens, width=lens.height, cx=lens.cy)
    searches = [Search(replace(subject, up=guess.up), sketcher, lens) for guess in guesses]
    tries = [search.quick_tries() for search in searches]
    worth = worths([each for some in tries for each in some])
    parts = np.split(worth, np.cumsum([len(some) for some in tries])[:-1])
    best = np.array([np.sort(part)[-QUICK_BEST:].mean() for part in parts])
    scores = np.array([guess.score for guess in guesses])
    most = max(float(best.max()), 1e-300)
    looks = LIKELY * np.log(np.maximum(best / most, 1e-9))
    ups = np.stack([guess.up for guess in guesses])
    scores += np.where(np.abs(ups @ ups.T) > SAME_AXIS, looks, -np.inf).max(axis=1)
    best_guess = guesses[int(scores.argmax())]
    taken = best_guess if scores.max() > scores[0] + MARGIN else guesses[0]
    return replace(subject, up=taken.up), best_guess


class Search:
    """Cameras of one scene, tried and chosen."""

    def __init__(self, subject: Subject, sketcher: Sketcher, lens: Camera) -> None:
        """Chosen cameras have the size and focal length of `lens`."""
        self._subject, self._sketcher, self._lens = subject, sketcher, lens
        self._chance = np.random.default_rng(0)
        self._tree = KDTree(subject.points)
        up = subject.up
        side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
        side /= np.linalg.norm(side)
        self._flat = np.stack([side, np.cross(up, side)])
        self._ground = KDTree(subject.points @ self._flat.T)
        self._heights = subject.points @ up
        self._floor = self._level_of_floor()
        self._some = subject.others[:: -(-len(subject.others) // 4096)]
        self.closed = False

    def tries(self) -> list[Try]:
        """Cameras around the scene, anywhere in it, and again near the best of these."""
        around, found = self._looked(self._around()), self._looked(self._anywhere(TRIED))
        found = self._within(around, found)
        for count, each, aside in AGAIN:
            best = [found[row] for row in self.chosen(found, count)]
            if best:
                found += self._within([], self._looked(self._beside(best, each, aside)))
        return found

    def _within(self, around: list[Try], others: list[Try]) -> list[Try]:
        """All tries; where a closed scene hides its inside from around, those from inside only."""
        if around:
            outside = _reached(around)
            inside = [each for each in others if self._among(each)] if outside < 1 - HIDDEN else []
            self.closed = bool(inside) and _reached(inside) > outside
            return inside if self.closed else around + self._outside(others)
        if self.closed:
            return [each for each in others if self._among(each)]
        return self._outside(others)

    def _among(self, each: Try) -> bool:
        """There is something on most sides of a camera."""
        return _sides(each.camera, self._some) >= AMONG

    def _outside(self, tries: list[Try]) -> list[Try]:
        """Those that are not within a closed thing, such as a body."""
        points = self._subject.points[:: -(-len(self._subject.points) // 4096)]
        return [each for each in tries if _sides(each.camera, points) < ENCLOSED]

    def quick_tries(self) -> list[Try]:
        """A few of the tries, to compare directions that may be up."""
        some = self._looked(self._around(3)) + self._looked(self._anywhere(QUICK))
        # Which of them are level depends on what is up.
        return [replace(each, pitch=0.0) for each in some]

    def _around(self, every: int = 1) -> list[tuple[Camera, float]]:
        """Cameras around everything, or one in so many of them, and how far they are from it."""
        out: list[tuple[Camera, float]] = []
        for tilt, turn, zoom in list(product(TILTS, range(TURNS), ZOOMS))[::every]:
            where = (turn + 0.5 * (TILTS.index(tilt) % 2)) / TURNS
            camera = camera_at(self._subject, self._lens, where, tilt, zoom)
            away = float(np.linalg.norm(camera.position - self._subject.middle))
            out.append((camera, away))
        return out

    def _anywhere(self, count: int) -> list[tuple[Camera, float]]:
        chance, subject = self._chance, self._subject
        rows = chance.integers(len(subject.points), size=count)
        low, high = np.log([NEAREST, FARTHEST])
        distances = subject.radius * np.exp(chance.uniform(low, high, count))
        turns = 2 * np.pi * chance.random(count)
        tilts: Float64 = np.arcsin(chance.uniform(np.sin(LOWEST), np.sin(HIGHEST), count))
        level = np.stack([np.cos(turns), np.sin(turns)], axis=1) @ self._flat
        away = np.cos(tilts)[:, None] * level + np.sin(tilts)[:, None] * subject.up
        targets = subject.points[rows]
        eyes: Float64 = (targets + distances[:, None] * away).astype(np.float64)
        around = self._sketcher.backdrop
        if len(around):
            # Some look past things at what is around.
            some = slice(None, None, OUTWARD)
            targets[some] = around[chance.integers(len(around), size=len(targets[some]))]
        return self._standing(eyes, targets)

    def _beside(self, best: Sequence[Try], each: int, aside: float) -> list[tuple[Camera, float]]:
        chance = self._chance
        eyes = positions_of(one.camera for one in best).repeat(each, axis=0)
        distances = np.array([one.distance for one in best]).repeat(each)[:, None]
        ahead = np.stack([one.camera.forward for one in best]).repeat(each, axis=0)
        targets = eyes + distances * ahead
        moved = aside * distances * chance.standard_normal((len(eyes), 3))
        turned = aside * distances * chance.standard_normal((len(eyes), 3))
        return self._standing(eyes + moved, targets + turned)

    def _standing(self, eyes: Float64, targets: Float64) -> list[tuple[Camera, float]]:
        """Cameras at places that are neither in something nor under the ground."""
        subject = self._subject
        away = np.linalg.norm(targets - eyes, axis=1)
        gap, row = self._tree.query(eyes)
        free = (gap > 0.1 * away) & (gap > subject.reach[row])
        free &= ~self._under(eyes, away)
        poses = look_from(eyes[free], targets[free], subject.up)
        return [
            (replace(self._lens, w2c=pose), float(far))
            for pose, far in zip(poses, away[free], strict=True)
        ]

    def _under(self, eyes: Float64, away: Float64) -> NDArray[np.bool_]:
        places, heights = eyes @ self._flat.T, eyes @ self._subject.up
        out: NDArray[np.bool_] = heights < self._floor
        for number, (place, height, far) in enumerate(zip(places, heights, away, strict=True)):
            near = self._ground.query_ball_point(place, 0.5 * far)
            if len(near) >= 8:
                out[number] |= height < np.quantile(self._heights[near], UNDER)
        return out

    def _level_of_floor(self) -> float:
        """Height of the lowest level if it spans the scene, which then stands on it; else -inf."""
        low, high = np.quantile(self._heights, [UNDER, 1 - UNDER])
        lowest = self._heights <= low + SLAB * (high - low)
        spans = [
            np.ptp(
                np.quantile(self._subject.points[rows] @ self._flat.T, [0.02, 0.98], axis=0), axis=0
            )
            for rows in (lowest, slice(None))
        ]
        return float(low) if (spans[0] >= SPANNED * spans[1]).all() else -np.inf

    def _looked(self, cameras: Sequence[tuple[Camera, float]]) -> list[Try]:
        up = self._subject.up
        return [
            Try(camera, far, self._sketcher.look(camera, far), float(camera.forward @ up))
            for camera, far in cameras
        ]

    def chosen(self, tries: Sequence[Try], count: int) -> list[int]:
        """So many of the tries, fewer where there are not so many good ones; best first.

        Every third, the first among them, has the whole scene in its picture, where such look
        right: an object is seen whole then, and a room, from inside, is not.

        Training gives splats to what photos show, so that all fill about the same: pictures are
        best that do so again. Of pixels that a splat has got, the logarithm counts.
        """
        right, usual = rightness(tries)
        views = [self._seen_from(each, usual) for each in tries]
        once = np.ones(len(self._sketcher.points))
        sides = np.ones((len(once), SECTORS))
        beyond = np.ones(len(self._sketcher.backdrop))
        share = BACKDROP * len(once) / max(len(beyond), 1)
        good = [each.sight.filled > FILLED and each.sight.seen.mean() > SEEN for each in tries]
        whole = self._whole(tries, worths(tries))
        left: list[int] = np.flatnonzero((right > 0) & good).tolist()
        picked: list[int] = []
        # Of each when it was last looked at: as others are picked it only falls.
        worth = np.full(len(tries), np.inf)
        while left and len(picked) < count:
            rows_whole = [row for row in left if whole[row]]
            every = len(picked) % WHOLE_EVERY == 0 and bool(rows_whole)
            best, most = -1, -1.0
            for row in sorted(rows_whole if every else left, key=lambda row: -worth[row]):
                if worth[row] < (1 - 1e-9) * most:
                    break
                rows, sector, area = views[row]
                gain = np.log1p(area / once[rows]) + np.log1p(SECTORS * area / sides[rows, sector])
                around = np.log1p(1 / beyond[tries[row].sight.backdrop])
                worth[row] = right[row] * float(gain.sum() + share * around.sum())
                if (worth[row], -row) > (most, -best):
                    best, most = row, worth[row]
            left.remove(best)
            rows, sector, area = views[best]
            once[rows] += area
            sides[rows, sector] += SECTORS * area
            beyond[tries[best].sight.backdrop] += 1
            picked.append(best)
        return picked

    def best_first(self, tries: Sequence[Try], picked: Sequence[int]) -> list[int]:
        """Chosen tries with that in front whose frame cuts off least of the whole, if any has it.

        Else that which shows most and looks right. The first one is also the first view of a file,
        and its poster.
        """
        worth = worths(tries)
        whole = self._whole(tries, worth)
        best = max(
            picked, key=lambda row: (whole[row] * tries[row].sight.framed, worth[row]), default=0
        )
        return sorted(picked, key=lambda row: row != best)

    def _whole(self, tries: Sequence[Try], worth: Float64) -> NDArray[np.bool_]:
        """Tries of such worth [T] that have all of the scene in their pictures and look right."""
        if self.closed:
            return np.zeros(len(tries), bool)
        # Around all of an object there is much that is empty.
        worth = worth / np.maximum([each.sight.filled for each in tries], 1e-9)
        framed = np.array([each.sight.framed >= WHOLE for each in tries])
        # From below a scene is framed as well, and nobody stands there.
        above = np.array([each.pitch <= 0.1 for each in tries])
        return framed & above & (worth >= RIGHT * worth.max())

    def _seen_from(
        self, each: Try, usual: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Float64]:
        """Points that a camera sees, from which side, and how large, of what is usual."""
        rows = np.flatnonzero(each.sight.seen)
        away = (each.camera.position - self._sketcher.points[rows]) @ self._flat.T
        turn = np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi)
        return rows, (turn * SECTORS).astype(np.int64) % SECTORS, areas(each, usual)


def _sides(camera: Camera, points: Float64) -> float:
    """Share of the directions around a camera in which some of the points are."""
    away = points - camera.position
    axis = np.abs(away).argmax(axis=1)
    rows = np.arange(len(away))
    main = away[rows, axis]
    aside = np.stack([away[rows, (axis + 1) % 3], away[rows, (axis + 2) % 3]], axis=1)
    share = aside / np.maximum(np.abs(main), 1e-12)[:, None]
    cell = np.clip((share + 1) / 2 * CELLS, 0, CELLS - 1).astype(int)
    face = 2 * axis + (main > 0)
    cells = np.unique((face * CELLS + cell[:, 0]) * CELLS + cell[:, 1])
    return len(cells) / (6 * CELLS**2)


def _reached(tries: Sequence[Try]) -> float:
    """Share of the points that some camera sees, or what they are part of."""
    return float(np.any([each.sight.reached for each in tries], axis=0).mean())


def areas(each: Try, usual: float) -> Float64:
    """Share of the usual area that each seen point fills; nearer ones count no more."""
    return np.exp(2 * np.minimum(each.sight.sizes - usual, MOST))


def worths(tries: Sequence[Try]) -> Float64:
    """Worth of each camera alone: what it shows, less where its picture looks wrong [T]."""
    right, usual = rightness(tries)
    return right * [float(np.log1p(areas(each, usual)).sum()) for each in tries]


def rightness(tries: Sequence[Try]) -> tuple[Float64, float]:
    """Rightness of each camera's picture, 0 to 1 [T], and the usual size of splats in these.

    That size is the logarithm of an angle.
    """

    def each(name: str) -> Float64:
        return np.array([getattr(one.sight, name) for one in tries], float)

    right = np.exp(-np.log(2) * (each("uneven") / UNEVEN) ** 2)
    right *= np.maximum(0, 1 - each("near") / NEAR_MAX)
    right *= np.maximum(0, 1 - each("coarse") / COARSE_MAX)
    # Around an object there is nothing: then it is to be large in its picture, and in the middle.
    right *= np.maximum(each("filled"), 0)
    right *= np.exp(-np.log(2) * (each("aside") / ASIDE) ** 2)
    right *= np.array([max(STEEP, (1 - one.pitch**2) ** LEVEL) for one in tries])
    seen = np.array([one.sight.seen.mean() for one in tries])
    right *= seen**WIDE
    best = np.argsort(-right * seen ** (1 - WIDE))[: max(1, round(BEST * len(tries)))]

    def of_usual(values: Float64) -> Float64:
        return np.minimum(1, values / max(float(np.median(values[best])), 1e-9))

    # From outside, through fog and the backs of walls, most of what is in the frame is hidden.
    right *= of_usual(seen / np.maximum(each("framed"), 1e-9)) ** OPEN
    # Photos changed colors most in the directions that they were taken from.
    right *= of_usual(each("change")) ** DEPENDENCE
    usual = float(np.median(each("angle")[best]))
    right *= np.exp(-np.log(2) * ((each("angle") - usual) / USUAL) ** 2)
    if len(tries[0].sight.backdrop):
        # Where there is something all around, a picture with empty parts looks out of it or in.
        full = float(np.median(each("filled")[best]))
        right *= np.exp(-EMPTY * full**4 * np.maximum(0, full - each("filled")))
    return right, usual
