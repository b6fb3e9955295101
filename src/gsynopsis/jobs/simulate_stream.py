"""Policies by name and the camera path of a streaming simulation."""

from collections.abc import Mapping

from gsynopsis.cameras.orbit import circle_of_frame, orbit, parse_circle
from gsynopsis.cameras.placement import lens_of
from gsynopsis.playback.play import Flight
from gsynopsis.records import ORBIT_NOTE, Frame
from gsynopsis.stream import policy
from gsynopsis.stream.lookahead import ours
from gsynopsis.stream.policy import Policy, PolicyName

CAMERAS = 720
"""Cameras of a round of the flight."""


POLICIES: dict[PolicyName, Policy] = {
    "fixed": policy.fixed,
    "throughput": policy.throughput,
    "bola": policy.bola,
    "mpc": policy.mpc,
    "ours": ours,
}
"""Policies by the name that `gsynopsis stream --policy` has for them."""


def flight_around(meta: Mapping[str, str], frame: Frame, period: float, width: int) -> Flight:
    """A flight on the file's circle, else on one from its frame.

    Args:
        meta: Notes of the manifest.
        frame: The scene's.
        period: Seconds of a round.
        width: Width of the pictures, pixels.
    """
    circle = (ORBIT_NOTE in meta and parse_circle(meta[ORBIT_NOTE])) or circle_of_frame(frame)
    return Flight(tuple(orbit(circle, lens_of(width), CAMERAS)), period)
