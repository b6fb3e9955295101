"""The fenced blocks of the pages, and the commands in them."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SHELL = {"sh", "bash", "console"}
TEXT = {"", "text"}
"""Blocks in these are no code."""
FENCE = re.compile(
    r"(?:<!-- not run: (?P<reason>.+?) -->\s*\n)?^```(?P<language>\w*)\n(?P<code>.*?)^```$",
    flags=re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    """A fenced block; `reason` says why it is not run, and is empty if it is."""

    page: Path
    line: int
    language: str
    code: str
    reason: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks_of(page: Path) -> list[Block]:
    text = page.read_text("utf-8")
    return [
        Block(
            page,
            text.count("\n", 0, match.start("code")),
            match["language"],
            match["code"],
            match["reason"] or "",
        )
        for match in FENCE.finditer(text)
    ]


def commands_of(block: Block) -> Iterator[list[str]]:
    """The words of each line, continued lines joined, without comments, prompts and settings."""
    for line in block.code.replace("\\\n", " ").splitlines():
        words = shlex.split(line.removeprefix("$ "), comments=True)
        while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):
            words = words[1:]
        if words:
            yield words


def our_words(words: list[str]) -> list[str] | None:
    """What `gsynopsis` is given, also by way of torchrun; None if it is another program."""
    if words[0].removeprefix(".venv/bin/") == "gsynopsis":
        return words[1:]
    if words[0] == "torchrun" and "gsynopsis" in words:
        return words[words.index("gsynopsis") + 1 :]
    return None


def suite_of(words: list[str]) -> str | None:
    """The suite that `python -m research` is given; None if it is another command."""
    return words[3] if words[1:3] == ["-m", "research"] else None


def script_of(words: list[str]) -> tuple[str, list[str]] | None:
    """A script of `benchmarks/` and the options it is given; None if it is none."""
    if words[0] in {"python", ".venv/bin/python"} and words[1].startswith("benchmarks/"):
        return words[1], [word for word in words[2:] if word.startswith("--")]
    return None
