"""What the help says of defaults."""

import pytest

from gsynopsis.cli import COMMANDS, main
from gsynopsis.cli.defaults import preset_values
from gsynopsis.config import preset


def help_of(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> str:
    monkeypatch.setenv("COLUMNS", "300")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("command", COMMANDS)
def test_no_default_is_none(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = help_of(command, capsys, monkeypatch)
    assert "default" in text or command == "doctor"
    assert "None" not in text


def test_the_help_of_train_has_the_presets_values_and_that_of_unfold_the_run_s(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = help_of("train", capsys, monkeypatch)
    steps = preset("fast").train.steps
    assert f"scale along. (default: {steps} in fast, 30000 in ours and paper)" in text
    assert "finest first. (default: 0.7 0.5 0.4)" in text
    assert "(default: the run's)" in help_of("unfold", capsys, monkeypatch)


def test_a_setting_that_all_presets_share_is_said_once() -> None:
    assert preset_values("train.seed") == "0"
    assert preset_values("levels.mode") == "joint in fast and ours, sequential in paper"
