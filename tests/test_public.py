"""The public face: twenty names at most, loaded late, each with an example that runs."""

import ast
import doctest
import inspect
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

import gsynopsis as gs

ROOT = Path(__file__).parent.parent
MOST_NAMES = 20
API = ROOT / "docs" / "api.md"
LISTED = API.read_text("utf-8").partition("## Records")[0]
ORDER = re.findall(r"^::: gsynopsis\.(?:\w+\.)*(\w+)$", LISTED, flags=re.MULTILINE)
"""The names as the page of the API has them: examples run in this order."""


def docstring_of(name: str) -> str:
    """Of a class or function its own; of a variable the string behind its assignment."""
    value = getattr(gs, name)
    if inspect.isclass(value) or inspect.isfunction(value):
        return inspect.cleandoc(value.__doc__ or "")
    body = ast.parse(inspect.getsource(gs)).body
    after = [
        follower
        for node, follower in pairwise(body)
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name
    ]
    return inspect.cleandoc(ast.literal_eval(ast.unparse(after[0])))


def example_of(name: str) -> doctest.DocTest:
    text = docstring_of(name)
    _, found, example = text.partition("Examples:\n")
    assert found, f"{name} has no example"
    return doctest.DocTestParser().get_doctest(example, {"gs": gs}, name, name, 0)


def test_the_face_is_a_sorted_list_of_at_most_twenty_names() -> None:
    assert gs.__all__ == sorted(set(gs.__all__))
    assert len(gs.__all__) <= MOST_NAMES
    assert all(hasattr(gs, name) for name in gs.__all__)


def test_what_the_face_loads_late_is_what_it_lists() -> None:
    assert {*gs._PLACES, "__version__"} == set(gs.__all__)
    typed = next(node for node in ast.parse(inspect.getsource(gs)).body if isinstance(node, ast.If))
    names = [
        n.asname or n.name for i in typed.body if isinstance(i, ast.ImportFrom) for n in i.names
    ]
    assert sorted(names) == sorted(gs._PLACES)


def test_a_room_does_not_hide_the_function_of_its_name() -> None:
    code = (
        "import gsynopsis as gs, gsynopsis.container.reader, gsynopsis.evaluation.formatting;"
        "gs.resolve; import gsynopsis.training.loop;"
        "assert all(callable(f) for f in (gs.pack, gs.evaluate, gs.train))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_importing_loads_neither_torch_nor_numpy_nor_the_rooms() -> None:
    code = "import sys, gsynopsis; print(*(n for n in sys.modules if n.startswith(PREFIXES)))"
    prefixes = ("torch", "numpy", "PIL", "rich", "tyro", "gsynopsis.")
    code = f"PREFIXES = {prefixes}; {code}"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert not done.stdout.strip()


def test_files_are_opened_checked_and_cut_and_scenes_loaded_without_torch() -> None:
    code = (
        "import sys, gsynopsis as gs; gs.open, gs.check, gs.cut, gs.load_scene;"
        "assert 'numpy' in sys.modules and 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_page_of_the_api_has_every_name_once() -> None:
    assert sorted(ORDER) == gs.__all__


def test_every_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ORDER:
        said: list[str] = []
        runner = doctest.DocTestRunner(verbose=False)
        result = runner.run(example_of(name), out=said.append)
        assert result.attempted, f"the example of {name} does nothing"
        assert not result.failed, "".join(said)
