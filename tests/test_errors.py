"""What a message repeats of a file is cut, at one place for all errors."""

import pytest

from gsynopsis.errors import InputError, SceneError, SettingError, quoted


@pytest.mark.parametrize("kind", [InputError, SceneError, SettingError])
def test_a_megabyte_in_a_file_is_a_hundred_characters_in_a_message(kind: type[InputError]) -> None:
    long = "a" * 500_000 + "middle" + "b" * 500_000
    line = str(kind("file", long, found=long, expected=long, advice="do that"))
    assert len(line) < 1400 and line.startswith("file: aaa") and "bbb, expected aaa" in line
    assert len(str(kind(long, found=3))) < 1100
    assert "middle" not in line and "do that" in line


def test_what_is_short_and_what_an_error_says_stay() -> None:
    assert quoted("x" * 100) == "x" * 100 and len(quoted("x" * 101)) == 100
    inner = SettingError("where " * 30, found=1)
    assert str(inner) in str(InputError("file", found=inner))
