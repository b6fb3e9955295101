"""Progress on stderr, so that stdout holds results alone: a bar, plain lines, JSON lines, nothing.

In a notebook it is an output of the cell instead.

`Observer` is the contract (`training/observer.py`); `Display` chooses who fulfils it.
"""

import json
import math
import sys
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from typing import TextIO

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from gsynopsis.evaluation.formatting import duration
from gsynopsis.monitor.notebook import NotebookBar, notebook_display
from gsynopsis.monitor.step_text import facts, in_all
from gsynopsis.training.observer import Observer, Silent, StepInfo

LINE_SECONDS = 10.0
"""Plain lines come at least this often …"""
LINE_SHARE = 0.1
"""… and after each tenth of a phase, whichever is first."""
JSON_SECONDS = 1.0
REDRAWS = 4
"""Redraws of the bar per second: it shares its cores with the training."""
Clock = Callable[[], float]


class Display:
    """An observer that fits, for the length of a `with` block.

    A bar on a terminal and in a notebook, else lines.
    """

    def __init__(
        self, *, json: bool = False, quiet: bool = False, stream: TextIO | None = None
    ) -> None:
        """Choose one.

        Args:
            json: One JSON object per line.
            quiet: Say nothing.
            stream: Where to; stderr if None.
        """
        out = sys.stderr if stream is None else stream
        self._bar: Bar | None = None
        self._observer: Observer = PlainLines(out)
        if quiet:
            self._observer = Silent()
        elif json:
            self._observer = JsonLines(out)
        elif out.isatty():
            self._observer = self._bar = Bar(Console(file=out))
        elif stream is None and (show := notebook_display()):
            self._observer = NotebookBar(show)

    def __enter__(self) -> Observer:
        if self._bar is not None:
            self._bar.progress.start()
        return self._observer

    def __exit__(self, *failure: object) -> None:
        if self._bar is not None:
            self._bar.progress.stop()


class Pace:
    """Decides when a line is due: the first and last step of a phase, and in between by time."""

    def __init__(self, seconds: float, share: float, clock: Clock) -> None:
        """A line every `seconds`, and for every `share` of a phase."""
        self._seconds, self._share, self._clock = seconds, share, clock
        self._phase = ""
        self._started = self._last = 0.0
        self._first = self._next = 0

    def due(self, info: StepInfo) -> bool:
        """True if this step deserves a line."""
        now = self._clock()
        new = info.phase != self._phase
        if new:
            self._phase, self._started, self._first = info.phase, now, info.step
        late = now - self._last >= self._seconds
        if not (new or late or info.step >= self._next or info.step == info.steps):
            return False
        self._last = now
        self._next = info.step + max(1, round(self._share * info.steps))
        return True

    def remaining(self, info: StepInfo) -> float | None:
        """Seconds until the phase ends, at its mean speed; None at its first step."""
        done = info.step - self._first
        if done <= 0:
            return None
        return (self._clock() - self._started) / done * (info.steps - info.step)


class PlainLines:
    """Plain lines for logs."""

    def __init__(self, stream: TextIO, clock: Clock = time.monotonic) -> None:
        """Lines go to `stream`, at once."""
        self._stream = stream
        self._pace = Pace(LINE_SECONDS, LINE_SHARE, clock)

    def on_step(self, info: StepInfo) -> None:
        """A line, if one is due."""
        if not self._pace.due(info):
            return
        left = self._pace.remaining(info) if info.left is None else info.left
        eta = f"{duration(left)} left, " if left is not None and info.step < info.steps else ""
        self._say(f"{info.phase} {info.step}/{info.steps}: {eta}{facts(info)}")

    def on_pass(self, what: str, done: int, views: int) -> None:
        """Not worth a line."""

    def on_message(self, text: str) -> None:
        """The line itself."""
        self._say(text)

    def _say(self, text: str) -> None:
        print(text, file=self._stream, flush=True)


class JsonLines:
    """One JSON object per line: steps about once a second, and messages."""

    def __init__(self, stream: TextIO, clock: Clock = time.monotonic) -> None:
        """Lines go to `stream`, at once."""
        self._stream = stream
        self._pace = Pace(JSON_SECONDS, 1.0, clock)

    def on_step(self, info: StepInfo) -> None:
        """The step, if a line is due. What is not finite becomes null."""
        if self._pace.due(info):
            values = {k: _finite(v) for k, v in asdict(info).items()}
            self._say({"event": "step", **values, "remaining": self._pace.remaining(info)})

    def on_pass(self, what: str, done: int, views: int) -> None:
        """Not worth a line."""

    def on_message(self, text: str) -> None:
        """The message."""
        self._say({"event": "message", "text": text})

    def _say(self, values: dict[str, object]) -> None:
        print(json.dumps(values, ensure_ascii=False), file=self._stream, flush=True)


class Bar:
    """A bar per phase with the time left, and the figures beside it."""

    def __init__(self, console: Console) -> None:
        """The bar lives while `progress` is started."""
        self.progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[facts]}", style="dim"),
            console=console,
            refresh_per_second=REDRAWS,
        )
        self._tasks: dict[str, TaskID] = {}

    def on_step(self, info: StepInfo) -> None:
        """Move the bar; drawing happens elsewhere, a few times a second."""
        if info.phase not in self._tasks:
            self._tasks[info.phase] = self.progress.add_task(
                info.phase, total=info.steps, completed=info.step - 1, facts=""
            )
        task = self._tasks[info.phase]
        self.progress.update(task, completed=info.step, facts=in_all(info) + facts(info))

    def on_pass(self, what: str, done: int, views: int) -> None:
        """A bar of its own until the pass is over."""
        if what not in self._tasks:
            self._tasks[what] = self.progress.add_task(what, facts="")
        if done == views:
            self.progress.remove_task(self._tasks.pop(what))
        else:
            self.progress.update(self._tasks[what], completed=done, total=views)

    def on_message(self, text: str) -> None:
        """A line above the bar."""
        self.progress.console.print(text, markup=False, highlight=False)


def _finite(value: str | float | None) -> str | float | None:
    """The value, or None where JSON has no word for it."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def ticking(what: str, *, quiet: bool = False) -> Generator[Callable[[int, int], None]]:
    """A bar for a loop of known length, on a terminal or in a notebook; elsewhere nothing.

    Args:
        what: What is done, e.g. `evaluating views`.
        quiet: Never show it.
    """
    show = None if quiet else notebook_display()
    if show is not None:
        bar = NotebookBar(show)
        try:
            yield lambda done, total: bar.on_pass(what, done, total)
        finally:
            bar.clear()
        return
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeRemainingColumn(compact=True),
        console=Console(stderr=True),
        transient=True,
        disable=quiet or not sys.stderr.isatty(),
    )
    with progress:
        task = progress.add_task(what, total=None)

        def tick(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        yield tick


@contextmanager
def passing(*, quiet: bool = False) -> Generator[Callable[[str, int, int], None]]:
    """A bar for loops of known lengths, one after the other; as `ticking`."""
    shown = ""
    with ExitStack() as bars:
        inner: Callable[[int, int], None] | None = None

        def tick(what: str, done: int, total: int) -> None:
            nonlocal shown, inner
            if what != shown or inner is None:
                bars.close()
                inner, shown = bars.enter_context(ticking(what, quiet=quiet)), what
            inner(done, total)

        yield tick
