"""Errors of a check beside the largest that passes."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Finding:
    """One check.

    Attributes:
        name: Of the check.
        errors: By name.
        failed: Names of those over their limit.
        worst: Name of the error that is nearest to its limit, or furthest beyond.
        limit: Of the worst one.
    """

    name: str
    errors: dict[str, float]
    failed: list[str]
    worst: str
    limit: float

    def text(self) -> str:
        """One line."""
        verdict = f"FAILED: {', '.join(self.failed)}" if self.failed else "ok"
        numbers = f"{self.worst} {self.errors[self.worst]:.1e} of at most {self.limit:.0e}"
        return f"{self.name:<20} {numbers:<44} {verdict}"


def judged(name: str, errors: dict[str, float], limits: Mapping[str, float]) -> Finding:
    """A finding; an error's limit is that of the last part of its name, and NaN never passes."""
    of = {key: limits[key.rsplit(".", 1)[-1]] for key in errors}
    worst = max(errors, key=lambda k: _share(errors[k], of[k]))
    failed = [key for key, value in errors.items() if not value <= of[key]]
    return Finding(name, errors, failed, worst, of[worst])


def _share(error: float, limit: float) -> float:
    return error / max(limit, 1e-12) if error == error else float("inf")


def relative(found: Tensor, expected: Tensor) -> float:
    """Largest error over the largest expected entry; NaN counts as infinite."""
    return largest(found - expected) / max(largest(expected), 1e-12)


def distance(found: Tensor, expected: Tensor) -> float:
    """Length of the error over the length of what is expected; NaN counts as infinite."""
    off = (found.detach().cpu().double() - expected.detach().cpu().double()).norm()
    length = float(expected.detach().cpu().double().norm())
    return float(off.nan_to_num(nan=torch.inf)) / max(length, 1e-12)


def largest(values: Tensor) -> float:
    """The largest magnitude; NaN counts as infinite."""
    return float(values.abs().nan_to_num(nan=torch.inf).max()) if values.numel() else 0.0
