"""Benchmarks start, and stand on the library alone: no test, no command, no path outside but data.

A benchmark may start the command line where it is the command line that it measures.
"""

import ast
import json
import re
import subprocess
import sys
from os.path import normpath
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "benchmarks"
MODULES = sorted(FOLDER.rglob("*.py"))
SCRIPTS = [path for path in MODULES if '__name__ == "__main__"' in path.read_text("utf-8")]
FILES = sorted(
    path
    for path in FOLDER.rglob("*")
    if path.suffix in {".py", ".sh", ".js", ".mjs"} and "node_modules" not in path.parts
)
SHARED = ROOT.parent / "shared"
OUTSIDE = (SHARED / "data",)
"""What benchmarks may read beside the repository."""
FORBIDDEN = ("tests", "gsynopsis.cli")
UPWARDS = re.compile(r"(?<![\w/.])(?:\.\./)+(?:[\w./*-]*[\w*-])?")
ABSOLUTE = re.compile(r"(?<![\w.}$)/*\\])/(?:home|root|work|tmp|mnt|data|opt|srv|Users)\b[\w./-]*")
HELP = """
import io, json, runpy, sys
from contextlib import redirect_stderr, redirect_stdout

found = {}
for name in sys.argv[1:]:
    said = io.StringIO()
    sys.argv = [name, "--help"]
    try:
        with redirect_stdout(said), redirect_stderr(said):
            runpy.run_module(name, run_name="__main__", alter_sys=True)
        code = "ran"
    except SystemExit as error:
        code = error.code
    except BaseException as error:
        code = repr(error)
    found[name] = [code, said.getvalue()]
print(json.dumps(found))
"""


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")


def imports_of(tree: ast.Module) -> set[str]:
    """Modules and names that are imported, wherever that stands."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            found |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            found |= {a.value for a in node.args if isinstance(a, ast.Constant)}
    return found


def forbidden(names: set[str]) -> set[str]:
    return {n for n in names if any(n == bad or n.startswith(f"{bad}.") for bad in FORBIDDEN)}


def paths_outside(path: Path, text: str) -> list[str]:
    """Places outside of the repository that a file names, but for those it may."""
    # A module of JavaScript names others from where it stands, all else from the root.
    base = path.parent if path.suffix in {".js", ".mjs"} else ROOT
    allowed = (ROOT, *(OUTSIDE if base == ROOT else ()))
    strange = [
        word
        for word in UPWARDS.findall(text)
        if not any(Path(normpath(base / word)).is_relative_to(place) for place in allowed)
    ]
    return [*strange, *ABSOLUTE.findall(text)]


@pytest.fixture(scope="module")
def helped() -> dict[str, tuple[object, str]]:
    """What every script does with `--help`: exit code and words, all in one process."""
    line = [sys.executable, "-c", HELP, *map(name_of, SCRIPTS)]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize("path", SCRIPTS, ids=name_of)
def test_every_script_says_how_to_use_it(path: Path, helped: dict[str, tuple[object, str]]) -> None:
    code, said = helped[name_of(path)]
    assert code == 0, (code, said)
    assert "usage:" in said


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_benchmarks_import_no_tests_and_no_command_line(path: Path) -> None:
    assert not forbidden(imports_of(ast.parse(path.read_text("utf-8"))))


def test_an_import_of_tests_or_commands_is_noticed() -> None:
    text = "def f():\n    from gsynopsis import cli\nimport tests.tiny\nimport testsuite\n"
    assert forbidden(imports_of(ast.parse(text))) == {"gsynopsis.cli", "tests.tiny"}


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(FOLDER)))
def test_benchmarks_name_no_place_outside_but_shared_data(path: Path) -> None:
    text = path.read_text("utf-8")
    assert not paths_outside(path, text)
    assert "ROOT.parent" not in text or path.name == "bench.py"


def test_bench_knows_the_only_places_outside() -> None:
    text = (FOLDER / "bench.py").read_text("utf-8")
    places = re.findall(r"ROOT\.parent((?: / \"\w+\")+)", text)
    assert text.count("ROOT.parent") == len(places)
    named = [SHARED.parent.joinpath(*re.findall(r"\w+", words)) for words in places]
    assert named == list(OUTSIDE)


def test_a_place_outside_is_noticed() -> None:
    text = "../shared/data/fox ../shared/gpu/x.tgz ../../src /usr/bin/x /home/a/b"
    assert paths_outside(FOLDER / "a.py", text) == ["../shared/gpu/x.tgz", "../../src", "/home/a/b"]
    assert paths_outside(FOLDER / "viewer" / "a.mjs", "'../../src/x' '../x.js'") == []
