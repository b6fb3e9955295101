"""The kernels' own threads: how many, nobody else's, and none that anyone has to wait for."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis._native import _core, runtime
from gsynopsis._native.runtime import cpu_quota, one_torch_thread, thread_count
from gsynopsis.records import Float32

SUM_IN_A_FORK = """
import os, sys
import numpy as np
from gsynopsis._native import _core
def loss():
    return _core.photometric(image, target, 0.2, None, 4)
image, target = np.random.default_rng(0).random((2, 64, 96, 3), np.float32)
before = loss()
child = os.fork()
if child == 0:
    os._exit(0 if loss() == before else 3)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) or loss() != before)
"""
FREED = """
import numpy as np
from gsynopsis._native.runtime import release_freed
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096
def parts(count):
    return [np.ones(1 << 20, np.uint8) for _ in range(count)]
parts(100).clear()  # more than its holes take: from now on blocks of this size are the allocator's
kept = parts(210)
some = kept[::20]  # the allocator gives back by itself what no block in use is above
kept.clear()
before = resident()
release_freed()
print(before - resident())
"""
LIBRARIES = """
import gsynopsis._native._core
print({line.split()[-1] for line in open("/proc/self/maps") if "omp" in line.split("/")[-1]})
"""


def python(script: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True
    )
    return done.stdout.strip()


def images() -> tuple[Float32, Float32]:
    image, target = np.random.default_rng(0).random((2, 96, 128, 3), np.float32)
    return image, target


def measured(count: int) -> tuple[float, bytes]:
    image, target = images()
    grad = np.empty_like(image)
    return _core.photometric(image, target, 0.2, grad, count), grad.tobytes()


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="lists libraries on Linux only")
def test_the_extension_brings_no_openmp() -> None:
    assert python(LIBRARIES) == "set()"


def test_callers_at_the_same_time_get_the_same_bits() -> None:
    expected = measured(1)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(measured, [1, 2, 3, 4, 7, 64] * 20))
    assert set(found) == {expected}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs os.fork")
def test_a_forked_process_has_threads_of_its_own() -> None:
    python(SUM_IN_A_FORK)


def test_torch_works_on_one_thread_and_the_kernels_on_as_many_as_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(runtime, "cpu_quota", lambda: None)
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        with pytest.raises(ValueError), one_torch_thread(), one_torch_thread():
            assert (torch.get_num_threads(), thread_count()) == (1, 3)
            raise ValueError
        assert (torch.get_num_threads(), thread_count()) == (3, 3)
    finally:
        torch.set_num_threads(before)


def test_the_quota_bounds_the_threads_unless_the_user_said_how_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 64)
    for quota, expected in ((None, 64), (0.2, 1), (1.5, 2), (8.0, 8), (100.0, 64)):
        monkeypatch.setattr(runtime, "cpu_quota", lambda quota=quota: quota)
        assert thread_count() == expected
    monkeypatch.setenv("OMP_NUM_THREADS", "64")
    monkeypatch.setattr(runtime, "cpu_quota", lambda: 2.0)
    assert thread_count() == 64


@pytest.mark.parametrize(
    ("groups", "files", "expected"),
    [
        ("0::/\n", {"cpu.max": "max 100000\n"}, None),
        ("0::/\n", {"cpu.max": "150000 100000\n"}, 1.5),
        ("0::/a/b\n", {"a/cpu.max": "200000 100000", "a/b/cpu.max": "max 100000"}, 2.0),
        ("0::/a/b\n", {"a/cpu.max": "200000 100000", "a/b/cpu.max": "50000 100000"}, 0.5),
        ("0::/on/the/host\n", {"cpu.max": "300000 100000\n"}, 3.0),
        ("0::/\n", {"cpu.max": "nonsense\n"}, None),
        ("0::/\n", {"cpu.max": "1 0\n"}, None),
        ("nonsense\n", {}, None),
        (
            "4:memory:/x\n3:cpu,cpuacct:/x\n0::/\n",
            {"cpu,cpuacct/cpu.cfs_quota_us": "-1", "cpu,cpuacct/cpu.cfs_period_us": "100000"},
            None,
        ),
        (
            "4:memory:/x\n3:cpu,cpuacct:/x\n0::/\n",
            {"cpu,cpuacct/x/cpu.cfs_quota_us": "25000", "cpu,cpuacct/x/cpu.cfs_period_us": "50000"},
            0.5,
        ),
        ("1:cpu:/\n", {"cpu/cpu.cfs_quota_us": "400000", "cpu/cpu.cfs_period_us": "100000"}, 4.0),
    ],
)
def test_the_quota_is_the_least_of_all_groups_above(
    tmp_path: Path, groups: str, files: dict[str, str], expected: float | None
) -> None:
    (tmp_path / "cgroup").write_text(groups)
    for name, text in files.items():
        (tmp_path / "fs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "fs" / name).write_text(text)
    assert cpu_quota(tmp_path / "cgroup", tmp_path / "fs") == expected


def test_a_system_without_control_groups_has_no_quota(tmp_path: Path) -> None:
    assert cpu_quota(tmp_path / "none", tmp_path) is None


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only glibc keeps so much")
def test_freed_memory_goes_back_to_the_system() -> None:
    done = subprocess.run([sys.executable, "-c", FREED], check=True, capture_output=True, text=True)
    assert int(done.stdout) > 150 << 20
