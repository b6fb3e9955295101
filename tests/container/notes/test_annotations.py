"""Annotations: what is of their form, what is not, and how they get into files."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsynopsis.cli import main
from gsynopsis.container import check_file, encode
from gsynopsis.container.annotate import annotate, annotations_of
from gsynopsis.container.notes.annotations import ANNOTATIONS_MAX, annotations_text
from gsynopsis.errors import InputError
from tests.level_sets import make_level_set

CAMERA = {"position": [0, 0, -2.5], "target": [0, 0, 1], "quaternion": [1, 0, 0, 0]}
ONE: dict[str, Any] = {"title": "Door", "text": "Oak,\n1790", "at": [1, 2.5, -3], "camera": CAMERA}


def changed(**members: object) -> str:
    return json.dumps([{**ONE, **members}])


def test_the_text_is_the_same_annotations_and_nothing_else() -> None:
    text = annotations_text(json.dumps([{**ONE, "more": 1}, ONE]), "notes")
    assert json.loads(text) == [ONE, ONE]
    assert annotations_text("[]", "notes") == ""


@pytest.mark.parametrize(
    ("content", "field"),
    [
        ("{", "JSON"),
        ("{}", "list"),
        (json.dumps([ONE] * (ANNOTATIONS_MAX + 1)), "list"),
        ("[3]", "annotation 0"),
        (changed(title=3), "title"),
        (changed(title="x" * 101), "title"),
        (changed(text="x" * 2001), "text"),
        (changed(at=[1, 2]), "at"),
        (changed(at=[1, 2, True]), "at"),
        (changed(at=[1, 2, 1e300]), "at"),
        ("[" + json.dumps(ONE).replace("2.5", "NaN", 1) + "]", "at"),
        (changed(camera=None), "camera"),
        (changed(camera={**CAMERA, "quaternion": [1, 0, 0]}), "quaternion"),
    ],
)
def test_what_is_not_of_the_form_is_refused_by_name(content: str, field: str) -> None:
    with pytest.raises(InputError, match=field) as caught:
        annotations_text(content, "notes.json")
    assert "\n" not in str(caught.value) and "notes.json" in str(caught.value)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.gsyn"
    path.write_bytes(encode(make_level_set(np.random.default_rng(1)), "compact"))
    return path


def test_a_file_takes_them_keeps_all_else_and_gives_them_up(file: Path) -> None:
    before = check_file(file)
    assert annotations_of(file) == "[]"
    annotate(file, json.dumps([ONE]), "notes")
    after = check_file(file)
    assert json.loads(annotations_of(file)) == [ONE]
    assert (after.shared.lattice == before.shared.lattice).all()
    assert {**before.meta, "annotations": after.meta["annotations"]} == after.meta
    annotate(file, "[]", "notes")
    assert annotations_of(file) == "[]"


def test_pack_puts_them_into_a_file_or_a_copy(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    notes, copy = tmp_path / "notes.json", tmp_path / "copy.gsyn"
    notes.write_text(json.dumps([ONE]))
    assert main(["pack", str(file), "--out", str(copy), "--notes", str(notes)]) == 0
    assert annotations_of(file) == "[]" and json.loads(annotations_of(copy)) == [ONE]
    assert main(["pack", str(file), "--notes", str(notes)]) == 0
    assert json.loads(annotations_of(file)) == [ONE]
    notes.write_text(changed(at=[1]))
    capsys.readouterr()
    assert main(["pack", str(file), "--notes", str(notes)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
