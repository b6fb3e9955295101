"""What the help says of defaults."""

import pytest

from gsynopsis.cli import COMMANDS, main
from gsynopsis.cli.flags import asked_of, field_docs, preset_values
from gsynopsis.config import GrowthConfig, Joint, ModelConfig, Sequential, TrainConfig, preset_of


def help_of(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> str:
    # So narrow that options stand below each other: beside each other their lines would mix.
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    return " ".join(capsys.readouterr().out.replace("│", " ").split())


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
    steps = preset_of("draft").config.train.steps
    assert f"unless given. (default: {steps} in draft; 1500 in standard; 3000 in high;" in text
    assert "finest first (§1.11.6). (default: 0.7 0.5 0.4)" in text
    assert "(default: the run's)" in help_of("unfold", capsys, monkeypatch)


def test_a_setting_that_all_presets_share_is_said_once() -> None:
    assert preset_values("train.seed") == "0"
    assert (
        preset_values("levels.mode")
        == "joint in draft, standard, high and max; sequential in paper"
    )


@pytest.mark.parametrize("kind", [ModelConfig, TrainConfig, GrowthConfig, Joint, Sequential])
def test_every_setting_has_a_docstring_for_the_help(kind: type) -> None:
    documented = field_docs(kind)
    fields = set(kind.__dataclass_fields__) - {"growth", "mode"}
    assert fields <= set(documented)
    assert all(len(text) > 10 for text in documented.values())


def test_a_short_option_and_the_full_name_are_one() -> None:
    from gsynopsis.cli import parse
    from gsynopsis.cli.train import Train

    for words in (["--steps", "7"], ["--train.steps", "7"], ["--set", "train.steps=7"]):
        command = parse(["train", "scene", "--out", "run", *words])
        assert isinstance(command, Train)
        assert asked_of(command.overrides) == {"train.steps": 7}
        assert (command.scale, command.split) == (1.0, "every8")
