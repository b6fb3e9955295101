"""Finding a run, and what its record may and may not say."""

import json
import os
from pathlib import Path

import pytest

from gsynopsis.errors import InputError, SettingError
from gsynopsis.runs.folder import Run, find_run, read_run, recorded_config, scene_of

RECORD = {
    "scene": "../photos",
    "scale": 4,
    "preset": "standard",
    "seed": 3,
    "steps": 2400,
    "train_seconds": 83.5,
    "split": "bungee",
    "config": {"ignored": True},
}


def folder_with(tmp_path: Path, text: str) -> Path:
    (tmp_path / "scene.gsyn").write_bytes(b"")
    (tmp_path / "run.json").write_text(text)
    return tmp_path


def test_a_run_knows_what_its_record_says(tmp_path: Path) -> None:
    run = find_run(folder_with(tmp_path, json.dumps(RECORD)))
    assert run == Run(
        file=tmp_path / "scene.gsyn",
        folder=tmp_path,
        scene=tmp_path / "../photos",
        scale=4.0,
        preset="standard",
        seed=3,
        steps=2400,
        train_seconds=83.5,
        split="bungee",
    )


def test_an_absolute_scene_stays_where_it_is(tmp_path: Path) -> None:
    record = RECORD | {"scene": "/photos/fox"}
    assert read_run(folder_with(tmp_path, json.dumps(record))).scene == Path("/photos/fox")


def test_an_unfinished_run_has_a_record_but_no_result(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps(RECORD))
    assert read_run(tmp_path).seed == 3
    with pytest.raises(InputError, match=r"no scene\.gsyn.*train it first"):
        find_run(tmp_path)


def test_a_single_file_and_a_folder_without_record_know_nothing(tmp_path: Path) -> None:
    file = tmp_path / "scene.gsyn"
    file.write_bytes(b"")
    assert find_run(file) == find_run(tmp_path) == Run(file=file, folder=tmp_path)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("{", "truncated"),
        ("[1]", "object"),
        ('{"scale": "big"}', "scale"),
        ('{"scale": NaN}', "malformed"),
        ('{"scale": true}', "scale"),
        ('{"seed": 1.5}', "seed"),
        ('{"scene": 7}', "scene"),
        ('{"split": "odd"}', "split"),
    ],
)
def test_a_damaged_record_names_file_and_field(tmp_path: Path, text: str, field: str) -> None:
    with pytest.raises(InputError, match=field) as caught:
        find_run(folder_with(tmp_path, text))
    assert "run.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_override_the_record(tmp_path: Path) -> None:
    run = find_run(folder_with(tmp_path, json.dumps(RECORD)))
    assert scene_of(run, None, None, None) == (tmp_path / "../photos", 4.0, "bungee")
    assert scene_of(run, Path("a"), 2.0, "none") == (Path("a"), 2.0, "none")


def test_what_nobody_knows_is_asked_for() -> None:
    run = Run(file=Path("a.gsyn"), folder=Path())
    with pytest.raises(SettingError, match="--scene"):
        scene_of(run, None, None, None)
    with pytest.raises(SettingError, match="--scale"):
        scene_of(run, Path("a"), None, None)
    assert scene_of(run, Path("a"), 1.0, None)[2] == "every8"


def test_nothing_at_all_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found nothing"):
        find_run(tmp_path / "none")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"scene": "a\\u0000b"}', "scene: found a NUL, expected a name"),
        ('{"scale": 1e308}', "scale: expected float <= 65536"),
        ('{"scale": 0.5}', "scale: expected float >= 1"),
        ('{"seed": -1}', "seed: expected int >= 0"),
        ('{"config": ' + '{"a":' * 2000 + "1" + "}" * 2000 + "}", "recursion depth"),
        ("[" * 5000, "expected"),
        ('{"split": "' + "q" * 100_000 + '"}', "split: expected Invalid enum value"),
        ("x" * 3_000_000, "found 3,000,000 bytes, expected at most 1,048,576"),
    ],
)
def test_hostile_records_are_one_short_line(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(InputError, match=told) as error:
        read_run(folder_with(tmp_path, text))
    assert len(str(error.value)) < 1500 + len(str(tmp_path))


def test_settings_that_are_nested_deeply_are_one_line(tmp_path: Path) -> None:
    for config in ('{"a":' * 900 + "1" + "}" * 900, '{"preset": 1, "train": 3}', '{"levels": []}'):
        with pytest.raises(InputError, match=r"run.json: config: found"):
            recorded_config(folder_with(tmp_path, f'{{"config": {config}}}'))


def test_a_record_is_a_regular_file(tmp_path: Path) -> None:
    folder_with(tmp_path, "{}")
    (tmp_path / "other.json").write_text("{}")
    (tmp_path / "run.json").unlink()
    (tmp_path / "run.json").symlink_to(tmp_path / "other.json")
    with pytest.raises(InputError, match="found a link, expected a regular file"):
        find_run(tmp_path)
    (tmp_path / "run.json").unlink()
    os.mkfifo(tmp_path / "run.json")
    with pytest.raises(InputError, match="found a pipe, expected a regular file"):
        find_run(tmp_path)
