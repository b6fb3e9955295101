"""Progress: lines when due, JSON that parses, nothing when quiet."""

import io
import json
import math
from dataclasses import replace

import pytest
from rich.console import Console

from gsynopsis.monitor.display import Bar, Display, JsonLines, PlainLines
from gsynopsis.monitor.notebook import NotebookBar, notebook_display
from gsynopsis.monitor.step_text import facts
from gsynopsis.training.observer import StepInfo

INFO = StepInfo("full", 1, 1000, 0.25, 18.5, 14_200, 612 * 2**20)


class Clock:
    """Time that passes when told."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def steps_of(lines: list[str]) -> list[int]:
    return [int(line.split("/")[0].split()[-1]) for line in lines]


def test_a_fast_phase_gets_a_line_at_its_ends_and_every_tenth() -> None:
    out, clock = io.StringIO(), Clock()
    observer = PlainLines(out, clock)
    for step in range(1, 1001):
        observer.on_step(replace(INFO, step=step))
    assert steps_of(out.getvalue().splitlines()) == [1, *range(101, 1000, 100), 1000]


def test_a_slow_phase_gets_a_line_every_ten_seconds() -> None:
    out, clock = io.StringIO(), Clock()
    observer = PlainLines(out, clock)
    for step in range(1, 41):
        clock.now += 1.0
        observer.on_step(replace(INFO, step=step))
    assert steps_of(out.getvalue().splitlines()) == [1, 11, 21, 31]


def test_the_time_left_follows_the_mean_speed() -> None:
    out, clock = io.StringIO(), Clock()
    observer = PlainLines(out, clock)
    observer.on_step(replace(INFO, step=500))
    clock.now += 20.0
    observer.on_step(replace(INFO, step=600))
    first, second = out.getvalue().splitlines()
    assert "left" not in first
    assert "full 600/1000: 1 min 20 s left, loss 0.2500, 18.50 dB" in second


def test_a_new_phase_starts_its_own_line_and_its_own_clock() -> None:
    out, clock = io.StringIO(), Clock()
    observer = PlainLines(out, clock)
    observer.on_step(replace(INFO, step=1000))
    observer.on_step(replace(INFO, phase="unfold L2", step=1, steps=3))
    assert out.getvalue().splitlines()[1].startswith("unfold L2 1/3: loss")


def test_figures_read_well() -> None:
    assert facts(INFO) == "loss 0.2500, 18.50 dB, 14.2 k anchors, 612 MiB"


def test_json_lines_parse_and_hold_no_nan() -> None:
    out, clock = io.StringIO(), Clock()
    observer = JsonLines(out, clock)
    observer.on_message("checkpoint «a» written")
    observer.on_step(replace(INFO, loss=math.nan, psnr=math.inf))
    clock.now += 0.5
    observer.on_step(replace(INFO, step=2))
    clock.now += 0.6
    observer.on_step(replace(INFO, step=3))
    assert "NaN" not in out.getvalue()
    assert "Infinity" not in out.getvalue()
    rows = [json.loads(line) for line in out.getvalue().splitlines()]
    assert [row["event"] for row in rows] == ["message", "step", "step"]
    assert (rows[1]["loss"], rows[1]["psnr"], rows[2]["step"]) == (None, None, 3)


def test_a_display_is_plain_where_there_is_no_terminal() -> None:
    out = io.StringIO()
    with Display(stream=out) as observer:
        observer.on_step(INFO)
        observer.on_message("done")
    assert out.getvalue().splitlines()[1] == "done"
    assert "\x1b" not in out.getvalue()


def test_a_quiet_display_says_nothing_at_all() -> None:
    out = io.StringIO()
    with Display(stream=out, quiet=True, json=True) as observer:
        observer.on_step(INFO)
        observer.on_message("done")
    assert out.getvalue() == ""


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_display_draws_a_bar_on_a_terminal_and_stops_it() -> None:
    out = Terminal()
    with Display(stream=out) as observer:
        assert isinstance(observer, Bar)
        observer.on_step(replace(INFO, step=250))
        observer.on_message("[checkpoint] written")
    assert observer.progress.finished is False
    assert "[checkpoint] written" in out.getvalue()


def test_the_bar_holds_phase_count_and_figures() -> None:
    out = io.StringIO()
    bar = Bar(Console(file=out, width=140, force_terminal=True, color_system=None))
    with bar.progress:
        bar.on_step(replace(INFO, step=250))
        bar.on_step(replace(INFO, phase="joint", step=3, steps=9))
    text = out.getvalue()
    assert "full" in text
    assert "250/1000" in text
    assert "3/9" in text
    assert "14.2 k anchors" in text


def test_a_pass_over_views_has_a_bar_until_it_is_over() -> None:
    out = io.StringIO()
    bar = Bar(Console(file=out, width=140, force_terminal=True, color_system=None))
    with bar.progress:
        for _ in range(2):
            bar.on_pass("weighing slots", 7, 43)
            bar.progress.refresh()
            bar.on_pass("weighing slots", 43, 43)
            assert not bar.progress.tasks
    assert "weighing slots" in out.getvalue() and "7/43" in out.getvalue()


@pytest.mark.parametrize("kind", [PlainLines, JsonLines])
def test_a_pass_over_views_is_not_worth_a_line(kind: type[PlainLines] | type[JsonLines]) -> None:
    out = io.StringIO()
    kind(out).on_pass("weighing slots", 7, 43)
    assert out.getvalue() == ""


class Output:
    """An output of a notebook's cell: what it shows now, and how often it was drawn."""

    def __init__(self) -> None:
        self.html, self.text, self.draws = "", "", 0

    def __call__(self, html: str, text: str) -> None:
        self.html, self.text, self.draws = html, text, self.draws + 1


def test_a_notebook_shows_one_bar_per_phase_and_is_not_flooded() -> None:
    output, clock = Output(), Clock()
    bar = NotebookBar(output, clock)
    bar.on_message("plan: <5> photos")
    for step in range(1, 1001):
        clock.now += 0.01
        bar.on_step(replace(INFO, step=step))
    assert output.html.count("<progress") == 1 and 'value="1000"' in output.html
    assert "&lt;5&gt;" in output.html and output.text.startswith("plan: <5> photos\nfull 1000/1000")
    assert 10 / 0.25 <= output.draws <= 10 / 0.25 + 3


def test_a_pass_in_a_notebook_is_gone_when_it_is_over() -> None:
    output = Output()
    bar = NotebookBar(output, Clock())
    bar.on_pass("opening photos", 1, 2)
    assert "opening photos" in output.html
    bar.on_pass("opening photos", 2, 2)
    assert not output.html and not output.text


def test_outside_of_a_notebook_there_is_no_output_of_a_cell() -> None:
    assert notebook_display() is None
