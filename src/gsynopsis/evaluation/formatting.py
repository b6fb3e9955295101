"""Numbers as people read them, the same in tables, sheets and reports. MiB is 2²⁰ bytes."""

from collections.abc import Sequence


def mib(count: int) -> str:
    """Bytes in MiB, three significant digits or so."""
    value = count / 2**20
    return f"{value:.3f}" if value < 1 else f"{value:.2f}" if value < 100 else f"{value:.0f}"


def size(count: int) -> str:
    """Bytes with the unit that fits."""
    if count < 1024:
        return f"{count} B"
    return f"{count / 1024:.1f} KiB" if count < 2**20 else f"{mib(count)} MiB"


def count(number: int) -> str:
    """`950`, `14.2 k`, `1.31 M`."""
    if number < 1000:
        return str(number)
    return f"{number / 1e3:.1f} k" if number < 999_950 else f"{number / 1e6:.2f} M"


def memory(number: int) -> str:
    """Bytes of memory: `612 MiB`, `1.4 GiB`."""
    return f"{number / 2**20:.0f} MiB" if number < 2**30 else f"{number / 2**30:.1f} GiB"


def scale_text(scale: float) -> str:
    """`1/4` for 4, `1/2.5` for 2.5, `1` for 1."""
    return "1" if scale == 1 else f"1/{scale:g}"


def duration(seconds: float) -> str:
    """`48 s`, `3 min 20 s`, `2 h 05 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min"


def pixels(width: int, height: int) -> str:
    """The size of an image: `480 × 320`."""
    return f"{width} × {height}"


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns under a rule, the first to the left and the others to the right."""
    lines = [header, *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]

    def joined(cells: Sequence[str]) -> str:
        pairs = list(zip(cells, widths, strict=True))
        return "  ".join([pairs[0][0].ljust(pairs[0][1]), *(c.rjust(w) for c, w in pairs[1:])])

    rule = "  ".join("─" * width for width in widths)
    return "\n".join([joined(header), rule, *(joined(row) for row in rows)])
