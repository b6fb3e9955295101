import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "scripts" / "words"


def words(folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, SCRIPT, folder], capture_output=True, text=True)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('"""What is read."""\n', 1),
        ('def f():\n    """Whether it is one."""\n', 2),
        ('class A:\n    """Where\n    it is."""\n', 2),
        ('class A:\n    x: int = 0\n    """Of the full model."""\n', 3),
        ('X = 1\n"""How many."""\n', 2),
        ('async def f():\n    """\n    Which one.\n    """\n', 2),
    ],
)
def test_docstrings_that_begin_with_a_question_word_are_refused(
    tmp_path: Path, text: str, line: int
) -> None:
    (tmp_path / "a.py").write_text(text)
    result = words(tmp_path)
    assert result.returncode == 1
    assert result.stdout.startswith(f"{tmp_path / 'a.py'}:{line}: ")


def test_doc_comments_of_typescript_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.ts").write_text("/** Requests. */\nconst A = 2;\n/**\n * What is read.\n */")
    result = words(tmp_path)
    assert result.returncode == 1
    assert result.stdout.splitlines()[0].startswith(f"{tmp_path / 'a.ts'}:4: 'What is read.'; ")


def test_banned_names_are_refused_with_the_better_one(tmp_path: Path) -> None:
    known = runpy.run_path(str(SCRIPT))
    kind = next(name for name in known["NAMES"] if name[0].isupper())
    function = next(name for name in known["NAMES"] if name.islower())
    module, better = next(iter(known["MODULES"].items()))
    (tmp_path / "a.py").write_text(f"class {kind}:\n    def {function}(self):\n        pass\n")
    (tmp_path / "b.ts").write_text(f"export interface {kind} {{}}\n")
    (tmp_path / f"{module}.py").write_text("")
    result = words(tmp_path)
    assert result.returncode == 1
    assert set(result.stdout.splitlines()[:-1]) == {
        f"{tmp_path / 'a.py'}:1: {kind}; {known['NAMES'][kind]}",
        f"{tmp_path / 'a.py'}:2: {function}; {known['NAMES'][function]}",
        f"{tmp_path / 'b.ts'}:1: {kind}; {known['NAMES'][kind]}",
        f"{tmp_path / module}.py:1: module {module}; {better}",
    }


def test_plain_words_pass(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(
        '"""Anchors sorted by Morton code, [N]."""\n'
        'X = "What is text in code"\n'
        'print("Where", """Which""")\n'
        "def often():\n"
        '    """Offer what was asked for."""\n'
        '    """What stands behind a docstring is no docstring."""\n'
    )
    (tmp_path / "a.ts").write_text("/** Howitzer. */\n// What a comment says is free.\n")
    result = words(tmp_path)
    assert result.returncode == 0, result.stdout
    assert result.stdout == "words: nothing to rewrite\n"
