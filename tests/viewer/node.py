"""The viewer's own code run by node."""

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.viewer.node import INSTALLED, NODE, standalone

HERE = Path(__file__).parent
TYPES = {
    "Float32Array": np.float32,
    "Int32Array": np.int32,
    "Uint32Array": np.uint32,
    "Uint8Array": np.uint8,
}

needs_node = pytest.mark.skipif(
    not INSTALLED, reason="node or viewer/node_modules is not there: viewer NOT tested"
)


def run_node(script: str, *arguments: object) -> str:
    """What a script of this folder prints; it gets the viewer's path first."""
    assert NODE is not None
    command = [NODE, str(HERE / script), str(standalone()), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def decode_with_viewer(
    files: Sequence[Path], eyes: Sequence[Sequence[float]], folder: Path, kernel: str
) -> list[dict[str, NDArray[np.generic]]]:
    """Of each file all arrays that the viewer decodes, by the names of dump.mjs."""
    request, out = folder / "request.json", folder / f"{kernel}.bin"
    content = {"files": list(map(str, files)), "eyes": list(map(list, eyes))}
    request.write_text(json.dumps({**content, "kernel": kernel, "out": str(out)}))
    described = json.loads(run_node("dump.mjs", request))
    data = out.read_bytes()
    found: list[dict[str, NDArray[np.generic]]] = [{} for _ in files]
    for entry in described:
        kind = TYPES[entry["type"]]
        array = np.frombuffer(data, kind, entry["count"], entry["start"])
        found[entry["file"]][entry["name"]] = array
    return found
