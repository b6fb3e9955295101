"""Figures of a step as text."""

from gsynopsis.evaluation.formatting import count, duration, memory
from gsynopsis.training.observer import StepInfo


def facts(info: StepInfo) -> str:
    """The figures of a step: `loss 0.0412, 27.31 dB, 14.2 k anchors, 612 MiB`."""
    return (
        f"loss {info.loss:.4f}, {info.psnr:.2f} dB, {count(info.anchors)} anchors, "
        f"{memory(info.memory)}"
    )


def in_all(info: StepInfo) -> str:
    """The time until the whole training ends; empty where nobody knows."""
    return "" if info.left is None else f"{duration(info.left)} left in all, "
