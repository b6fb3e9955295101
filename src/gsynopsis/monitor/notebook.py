"""Progress in a notebook: one output under the cell that is drawn anew, without any extension.

Neither stderr, which is no terminal there, nor widgets, which are not installed everywhere: the
display protocol of IPython has an output that can be replaced, and that is all it takes.
"""

import base64
import io
import sys
import time
from collections.abc import Callable
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.monitor.history import Snapshot
from gsynopsis.monitor.step_text import facts, in_all
from gsynopsis.training.observer import StepInfo

REDRAW_SECONDS = 0.25
"""Between drawings: each is a message to a browser."""
PICTURE = 320
"""Longest side of the pictures, pixels."""
CURVE = (240, 100)
"""Width and height of the loss curve, pixels."""
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
    """A bar per phase, messages above them, and how the training looks, in one output."""

    def __init__(self, show: Show, clock: Callable[[], float] = time.monotonic) -> None:
        """Output goes to `show`, a few times a second at most."""
        self._show, self._clock, self._drawn = show, clock, float("-inf")
        self._messages: list[str] = []
        self._bars: dict[str, tuple[int, int, str]] = {}
        self._seen = self._seen_text = ""

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Show loss, held-out PSNR and the picture beside its photo below the bars."""
        held_out = "" if snapshot.psnr is None else f", {snapshot.psnr:.2f} dB on held-out photos"
        self._seen_text = f"step {snapshot.step:,}: loss {snapshot.loss:.4f}{held_out}"
        pictures = "".join(
            f'<figure style="margin:0"><img src="{_data(picture)}"><figcaption>{name}</figcaption>'
            "</figure>"
            for name, picture in (("rendering", snapshot.picture), ("photo", snapshot.photo))
        )
        row = '<div style="display:flex;gap:1em;flex-wrap:wrap">'
        self._seen = f"<p>{self._seen_text}</p>{row}{_curve(snapshot.curve)}{pictures}</div>"
        self._draw(at_once=True)

    def on_step(self, info: StepInfo) -> None:
        """Move the bar of the phase."""
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
        self._messages, self._bars, self._seen, self._seen_text = [], {}, "", ""
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
        return (f"<pre>{lines}</pre>{bars}" if lines else bars) + self._seen

    def _text(self) -> str:
        bars = [f"{name} {step}/{steps} {told}" for name, (step, steps, told) in self._bars.items()]
        seen = [self._seen_text] if self._seen_text else []
        return "\n".join([*self._messages, *(bar.rstrip() for bar in bars), *seen])


def _data(picture: NDArray[np.uint8]) -> str:
    """A picture as an address that holds it."""
    image, content = Image.fromarray(picture), io.BytesIO()
    image.thumbnail((PICTURE, PICTURE))
    image.save(content, "JPEG", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(content.getvalue()).decode()}"


def _curve(points: tuple[tuple[int, float], ...]) -> str:
    """Losses over steps as a drawing, from zero; nothing where there are fewer than two."""
    if len(points) < 2:
        return ""
    width, height = CURVE
    last, top = points[-1][0], max(loss for _, loss in points) or 1.0
    line = " ".join(
        f"{width * step / last:.1f},{height - height * loss / top:.1f}" for step, loss in points
    )
    return (
        f'<figure style="margin:0"><svg width="{width}" height="{height}">'
        f'<polyline points="{line}" fill="none" stroke="#4878d0" stroke-width="1.5"/></svg>'
        f"<figcaption>loss, {top:.3g} to {points[-1][1]:.3g}</figcaption></figure>"
    )
