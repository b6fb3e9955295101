"""What a play of a file needs beside the stream itself: its policy and its flight."""

from collections.abc import Mapping

from gsynopsis.evaluation.playing import Flight
from gsynopsis.pipeline.orbit import circle_of_frame, default_lens, orbit, parse_circle
from gsynopsis.records import ORBIT_NOTE, Frame
from gsynopsis.stream import policy
from gsynopsis.stream.policy import Policy, PolicyName
from gsynopsis.stream.rivals import l3gs, mpc_viewport
from gsynopsis.stream.viewed import ours

CAMERAS = 720
"""Cameras of a round of the flight."""


def policy_of(name: PolicyName) -> Policy:
    """A policy by name."""
    rules: dict[PolicyName, Policy] = {
        "fixed": policy.fixed,
        "throughput": policy.throughput,
        "bola": policy.bola,
        "mpc": policy.mpc,
        "mpc-viewport": mpc_viewport,
        "l3gs": l3gs,
        "ours": ours,
    }
    return rules[name]


def flight_around(meta: Mapping[str, str], frame: Frame, period: float, width: int) -> Flight:
    """A flight on the file's circle, else on one from its frame.

    Args:
        meta: Notes of the manifest.
        frame: The scene's.
        period: Seconds of a round.
        width: Width of the pictures, pixels.
    """
    circle = (ORBIT_NOTE in meta and parse_circle(meta[ORBIT_NOTE])) or circle_of_frame(frame)
    lens = default_lens().scaled(default_lens().width / width)
    return Flight(tuple(orbit(circle, lens, CAMERAS)), period)
