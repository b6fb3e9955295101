"""Numbers as people read them, the same in tables, sheets and reports. MiB is 2²⁰ bytes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # The rest of this room needs torch; words do not.
    from gsynopsis.evaluation.report import LevelScore, Report, Switch

COLUMNS = (
    "level",
    "anchors",
    "slots",
    "PSNR",
    "SSIM",
    "FLIP",
    "PSNR at photo size",
    "own size",
    "PSNR own",
    "SSIM own",
    "raw MiB",
    "deflate MiB",
    "compact MiB",
    "delta MiB",
    "ms",
)

SWITCH_COLUMNS = ("switch", "largest, hard", "faded", "mean, hard", "faded")


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


def columns_of(report: "Report") -> list[str]:
    """COLUMNS, those of quality with the size of their images."""
    named = {"PSNR": pixels(report.width, report.height), "SSIM": ""}
    if report.photo:
        named["PSNR at photo size"] = pixels(report.photo.width, report.photo.height)
    named["SSIM"] = named["PSNR"]
    sized = {"PSNR at photo size": "PSNR"}
    return [f"{sized.get(n, n)}, {named[n]}" if n in named else n for n in COLUMNS]


def level_cells(score: "LevelScore") -> list[str]:
    """One level as text, in the order of COLUMNS."""
    quality, sizes = score.quality, score.sizes
    return [
        f"L{score.level}",
        f"{score.anchors:,}",
        f"{score.slots:,}",
        f"{quality.psnr_full:.2f}",
        f"{quality.ssim_full:.4f}",
        "n/a" if quality.flip_full is None else f"{quality.flip_full:.4f}",
        _decibels(quality.psnr_photo),
        pixels(*score.own_size),
        f"{quality.psnr_own:.2f}",
        f"{quality.ssim_own:.4f}",
        mib(sizes.bytes_raw),
        mib(sizes.bytes_deflate),
        mib(sizes.bytes_compact),
        mib(sizes.delta_compact),
        f"{score.timing.total_ms:.1f}",
    ]


def _decibels(value: float | None) -> str:
    return "n/a" if value is None else f"{value:.2f}"


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns under a rule, the first to the left and the others to the right."""
    lines = [header, *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]

    def joined(cells: Sequence[str]) -> str:
        pairs = list(zip(cells, widths, strict=True))
        return "  ".join([pairs[0][0].ljust(pairs[0][1]), *(c.rjust(w) for c, w in pairs[1:])])

    rule = "  ".join("─" * width for width in widths)
    return "\n".join([joined(header), rule, *(joined(row) for row in rows)])


def switch_cells(switch: "Switch") -> list[str]:
    """One switch of levels as `SWITCH_COLUMNS`; what fading leaves in percent."""
    largest = switch.faded_largest / max(switch.hard_largest, 1e-9)
    mean = switch.faded_mean / max(switch.hard_mean, 1e-9)
    return [
        f"L{switch.level - 1} → L{switch.level}",
        f"{switch.hard_largest:.1f}",
        f"{switch.faded_largest:.1f} ({largest:.0%})",
        f"{switch.hard_mean:.3f}",
        f"{switch.faded_mean:.3f} ({mean:.0%})",
    ]


def report_table(report: "Report") -> str:
    """The tables of levels, and of switches if they were measured, that the command line prints.

    What more was measured stands in the CSV and the report.
    """
    header = ["level", "anchors", "MiB", "dB", "ms"]
    rows = [
        [
            f"L{score.level}",
            f"{score.anchors:,}",
            mib(score.sizes.bytes_compact),
            f"{score.quality.psnr_full:.2f}",
            f"{score.timing.total_ms:.1f}",
        ]
        for score in report.levels
    ]
    tables = [f"{text_table(header, rows)}\n{sizes_text(report)}"]
    if report.switches:
        switches = [switch_cells(switch) for switch in report.switches]
        tables.append(text_table(SWITCH_COLUMNS, switches))
    return "\n\n".join(tables)


def sizes_text(report: "Report") -> str:
    """Of which images the decibels are, and what the finest level has at the photos' own size."""
    count = len({score.view for score in report.views})
    said = f"dB: PSNR of {count} {views_text(report)} of {pixels(report.width, report.height)}"
    said += adjusted_text(report)
    photo, finest = report.photo, report.levels[-1].quality.psnr_photo
    if photo is None or finest is None:
        return f"{said}; at the photos' own size: not measured"
    if report.scale == 1:
        return f"{said}, the photos' own size"
    size = pixels(photo.width, photo.height)
    some = "all" if photo.views == photo.held_out else f"{photo.views}, evenly chosen,"
    values = " ".join(_decibels(score.quality.psnr_photo) for score in report.levels)
    return f"{said}\n    {values} dB at the photos' own size, {size} ({some} of {photo.held_out})"


def adjusted_text(report: "Report") -> str:
    """Figures of a part of each photo, a line each; empty where there are none."""
    lines = ""
    for name, what in (
        ("psnr_masked", "inside the masks"),
        ("psnr_exposed", "in the right half, in the photo's exposure as the left half solves it"),
    ):
        values = [getattr(score.quality, name) for score in report.levels]
        if values[-1] is not None:
            lines += f"\n    {' '.join(map(_decibels, values))} dB {what}"
    return lines


def views_text(report: "Report") -> str:
    """What the views are: held out, or (split `none`) seen in training."""
    return "views seen in training" if report.provenance.split == "none" else "held-out views"


def photos_text(report: "Report") -> str:
    """The photos' own size, and how many of them were compared at it."""
    photo = report.photo
    if photo is None:
        return "not measured at their own size"
    size = pixels(photo.width, photo.height)
    return f"{size}, {photo.views} of {photo.held_out} compared at that size"


def settings_of(report: "Report") -> list[tuple[str, str]]:
    """What was measured, how and where, as pairs of a name and a text."""
    provenance, machine = report.provenance, report.machine
    trained = "n/a" if provenance.train_seconds is None else duration(provenance.train_seconds)
    commit = f" ({report.build.commit[:10]})" if report.build.commit else ""
    gpu = f", {machine.gpu}" if machine.gpu else ""
    timing = report.levels[-1].timing
    return [
        ("scene", report.scene),
        ("scale", f"{scale_text(report.scale)} ({pixels(report.width, report.height)})"),
        ("photos", photos_text(report)),
        ("preset", provenance.preset or "n/a"),
        ("seed", "n/a" if provenance.seed is None else str(provenance.seed)),
        ("steps", "n/a" if provenance.steps is None else f"{provenance.steps:,}"),
        ("training", trained),
        ("split", provenance.split or "n/a"),
        ("views", f"{len({score.view for score in report.views})} {views_text(report)}"),
        ("pyramid", report.pyramid),
        ("renderer", report.renderer),
        ("timing", f"median of {timing.frames} frames, {timing.views} cameras"),
        ("LPIPS", report.lpips or "n/a (no weights supplied)"),
        ("machine", f"{machine.cpu}, {machine.cores} cores, {machine.threads} threads{gpu}"),
        ("software", f"Python {machine.python}, PyTorch {machine.torch}, {machine.system}"),
        ("gsynopsis", f"{report.build.version}{commit}"),
    ]
