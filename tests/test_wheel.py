"""What the build leaves out of a wheel: nothing of the package but the kernels' C++."""

import tomllib
from pathlib import Path

from pathspec import GitIgnoreSpec

ROOT = Path(__file__).parent.parent


def test_no_python_file_is_left_out_of_an_installed_package() -> None:
    table = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["scikit-build"]
    left_out = [*table["sdist"]["exclude"], *table["wheel"]["exclude"]]
    left_out += (ROOT / ".gitignore").read_text("utf-8").splitlines()
    package = ROOT / "src" / "gsynopsis"
    files = [
        path for path in package.rglob("*") if path.suffix in {".py", ".typed", ".js", ".html"}
    ]
    files = [str(path.relative_to(ROOT)) for path in files if "__pycache__" not in path.parts]
    assert len(files) > 200
    assert [*GitIgnoreSpec.from_lines(left_out).match_files(files)] == []
