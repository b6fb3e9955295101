"""Import a file of splats and measure it: seconds, bytes by level, decibels against the input.

`python -m benchmarks.size.imports FILE --rival SOG` prints one JSON object; the rival's bytes are
those of a file, or of all files of a folder.
"""

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

from gsynopsis.pipeline.importing import import_splats


def bytes_of(path: Path) -> int:
    """Of a file, or of a folder's files."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def measured(source: Path, rival: Path | None) -> dict[str, object]:
    """Figures of one import."""
    with tempfile.TemporaryDirectory() as folder:
        start, busy = time.perf_counter(), time.process_time()
        made = import_splats(source, Path(folder) / "a.gsyn")
        seconds, cpu = time.perf_counter() - start, time.process_time() - busy
    count = made.splats[-1]
    return {
        "kind": made.kind,
        "splats": made.splats,
        "ends": made.ends,
        "psnr": made.psnr,
        "base_share": made.ends[0] / made.ends[-1],
        "bytes_per_splat": made.ends[-1] / count,
        "seconds_per_million": seconds / count * 1e6,
        "cpu_seconds_per_million": cpu / count * 1e6,
        "load": os.getloadavg()[0],
        "rival_bytes": bytes_of(rival) if rival else None,
    }


def main() -> None:
    """Measure what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--rival", type=Path)
    options = parser.parse_args()
    print(json.dumps(measured(options.file, options.rival), indent=1))


if __name__ == "__main__":
    main()
