"""Pages and code agree: what either cites of the other is there, and every link leads somewhere."""

import os
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import pytest

from gsynopsis.container.layout import VERSION

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
FOLDERS = ("src", "tests", "benchmarks", "viewer", "scripts")
CODE = {".py", ".ts", ".js", ".mjs", ".cpp", ".hpp", ".sh", ".j2", ".json", ".md", ""}
SKIPPED = {"node_modules", "__pycache__", "viewer_dist", "dist", "build"}
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md"), *(ROOT / "viewer").glob("*.md")])
RESULTS = sorted((DOCS / "results").glob("*.md"))
MOST_TABLES = 3

NUMBER = re.compile(r"§(\d+(?:\.\d+)*)")
NAMED = re.compile(r"methods\.md|format\.md|RFC")
REACH = 80
"""Characters before a number in which the page that it is of may be named."""
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"")
CITED = re.compile(r"docs/[\w/.-]+\.(?:md|csv|png|svg)")
COMMIT = re.compile(r"[Cc]ommit ([0-9a-f]{7,40})\b")


@cache
def files() -> list[Path]:
    """Source files; folders that are left out, such as the viewer's packages, are not entered."""
    found: list[Path] = []
    for folder in FOLDERS:
        for place, folders, names in os.walk(ROOT / folder):
            folders[:] = sorted(set(folders) - SKIPPED)
            paths = (Path(place, name) for name in sorted(set(names) - SKIPPED))
            found += (path for path in paths if path.suffix in CODE and path.is_file())
    return found


@cache
def text_of(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError:  # a compiled file without a suffix
        return ""


def sections(page: str) -> set[str]:
    """Numbers of a page's headings, `1.9`, and of the items of their lists, `1.9.4`."""
    found: set[str] = set()
    section = ""
    for line in page.splitlines():
        if heading := re.match(r"#+ (\d+(?:\.\d+)*)\.? ", line):
            section = heading[1]
            found.add(section)
        elif item := re.match(r"(\d+)\. ", line):
            found.add(f"{section}.{item[1]}")
    return found


def usual_page(path: str) -> str:
    """The page that a number without a page's name is of."""
    if "/serve/" in path:
        return "RFC"
    return "format.md" if path.endswith("container/layout.py") else "methods.md"


def cited_sections(text: str, usual: str) -> Iterator[tuple[str, str]]:
    """Page and number of all that a text cites; several numbers may follow one name."""
    for match in NUMBER.finditer(text):
        names = NAMED.findall(text[max(0, match.start() - REACH) : match.start()])
        yield (names[-1] if names else usual), match[1]


def without_code(page: str) -> str:
    return re.sub(r"`[^`\n]*`", "", re.sub(r"```.*?```", "", page, flags=re.DOTALL))


def anchors(page: str) -> set[str]:
    """What `#…` may lead to, as GitHub names headings."""
    found: list[str] = []
    for line in re.sub(r"```.*?```", "", page, flags=re.DOTALL).splitlines():
        if heading := re.match(r"#+ (.+)", line):
            plain = re.sub(r"[^\w\- ]", "", heading[1].strip().lower()).replace(" ", "-")
            found.append(f"{plain}-{found.count(plain)}" if plain in found else plain)
    return set(found)


def broken_links(page: Path) -> list[str]:
    found: list[str] = []
    for match in LINK.finditer(without_code(text_of(page))):
        target = unquote(match[1] or match[2])
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        if not path.exists() or (anchor and anchor not in anchors(text_of(path))):
            found.append(target)
    return found


def tables(page: str) -> int:
    return len(re.findall(r"^\|[ :|-]*-[ :|-]*\|$", page, flags=re.MULTILINE))


@pytest.mark.parametrize("name", ["methods.md", "format.md"])
def test_every_section_that_code_cites_is_there(name: str) -> None:
    known = sections(text_of(DOCS / name))
    missing = [
        f"{path.relative_to(ROOT)}: {name} §{number}"
        for path in files()
        if path != Path(__file__)
        for page, number in cited_sections(text_of(path), usual_page(str(path)))
        if page == name and number not in known
    ]
    assert known and not missing


def test_a_section_that_is_not_there_is_noticed() -> None:
    page = "## 1 One\n\n### 1.2 Two\n\n1. First\n2. Second\n"
    text = "(methods.md §1.2, §1.3), (§1.2.2–§1.2.3), docs/format.md §4, RFC 9110 §14"
    cited = list(cited_sections(text, "methods.md"))
    missing = [number for name, number in cited if name == "methods.md"]
    assert set(missing) - sections(page) == {"1.3", "1.2.3"}
    assert [pair for pair in cited if pair[0] != "methods.md"] == [
        ("format.md", "4"),
        ("RFC", "14"),
    ]


def test_every_page_and_table_that_code_names_is_there() -> None:
    missing = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in files()
        if path != Path(__file__)
        for name in CITED.findall(text_of(path))
        if not (ROOT / name).exists()
    ]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    assert not broken_links(page)


def test_a_link_that_leads_nowhere_is_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A title\n[a](#a-title) [b](#b) [c](gone.md) [d](page.md#a-title) `[e](f)`\n")
    assert broken_links(page) == ["#b", "gone.md"]


@pytest.mark.parametrize("page", RESULTS, ids=lambda p: p.name)
def test_a_page_of_results_has_few_tables_and_a_section_figures_of_one_commit(page: Path) -> None:
    text = text_of(page)
    assert tables(text) <= MOST_TABLES
    for section in re.split(r"^## ", text, flags=re.MULTILINE):
        commits = len(set(COMMIT.findall(section)))
        assert commits == 1 if tables(section) else commits <= 1, section.splitlines()[0]


@pytest.mark.parametrize("page", RESULTS, ids=lambda p: p.name)
def test_a_page_of_results_is_of_files_as_they_are_written_today(page: Path) -> None:
    """A new version of the format wants new figures."""
    versions = re.findall(r"format version (\d+)", text_of(page))
    assert {int(version) for version in versions} == {VERSION}
