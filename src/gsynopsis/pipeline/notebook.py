"""Progress in a notebook: one output under the cell that is drawn anew, without any extension.

Neither stderr, which is no terminal there, nor widgets, which are not installed everywhere: the
display protocol of IPython has an output that can be replaced, and that is all it takes.
"""

import sys
import time
from collections.abc import Callable
from html import escape
from typing import Any

from gsynopsis.training.progress import StepInfo

REDRAW_SECONDS = 0.25
"""Between drawings: each is a message to a browser."""
Show = Callable[[str, str], None]
"""Shows HTML, or the plain text for who has none, in place of what was shown before."""


def notebook_display() -> Show | None:
    """A new output of the running cell; None outside of notebooks."""
    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if not hasattr(shell, "kernel"):
        return None
    from IPython.display import display  # type: ignore[import-not-found]  # a notebook has it

    def data(html: str, text: str) -> dict[str, str]:
        return {"text/html": html, "text/plain": text}

    handle: Any = display(data("", ""), raw=True, display_id=True)
    return lambda html, text: handle.update(data(html, text), raw=True)


class NotebookBar:
    """A bar per phase, and messages above them, in one output."""

    def __init__(self, show: Show, clock: Callable[[], float] = time.monotonic) -> None:
        """What there is to see goes to `show`, a few times a second at most."""
        self._show, self._clock, self._drawn = show, clock, float("-inf")
        self._messages: list[str] = []
        self._bars: dict[str, tuple[int, int, str]] = {}

    def on_step(self, info: StepInfo) -> None:
        """Move the bar of the phase."""
        from gsynopsis.pipeline.progress import facts, in_all

        self._bars[info.phase] = (info.step, info.steps, in_all(info) + facts(info))
        self._draw(at_once=info.step == info.steps)

    def on_pass(self, what: str, done: int, views: int) -> None:
        """A bar of its own until the pass is over."""
        self._bars[what] = (done, views, "")
        if done == views:
            del self._bars[what]
        self._draw(at_once=done == views)

    def on_message(self, text: str) -> None:
        """A line above the bars."""
        self._messages.append(text)
        self._draw(at_once=True)

    def clear(self) -> None:
        """Leave nothing to see."""
        self._messages, self._bars = [], {}
        self._draw(at_once=True)

    def _draw(self, *, at_once: bool) -> None:
        now = self._clock()
        if at_once or now - self._drawn >= REDRAW_SECONDS:
            self._drawn = now
            self._show(self._html(), self._text())

    def _html(self) -> str:
        bars = "".join(
            f'<div><progress max="{steps}" value="{step}"></progress> '
            f"<b>{escape(name)}</b> {step:,}/{steps:,} {escape(told)}</div>"
            for name, (step, steps, told) in self._bars.items()
        )
        lines = escape("\n".join(self._messages))
        return f"<pre>{lines}</pre>{bars}" if lines else bars

    def _text(self) -> str:
        bars = [f"{name} {step}/{steps} {told}" for name, (step, steps, told) in self._bars.items()]
        return "\n".join([*self._messages, *(bar.rstrip() for bar in bars)])
