"""Help text that stands in place of `(default: None)`."""

from typing import Any

from tyro.conf import arg


def said(text: str) -> Any:
    """A marker for an option: the help calls its default so."""
    return arg(help_behavior_hint=f"(default: {text})")
