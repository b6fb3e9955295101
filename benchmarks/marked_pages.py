"""What benchmarks that write into docs share: the marked part of a page, and the commit."""

from pathlib import Path

from gsynopsis.evaluate.machine import this_build

END = "<!-- end -->"


def put(page: Path, script: str, text: str) -> None:
    """Replace what stands between the marks of a script, `<!-- begin: benchmarks/… -->` and `END`.

    Args:
        page: A Markdown page that holds the marks.
        script: The script's name, as `size.py`.
        text: Markdown; blank lines around it are ours.
    """
    begin = f"<!-- begin: benchmarks/{script} -->"
    old = page.read_text("utf-8")
    before, rest = old.split(begin, 1)
    after = rest.split(END, 1)[1]
    page.write_text(f"{before}{begin}\n\n{text.rstrip()}\n\n{END}{after}", "utf-8")


def short_commit() -> str:
    """The commit that measured, twelve digits; `unknown` outside of a checkout."""
    return (this_build().commit or "unknown")[:12]
