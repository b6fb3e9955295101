"""A page in one file: the modules of the built viewer joined into scripts without imports."""

import re
import subprocess
from pathlib import Path

import pytest

from benchmarks.viewer.node import NODE
from gsynopsis.errors import InputError
from gsynopsis.serve.page import DECODER, FOLDER, VIEWER, WEBGPU, one_script, single_page

LATER = 'import{a as e,b}from"./gsynopsis-viewer.js";var t=e+b.length;b.push(t);export{t as Sum};'
FIRST = """var e=40,t=[`x`];function n(){return import(`./gsynopsis-tools.js`)}
Promise.all([n(),n()]).then(([a,b])=>console.log(a===b,a.Sum,t.length));
export{e as a,t as b};
"""


def written(folder: Path, first: str = FIRST, later: str = LATER) -> Path:
    (folder / "gsynopsis-tools.js").write_text(later)
    (folder / VIEWER).write_text(first)
    return folder / VIEWER


@pytest.mark.skipif(NODE is None, reason="node is not installed: joined scripts NOT run")
def test_the_deferred_module_shares_names_and_runs_once(tmp_path: Path) -> None:
    script = tmp_path / "joined.js"
    script.write_text(one_script(written(tmp_path)))
    done = subprocess.run([str(NODE), script], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("true 41 2\n", "")


@pytest.mark.parametrize(
    ("first", "later"),
    [
        (FIRST.replace("export", "exports"), LATER),
        (FIRST.replace("import(`", "load(`"), LATER),
        (FIRST, LATER.replace("gsynopsis-viewer", "other")),
        (FIRST, LATER.replace("import{", "import {")),
        (FIRST, 'import{a}from"./gsynopsis-viewer.js";import{x}from"./more.js";export{a as Sum};'),
    ],
)
def test_modules_of_another_form_are_refused(tmp_path: Path, first: str, later: str) -> None:
    with pytest.raises(InputError, match="expected the built viewer"):
        one_script(written(tmp_path, first, later))


def test_a_page_in_one_file_holds_each_module_once_and_imports_none() -> None:
    page = single_page("a.gsyn", b"x")
    for name in (VIEWER, DECODER):
        script = one_script(FOLDER / name).replace("</script", r"<\/script")
        assert page.count(script) == 1
        assert not re.search(r"\b(import|export)[{(]", script)
    assert len(page) < 1.02 * sum(path.stat().st_size for path in FOLDER.iterdir())


def test_a_page_in_one_file_is_without_webgpu_and_says_so() -> None:
    script = one_script(FOLDER / VIEWER)
    assert "a page in one file is without it: WebGL 2 draws." in script
    assert "requestAdapter" in (FOLDER / WEBGPU).read_text() and "requestAdapter" not in script
