"""Memory that spills to disk: blocks hold what was written, the process stays below its limit."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gsynopsis import _native
from gsynopsis._native import spill

pytestmark = pytest.mark.skipif(spill.library() is None, reason="memory does not spill here")

ANY_ORDER = """
import ctypes, random, sys, threading
from pathlib import Path
from gsynopsis._native import spill
libc, MIB = ctypes.CDLL(None), 1 << 20
for name in ("malloc", "calloc", "realloc", "aligned_alloc"):
    getattr(libc, name).restype = ctypes.c_void_p
libc.malloc.argtypes = [ctypes.c_size_t]
libc.calloc.argtypes = libc.aligned_alloc.argtypes = [ctypes.c_size_t] * 2
libc.realloc.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]
early = libc.malloc(4 * MIB)
ctypes.memset(early, 7, 4 * MIB)
folder = Path(sys.argv[1])
spill.begin(folder, 400 * MIB)
assert spill.held() == 0

def use(seed):
    rng, blocks = random.Random(seed), []
    for turn in range(400):
        kind = rng.randrange(5)
        if blocks and kind == 0:
            place, size, mark = blocks.pop(rng.randrange(len(blocks)))
            assert ctypes.string_at(place, size) == bytes([mark]) * size
            libc.free(place)
        elif blocks and kind == 1:
            number = rng.randrange(len(blocks))
            place, size, mark = blocks[number]
            other = rng.randrange(1, 3 * MIB)
            place = libc.realloc(place, other)
            least = min(size, other)
            assert ctypes.string_at(place, least) == bytes([mark]) * least
            ctypes.memset(place, mark, other)
            blocks[number] = place, other, mark
        else:
            size, mark = rng.randrange(1, 3 * MIB), rng.randrange(256)
            size = (size + 63) // 64 * 64
            if kind == 2:
                place = libc.calloc(size // 64, 64)
                assert ctypes.string_at(place, size) == bytes(size)
            else:
                place = libc.aligned_alloc(64, size) if kind == 3 else libc.malloc(size)
            assert place % (64 if kind == 3 else 16) == 0
            ctypes.memset(place, mark, size)
            blocks.append((place, size, mark))
    for place, size, mark in blocks:
        assert ctypes.string_at(place, size) == bytes([mark]) * size
        libc.free(place)
    done.append(seed)

done = []
threads = [threading.Thread(target=use, args=(seed,)) for seed in range(4)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
assert len(done) == 4 and spill.held() == 0
assert ctypes.string_at(early, 4 * MIB) == bytes([7]) * 4 * MIB
early = libc.realloc(early, 8 * MIB)
assert spill.held() == 8 * MIB and ctypes.string_at(early, 4 * MIB) == bytes([7]) * 4 * MIB
libc.free(early)
assert not list(folder.iterdir())
"""
BELOW = """
import sys
import numpy as np
from pathlib import Path
from gsynopsis._native import spill
limit = 400 << 20
spill.begin(Path(sys.argv[1]), limit)
rows = [np.full(32 << 20, k, np.float32) for k in range(13)]  # 1,664 MiB
assert spill.held() == 1664 << 20
for _ in range(2):
    for k in range(13):
        rows[k] = rows[k] + 1
print(all((row == k + 2).all() for k, row in enumerate(rows)), rows[3][5])
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(int(status["VmHWM"].split()[0]) * 1024 < 2 * limit)
"""
NO_ROOM = """
import resource, sys
import numpy as np
from pathlib import Path
from gsynopsis._native import spill
resource.setrlimit(resource.RLIMIT_FSIZE, (64 << 20, 64 << 20))
spill.begin(Path(sys.argv[1]), 200 << 20)
held = np.ones(4 << 20)  # 32 MiB
try:
    np.ones(8 << 20)
except MemoryError:
    print("refused", held.sum() == held.size, np.ones(3 << 20).size)
"""
CHILDREN = """
import os, sys
from pathlib import Path
from gsynopsis._native import spill
from gsynopsis.pipeline.workers import on_this_machine
if __name__ == "__main__":
    spill.restart()  # loaded: only children are kept from it
    assert spill.is_loaded() and "LD_PRELOAD" not in os.environ
    print(*dict(on_this_machine(spill.is_loaded, {0: ()}, 1)).values())
    with spill.for_children():
        print(*dict(on_this_machine(spill.is_loaded, {0: ()}, 1)).values())
    assert "LD_PRELOAD" not in os.environ
"""


def preloaded(script: str, folder: Path, **environment: str) -> str:
    """What a script prints that was started with the library."""
    path = folder / "script.py"
    path.write_text(script)
    (folder / "spilled").mkdir()
    done = subprocess.run(
        [sys.executable, str(path), str(folder / "spilled")],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | {"LD_PRELOAD": str(spill.library()), **environment},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_blocks_hold_what_was_written_in_any_order_and_by_any_thread(tmp_path: Path) -> None:
    preloaded(ANY_ORDER, tmp_path)


def test_a_process_that_holds_four_times_the_limit_stays_near_it(tmp_path: Path) -> None:
    """Above its limit pages go back before a large block is given: it can have two blocks of
    128 MiB more, however late its keeper is. Blocks that are only touched wait for nobody; how
    far a late keeper lets those go beyond the limit depends on the clock, and is not tested."""
    assert preloaded(BELOW, tmp_path).split() == ["True", "5.0", "True"]


def test_what_the_disk_cannot_hold_is_refused_and_the_rest_goes_on(tmp_path: Path) -> None:
    assert preloaded(NO_ROOM, tmp_path).split() == ["refused", "True", str(3 << 20)]


def test_only_children_that_train_have_it_too(tmp_path: Path) -> None:
    assert preloaded(CHILDREN, tmp_path).split() == ["False", "True"]


def test_a_process_without_it_says_so() -> None:
    assert not spill.is_loaded() and spill.held() == 0


@pytest.mark.parametrize("folder", ["a b", "a:b"])
def test_a_place_that_no_list_of_libraries_can_name_counts_as_none(
    folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (folder, "good"):
        (tmp_path / name).mkdir()
        (tmp_path / name / spill.LIBRARY).touch()
    monkeypatch.setattr(_native, "__path__", [str(tmp_path / folder)])
    assert spill.library() is None
    monkeypatch.setattr(_native, "__path__", [str(tmp_path / folder), str(tmp_path / "good")])
    assert spill.library() == tmp_path / "good" / spill.LIBRARY
