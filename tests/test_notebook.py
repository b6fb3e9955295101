"""The example notebook runs from its first cell to its last, by public names alone."""

import ast
import json
import re
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parent.parent / "examples" / "first_steps.ipynb"
MOST_BYTES = 100_000
MOST_SECONDS = 300
"""Per cell; far more than it takes, so that a busy machine does not fail it."""

nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: extra 'dev'")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: extra 'dev'")


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def kinds(cell: Any) -> set[str]:
    return {kind for output in cell.outputs for kind in output.get("data", {})}


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    folder = tmp_path_factory.mktemp("notebook")
    nbclient.NotebookClient(
        notebook, timeout=MOST_SECONDS, resources={"metadata": {"path": str(folder)}}
    ).execute()
    return notebook


def test_it_is_committed_without_outputs() -> None:
    assert NOTEBOOK.stat().st_size < MOST_BYTES
    cells = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)


def test_it_imports_gsynopsis_and_nothing_else() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    tree = ast.parse("\n".join(cell.source for cell in code_cells(notebook)))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    assert [ast.unparse(node) for node in imports] == ["import gsynopsis as gs"]


def test_it_runs_and_shows_pictures_and_tables(executed: Any) -> None:
    cells = code_cells(executed)
    assert all(cell.execution_count for cell in cells)
    shown = {cell.source.splitlines()[-1]: kinds(cell) for cell in cells}
    levels = [shown[f"file.render(level={level}, camera=camera)"] for level in (0, -1)]
    assert all("image/png" in level for level in levels)
    assert "text/html" in shown["file"] & shown["report"]
    (opened,) = [cell for cell in cells if cell.source.endswith("\nfile")]
    viewer = opened.outputs[-1].data["text/html"]
    assert viewer.startswith('<iframe srcdoc="') and "gsynopsis-viewer-module" in viewer
    assert "<table>" in viewer
    assert "text/markdown" in shown["recipe"]


def test_progress_is_one_output_of_its_cell_and_nothing_is_on_stderr(executed: Any) -> None:
    cells = code_cells(executed)
    (training,) = [cell for cell in cells if "gs.train(" in cell.source]
    first, last = training.outputs
    assert first.output_type == "display_data" and last.output_type == "execute_result"
    assert first.data["text/html"].count("<progress") == 2  # full, joint
    assert "wrote runs/room/scene.gsyn" in first.data["text/plain"]
    assert re.search(r"step 100: loss 0\.\d+, \d+\.\d+ dB on held-out", first.data["text/plain"])
    assert "<svg" in first.data["text/html"]
    assert first.data["text/html"].count('<img src="data:image/jpeg') == 2
    assert not [output for cell in cells for output in cell.outputs if "name" in output]


STOP = """
import os, signal, threading, time
from pathlib import Path
import gsynopsis as gs

def press_stop(phrase):
    # As the button of a notebook does, once the training is under way.
    def wait():
        while not phrase():
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)
    threading.Thread(target=wait, daemon=True).start()
"""
TRAIN = """
press_stop(lambda: {phrase})
gs.train("room", "standard", "run", steps=100_000, evaluate=False, checkpoint_seconds=0.1)
"""
MAKE = "from gsynopsis.synthetic.make_scene import make_scene\n" + (
    'from pathlib import Path\nmake_scene("room", Path("room"), views=6, width=48, height=32)'
)


def test_the_stop_button_saves_a_training_and_the_cell_again_goes_on(tmp_path: Path) -> None:
    cell = nbformat.v4.new_code_cell
    saved = 'Path("run/checkpoint.safetensors").exists()'
    later = f"{saved} and Path('run/checkpoint.safetensors').stat().st_mtime > began"
    cells = [STOP + MAKE, TRAIN.format(phrase=saved), "began = time.time()"]
    cells.append(TRAIN.format(phrase=later))
    notebook = nbformat.v4.new_notebook(cells=[cell(text) for text in cells])
    nbclient.NotebookClient(
        notebook,
        timeout=MOST_SECONDS,
        startup_timeout=MOST_SECONDS,
        allow_errors=True,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    ).execute()
    for number, began in ((1, "plan: "), (3, "resuming at full")):
        bars, error = notebook.cells[number].outputs
        assert error["ename"] == "KeyboardInterrupt"
        text = bars["data"]["text/plain"]
        assert began in text and re.search(r"stopped at full \d+/100000; saved", text)
    assert not list(tmp_path.rglob("*.draft"))
