"""The doctor: a verdict that follows from the findings, and advice for what is missing."""

import json
from types import ModuleType

import pytest

from gsynopsis import cli
from gsynopsis._native import runtime
from gsynopsis.cli import doctor
from gsynopsis.cli.doctor import Finding, can_train, examine, findings_text

NAMES = ["torch", "threads", "native extension", "CUDA device", "gsplat", "LPIPS weights", "ffmpeg"]


@pytest.fixture
def healthy(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A machine with everything that training needs."""
    core = ModuleType(doctor.NATIVE)
    core.variants = lambda: ["avx2", "baseline"]  # type: ignore[attr-defined]
    monkeypatch.setitem(__import__("sys").modules, doctor.NATIVE, core)
    return core


def finding(name: str) -> Finding:
    return next(f for f in examine() if f.name == name)


def test_a_machine_that_can_train_is_healthy(
    healthy: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["doctor"]) == 0
    text = capsys.readouterr().out
    assert "avx2, baseline" in text
    assert "Training on the CPU is possible." in text
    assert all(name in text for name in NAMES)


@pytest.mark.parametrize("missing", ["torch", doctor.NATIVE])
def test_without_a_needed_part_the_doctor_says_what_to_do(
    healthy: ModuleType,
    missing: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(__import__("sys").modules, missing, None)
    assert cli.main(["doctor"]) == 1
    text = capsys.readouterr().out
    assert "✗" in text
    assert "pip install" in text
    assert "not possible" in text


def test_an_older_extension_without_variants_counts(healthy: ModuleType) -> None:
    del healthy.variants
    assert finding("native extension").found == "loaded"


def test_json_holds_the_verdict_and_every_finding(
    healthy: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["doctor", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["can_train"] is True
    assert set(NAMES) <= {f["name"] for f in document["findings"]}


def test_everything_that_is_missing_comes_with_advice(healthy: ModuleType) -> None:
    assert all(f.advice for f in examine() if not f.found)


def test_only_what_is_needed_decides() -> None:
    assert can_train([Finding("a", "1", needed=True), Finding("b", "", advice="x")])
    assert not can_train([Finding("a", "", needed=True), Finding("b", "2")])
    assert findings_text([Finding("a", "", advice="x")]).startswith("– a  not there; x")


def test_threads_quota_and_what_idle_ones_do_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "cpu_quota", lambda: 1.5)
    monkeypatch.setenv("OMP_WAIT_POLICY", "PASSIVE")
    found = finding("threads").found
    assert "CPU quota 1.5" in found and found.endswith("PyTorch's sleep while idle")
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    assert finding("threads").found.endswith("PyTorch's spin while idle (OMP_WAIT_POLICY=ACTIVE)")
