"""Learning rates and phases as pure functions of the progress."""

import math


def log_linear(initial: float, final: float, progress: float) -> float:
    """Interpolate on a log scale; progress in [0, 1]. Zero stays zero."""
    if initial <= 0:
        return 0.0
    return initial * (final / initial) ** min(max(progress, 0.0), 1.0)


def cosine(start: float, end: float, progress: float) -> float:
    """From start to end along half a cosine; progress is clamped to [0, 1]."""
    p = min(max(progress, 0.0), 1.0)
    return end + (start - end) * 0.5 * (1 + math.cos(math.pi * p))


def keep_target(step: int, steps: int, keep: float) -> float:
    """Share of anchors to be alive: 1 until 5 % of the steps, `keep` from 65 % (§1.11.6)."""
    return cosine(1.0, keep, (step / steps - 0.05) / 0.6)
