"""Two processes train what one would: the same files, to the last bit."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors import safe_open

from gsynopsis.errors import SettingError
from gsynopsis.training.distributed.process_group import (
    ProcessGroup,
    init_process_group,
    pairwise_sum,
)
from gsynopsis.training.loop import CHECKPOINT, FULL
from tests.training.peer import CASES, STOP, train

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that two processes did; see `peer.py`."""
    folder = tmp_path_factory.mktemp("world")
    assert not train("joint", folder / "stopped by one", ProcessGroup(), STOP)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    meeting = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": "2"}
    children = [
        subprocess.Popen(
            [sys.executable, "-W", "error", "-m", "tests.training.peer", str(folder)],
            env={**os.environ, **meeting, "RANK": str(rank), "OMP_NUM_THREADS": "1"},
            cwd=ROOT,
        )
        for rank in range(2)
    ]
    assert [child.wait(timeout=300) for child in children] == [0, 7]
    return folder


def contents(path: Path) -> tuple[dict, dict[str, torch.Tensor]]:
    """State and tensors of a checkpoint, without the seconds it took."""
    with safe_open(path, framework="pt") as handle:
        state = json.loads(handle.metadata()["state"])
        tensors = {name: handle.get_tensor(name) for name in handle.keys()}  # noqa: SIM118
    del state["cursor"]["seconds"], state["cursor"]["phase_seconds"]
    return state, tensors


def assert_same(a: Path, b: Path) -> None:
    (state_a, tensors_a), (state_b, tensors_b) = contents(a), contents(b)
    assert state_a == state_b and tensors_a.keys() == tensors_b.keys()
    differing = [
        n for n, t in tensors_a.items() if t.numpy().tobytes() != tensors_b[n].numpy().tobytes()
    ]
    assert not differing


@pytest.mark.parametrize("case", list(CASES))
def test_two_processes_end_where_one_does_with_the_same_batch(case: str, together: Path) -> None:
    one = together / case / "one"
    assert train(case, one, ProcessGroup())
    for name in (FULL, CHECKPOINT):
        assert_same(one / name, together / case / "two" / name)
    grown = contents(one / FULL)[1]["model.lattice"]
    assert len(grown) > 120, "nothing has grown: the test would not see other decisions"


def test_a_run_may_go_on_with_another_number_of_processes(together: Path) -> None:
    assert_same(together / "stopped by one" / CHECKPOINT, together / "joint" / "two" / CHECKPOINT)
    stopped = together / "stopped by two"
    state, tensors = contents(stopped / CHECKPOINT)
    assert state["cursor"]["step"] == STOP and tensors["growth.visits"].shape[0] == 2
    assert bool((tensors["growth.visits"].sum(dim=1) > 0).all())
    assert train("joint", stopped, ProcessGroup())
    assert_same(stopped / CHECKPOINT, together / "joint" / "two" / CHECKPOINT)


def test_what_goes_wrong_in_one_process_stops_both(together: Path) -> None:
    first, second = (json.loads((together / f"{rank}.json").read_text()) for rank in range(2))
    assert first["poison"].startswith("PeerError: another process of this training diverged")
    assert "DivergedError: step 4: view" in second["poison"] and "table" in second["poison"]
    assert first["full disk"].startswith("SpaceError") and "No space left" in first["full disk"]
    assert second["full disk"] == "PeerError: the first process of this training stopped"
    assert first["gone"].startswith("PeerError: another process of this training is gone")
    assert "gloo" not in first["threads"], "they may abort the process when the interpreter ends"
    assert not list((together / "disk").iterdir())


def test_processes_that_see_different_folders_are_refused(together: Path) -> None:
    for rank in range(2):
        seen = json.loads((together / f"{rank}.json").read_text())["apart"]
        assert seen.startswith("CheckpointError") and "the same folder as --out" in seen


def test_a_world_of_one_gives_back_what_it_gets() -> None:
    with init_process_group({}) as group:
        tensor, done = torch.arange(3.0), []
        assert group == ProcessGroup(0, 1) and group.is_main
        assert list(group.shard(range(4))) == [0, 1, 2, 3]
        assert group.sum(tensor) is tensor and group.gather(tensor) is tensor
        assert group.any(True, False) == (True, False)
        group.on_main(lambda: done.append(1))
        assert done == [1]


@given(st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=8), st.sampled_from((1, 2, 4)))
def test_partial_sums_of_equal_blocks_are_branches_of_the_whole(values, processes: int) -> None:
    terms = [torch.tensor([v * k]) for k in range(1, processes + 1) for v in values]
    length = len(values)
    parts = [pairwise_sum(terms[r * length : (r + 1) * length]) for r in range(processes)]
    assert torch.equal(pairwise_sum(parts), pairwise_sum(terms))


@pytest.mark.parametrize("size", ["x", "", "0", "-1", "1.0", "²", "9" * 400])
def test_a_world_size_that_is_no_number_is_one_line(size: str) -> None:
    wanted = r"^WORLD_SIZE: found .{0,110}, expected a whole number from 1 on; unset WORLD_SIZE"
    with (
        pytest.raises(SettingError, match=wanted),
        init_process_group({"WORLD_SIZE": size}),
    ):
        pass


def test_a_world_without_a_meeting_point_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RANK", "MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    with (
        pytest.raises(SettingError, match=r"^torchrun: found .*, expected what torchrun sets"),
        init_process_group({"WORLD_SIZE": "2"}),
    ):
        pass
