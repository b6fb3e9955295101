"""`train --viewer`: the running training on a page, and nothing of it in the result."""

import json
import os
import re
import subprocess
import sys
import urllib.request
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.error import HTTPError

import pytest
import torch

from gsynopsis.container import decode
from gsynopsis.errors import InputError, SpaceError
from gsynopsis.jobs.write_file import FilePacker, write_draft
from gsynopsis.monitor.listeners import Listeners
from gsynopsis.monitor.live_page import (
    FIRST_STEPS,
    LIVE_FILE,
    LIVE_REPORT,
    SECONDS,
    SHARE,
    LivePage,
    live_page,
)
from gsynopsis.monitor.snapshots import held_out_psnr
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.scene import Scene
from gsynopsis.serve.app import SECURITY_HEADERS
from gsynopsis.serve.run import listen
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent, StepInfo
from gsynopsis.training.state import TrainState, fresh_state
from tests.tiny import tiny_config, tiny_scene

STEP = StepInfo("full", 1, 99, 0.1, 20.0, 5, 0)
SMALL = ("--set", "model.table_log2=8", "--set", "model.codebook=8", "--set", "model.slots=4")


def context(scene: Scene | None = None) -> TrainContext:
    return TrainContext(scene or tiny_scene(), tiny_config(), make_renderer("cpu"), FilePacker())


def shown(state: TrainState, heard: "Heard", port: int) -> AbstractContextManager[LivePage]:
    return live_page(state, lambda path: write_draft(state, "standard", path), port, heard)


class Heard(Silent):
    """Keeps what is said."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.steps = 0

    def on_step(self, info: StepInfo) -> None:
        self.steps += 1

    def on_message(self, text: str) -> None:
        self.said.append(text)


@pytest.mark.parametrize("cost", [0.0, 0.01, 4.0])
def test_packing_takes_no_more_than_its_share_of_the_time(cost: float) -> None:
    now, spent = 0.0, 0.0

    def pack() -> None:
        nonlocal now, spent
        now, spent = now + cost, spent + cost

    packed, packed_so = list[float](), list[str]()
    live = LivePage(lambda: (packed.append(now), pack()), packed_so.append, clock=lambda: now)
    steps = 20_000
    for _ in range(steps):
        now += 0.05
        live.on_step(STEP)
    assert packed[0] >= max(SECONDS, 0.05 * FIRST_STEPS) and len(packed) > 5
    assert min(b - a for a, b in pairwise(packed)) >= SECONDS
    assert spent <= SHARE * now + cost


def test_a_failure_to_pack_is_said_once_and_ends_nothing() -> None:
    heard, now = Heard(), 0.0

    def pack() -> None:
        raise SpaceError("live.gsyn", found="1 byte free", expected="more")

    live = LivePage(pack, heard.on_message, clock=lambda: now)
    listeners = Listeners([heard, live])
    for _ in range(500):
        now += 1
        listeners.on_step(STEP)
    assert heard.steps == 500
    assert len(heard.said) == 1 and "1 byte free" in heard.said[0]


class Packing(Silent):
    """Packs after every step and reads what the server gives."""

    def __init__(self, live: LivePage, address: str) -> None:
        self.live, self.address = live, address
        self.levels: dict[str, int] = {}
        self.size = 0
        self.report: dict[str, Any] = {}

    def on_step(self, info: StepInfo) -> None:
        self.live.history.add(info)
        self.live.pack()
        with urllib.request.urlopen(self.address + LIVE_REPORT) as answer:
            self.report = json.loads(answer.read())
        with urllib.request.urlopen(self.address + LIVE_FILE) as answer:
            content = answer.read()
        self.levels[info.phase], self.size = len(decode(content, "live").levels), len(content)


def test_every_phase_can_be_seen_and_training_is_not_changed_by_it(tmp_path: Path) -> None:
    """Two trainings, one of them packed after each step."""
    found = []
    for seen in (False, True):
        out = tmp_path / str(seen)
        out.mkdir()
        state = open_state(context(), out, Heard())
        with shown(state, heard := Heard(), 0) as live:
            packing = Packing(live, heard.said[0].split("?")[0])
            assert run_training(state, out, packing if seen else Heard(), lambda: False)
        if seen:
            assert packing.report["held_out"]["psnr"] > 5, "the held-out photos are not measured"
            assert packing.report["version"]["bytes"] == packing.size
        assert packing.levels == ({"full": 1, "joint": 4} if seen else {})
        assert len(heard.said) == 1
        found.append({k: v.clone() for k, v in state.model.state_dict().items()})
    assert found[0].keys() == found[1].keys()
    assert all(torch.equal(found[0][k], found[1][k]) for k in found[0])


def test_the_report_is_answered_by_the_rules_of_everything_else() -> None:
    with shown(fresh_state(context()), heard := Heard(), 0):
        address = heard.said[0].split("?")[0]
        with urllib.request.urlopen(address + LIVE_REPORT) as answer:
            assert dict(answer.headers).items() >= SECURITY_HEADERS.items()
            assert answer.headers["cache-control"] == "no-store"
        for method, body, status in (("POST", None, 405), ("POST", b"x", 405), ("GET", b"x", 400)):
            request = urllib.request.Request(address + LIVE_REPORT, body, method=method)
            with pytest.raises(HTTPError, match=str(status)):
                urllib.request.urlopen(request)


def test_without_held_out_photos_nothing_is_measured() -> None:
    scene = tiny_scene()
    none = replace(scene, train=tuple(range(len(scene.views))))
    assert held_out_psnr(fresh_state(context(none))) is None
    assert held_out_psnr(fresh_state(context(scene))) is not None


def test_a_port_that_is_taken_is_said_before_anything_is_trained(tmp_path: Path) -> None:
    state = fresh_state(context())
    with (
        listen("127.0.0.1", 0) as taken,
        pytest.raises(InputError, match="another --port"),
        shown(state, Heard(), taken.getsockname()[1]),
    ):
        raise AssertionError("it is taken")


def test_the_command_serves_while_it_trains(tmp_path: Path) -> None:
    room = make_scene("room", tmp_path / "room", views=9, width=48, height=32, points=300)
    line = [sys.executable, "-m", "gsynopsis", "train", str(room), "--out", str(tmp_path / "run")]
    line += ["--steps", "60", "--no-evaluate", "--viewer", "--viewer-port", "0", *SMALL]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True, env=environment) as child:
        assert child.stderr is not None
        first = next(text for text in child.stderr if "shows the training" in text)
        found = re.match(r"(http://127\.0\.0\.1:\d+/)\?content=live\.gsyn&live ", first)
        assert found, first
        with urllib.request.urlopen(found[1]) as answer:
            assert b"gsynopsis-viewer.js" in answer.read()
        with urllib.request.urlopen(found[1] + LIVE_REPORT) as answer:
            assert json.loads(answer.read())["steps"] > 60, "those of all phases"
        rest = child.stderr.read()
        assert child.wait(timeout=120) == 0, rest
    assert "wrote" in rest and (tmp_path / "run" / "scene.gsyn").is_file()
    assert not (tmp_path / "run" / LIVE_FILE).exists()
