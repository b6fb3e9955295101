import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.container import decode
from gsynopsis.playback.play import (
    STEP,
    Flight,
    Look,
    Rendered,
    Timeline,
    play,
    stalled,
    write_timeline,
)
from gsynopsis.playback.plots import plot_timeline, timelines_figure
from gsynopsis.playback.popping import measure_popping, measure_switches
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.stream.catalog import FULL_DB
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.lookahead import ours
from gsynopsis.stream.session import Session, SessionOptions
from gsynopsis.stream.trace import steady
from gsynopsis.stream.virtual import Link, VirtualTransport
from tests.model.test_multi_level import states
from tests.stream.scenes import small_file
from tests.tiny import look_at, tiny_scene


def flight() -> Flight:
    cameras = [
        look_at(np.array([40 * np.sin(a), -3.0, 40 * np.cos(a)]), np.zeros(3), 32, 24)
        for a in np.arange(20) * (2 * np.pi / 20)
    ]
    return Flight(tuple(cameras), 10.0)


def one_play(mbit: float, seconds: float = 3.0) -> Timeline:
    fetcher = Fetcher(VirtualTransport(small_file(), Link(steady(mbit))), "small", seed=0)
    session = Session(fetcher, "small", SessionOptions(ours, flight().eyes))
    full = decode(small_file(), "small")
    show = Rendered(flight(), CpuRenderer(), full)
    return play(session, fetcher, flight(), show, seconds=seconds)


def test_a_play_notes_what_was_seen_and_when() -> None:
    timeline = one_play(0.4)
    assert [look.time for look in timeline.looks] == [STEP * n for n in range(1, 7)]
    levels = [look.level for look in timeline.looks]
    assert (np.diff(levels) > -1e-9).all()
    assert -1 <= levels[0] < levels[-1] <= 3 + 1e-9
    for look in timeline.looks:
        assert (look.psnr == 0) == (look.time < timeline.first_picture)
    assert timeline.wasted == 0
    assert timeline.retries == 0
    assert timeline.viewed_10 == pytest.approx(np.mean([k.psnr for k in timeline.looks]))


def test_a_fast_link_shows_the_whole_model_at_once() -> None:
    timeline = one_play(400)
    assert timeline.finished < STEP
    assert {look.psnr for look in timeline.looks} == {FULL_DB}
    assert timeline.received == len(small_file())


def test_the_same_play_twice_is_the_same() -> None:
    assert one_play(0.4) == one_play(0.4)


def test_silence_of_a_second_is_a_stall() -> None:
    received = [10, 10, 10, 10, 30, 40, 40, 50]
    looks = [Look(STEP * (n + 1), 0.0, r, 1.0) for n, r in enumerate(received)]
    assert stalled(looks, 0.1, 9.0) == pytest.approx(1.5)
    assert stalled(looks, 3.0, 9.0) == 0
    assert stalled(looks, 0.1, 0.9) == 0


def test_a_timeline_is_written_as_json_csv_and_plot(tmp_path: Path) -> None:
    timeline = one_play(0.4)
    written = [*write_timeline(timeline, tmp_path), plot_timeline(timeline, tmp_path)]
    assert [path.name for path in written] == ["timeline.json", "timeline.csv", "timeline.png"]
    content = json.loads(written[0].read_text())
    assert content["first_picture"] == timeline.first_picture
    assert len(written[1].read_text().splitlines()) == 1 + len(timeline.looks)
    assert written[2].read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("mbit", [0.02, 0.4, 400])
@pytest.mark.parametrize("name", ["psnr_photo", "psnr_full", ""])
def test_the_plot_names_levels_and_events_within_the_picture(mbit: float, name: str) -> None:
    timeline = one_play(mbit)
    assert timeline.level_db == (20.0, 21.0, 22.0, 23.0)
    if name == "psnr_photo":
        timeline = replace(timeline, level_db=(9.0, 10.0, 11.0, 12.25), level_db_size="96 x 64")
    elif not name:
        timeline = replace(timeline, level_db=(None,) * 4)
    figure = timelines_figure({"": timeline})
    figure.canvas.draw()
    levels = figure.axes[1]
    ticks = [tick.get_text() for tick in levels.get_yticklabels()]
    assert ticks[0] == "none"
    last = {"psnr_photo": "L3\n12.2 dB", "psnr_full": "L3\n23.0 dB", "": "L3"}[name]
    assert ticks[-1] == last
    assert ("96 x 64" in levels.get_ylabel()) == (name == "psnr_photo")
    said = figure.axes[0].texts
    assert ", ".join(text.get_text().strip() for text in said) == "first picture, L1, L2, L3, all"
    for axes in figure.axes:
        edges = axes.get_xlim()
        assert all(
            edges[0] <= float(np.asarray(line.get_xdata())[0]) <= edges[1] for line in axes.lines
        )
    for text in [*said, *levels.get_yticklabels()]:
        box = text.get_window_extent()
        assert 0 <= box.x0 < box.x1 <= figure.bbox.width
        assert 0 <= box.y0 < box.y1 <= figure.bbox.height
    boxes = [text.get_window_extent() for text in said]
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])


def test_a_fade_pops_at_most_a_quarter_of_a_hard_switch() -> None:
    before, after = states()
    cameras = [tiny_scene().views[4].camera] * 14
    hard = measure_popping(before, after, cameras, CpuRenderer(), 1)
    soft = measure_popping(before, after, cameras, CpuRenderer(), 12)
    assert hard.mean > 0
    assert soft.mean <= 0.25 * hard.mean
    with pytest.raises(ValueError, match="needs 13 cameras"):
        measure_popping(before, after, cameras[:12], CpuRenderer(), 12)


def test_switches_of_all_levels_are_measured_hard_and_faded() -> None:
    levels = decode(small_file(), "small")
    cameras = flight().cameras[:1] * 13
    switches = measure_switches(levels, cameras, CpuRenderer())
    assert [switch.level for switch in switches] == [1, 2, 3]
    for switch in switches:
        assert 0 < switch.faded_mean < switch.hard_mean
        assert 0 < switch.faded_largest <= switch.hard_largest
