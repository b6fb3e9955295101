"""Records of an evaluation, and the one JSON form of it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from typing import TypeAlias

from gsynopsis.container import LevelSizes
from gsynopsis.evaluation.environment import Build, Machine
from gsynopsis.evaluation.formatting import (
    duration,
    mib,
    pixels,
    scale_text,
    text_table,
)
from gsynopsis.evaluation.metrics import Image8
from gsynopsis.scene.account import Account

Json: TypeAlias = "str | int | float | bool | Sequence[Json] | Mapping[str, Json] | None"
COLUMNS = (
    "level",
    "anchors",
    "slots",
    "PSNR",
    "SSIM",
    "FLIP",
    "PSNR, training photos",
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
PROTOCOL = (
    "Means over the test views of the split. Images are clamped and rounded to 8 bits before they "
    "are compared. 'full' compares every level at the scale of the run, 'photo' at the photos' own "
    "size, where that was measured; 'own' compares level L of 0…M at the scale of the run times "
    "2^(M-L), the multi-resolution protocol of the literature. Figures of different picture sizes "
    "are never comparable with each other; each stands beside its size, pixels. PSNR "
    "over all RGB pixels on [0, 1], identical images count as 100 dB; 'masked' at the scale of the "
    "run over the pixels inside each photo's mask, 'exposed' over the right half after an affine "
    "colour that the left half solves for; 'train' as 'full', on as many training photos, evenly "
    "chosen. SSIM: 11×11 Gaussian window, sigma 1.5, zero padding, no crop. LDR-FLIP: mean "
    "over pixels, 67 pixels a degree, lower is better. Bytes are cumulative (levels "
    "0…L) unless named delta. paper: float32 rows with all offsets; deflate: each delta of those "
    "as one zlib stream of level 6; raw and compact: our own file. Milliseconds are medians over "
    "frames at the scale of the run."
)

PYRAMID = "Lanczos in 8 bits, each size from the stored photo, never from a smaller copy"
"""Method by which photos are made smaller."""


@dataclass(frozen=True)
class Provenance:
    """Origin of a file; unknown facts are None.

    Attributes:
        preset: Preset of the training.
        seed: Seed of the training.
        steps: Training steps in all.
        train_seconds: Training time in all, seconds.
        split: The rule that chose the held-out views.
    """

    preset: str | None = None
    seed: int | None = None
    steps: int | None = None
    train_seconds: float | None = None
    split: str | None = None


@dataclass(frozen=True)
class Timing:
    """Rendering time of one level at the scale of the run, milliseconds per frame.

    Attributes:
        decode_ms: Median of anchors to Gaussians, view-dependent parts included.
        decode_p95_ms: 95th percentile of the same.
        raster_ms: Median of Gaussians to image.
        raster_p95_ms: 95th percentile of the same.
        total_ms: Median of both together.
        total_p95_ms: 95th percentile of the same.
        frames: Frames that were timed.
        views: Different cameras among them.
    """

    decode_ms: float
    decode_p95_ms: float
    raster_ms: float
    raster_p95_ms: float
    total_ms: float
    total_p95_ms: float
    frames: int
    views: int


@dataclass(frozen=True)
class Quality:
    """Distance to the photos at each image size: of one view, or the mean over views.

    None without a measurement: `lpips_*` without a file of weights, `psnr_photo` without a
    comparison at the photos' own size, `flip_*` without flip-evaluator, `psnr_masked` (inside the
    mask) without masks, and `psnr_exposed` (right half, after an affine colour solved on the left
    one) without the option.
    """

    psnr_full: float
    ssim_full: float
    psnr_own: float
    ssim_own: float
    lpips_full: float | None = None
    lpips_own: float | None = None
    psnr_photo: float | None = None
    flip_full: float | None = None
    flip_own: float | None = None
    psnr_masked: float | None = None
    psnr_exposed: float | None = None

    @property
    def masked(self) -> bool:
        """Photos have masks, inside of which they count."""
        return self.psnr_masked is not None

    @property
    def psnr(self) -> float:
        """PSNR of what photos count for: inside of their masks where they have any, dB."""
        return self.psnr_full if self.psnr_masked is None else self.psnr_masked

    def figures(self) -> dict[str, float]:
        """Measured figures by name, rounded: as a file's manifest holds them.

        There `psnr_full` is `psnr`, and no `psnr_photo` stands beside it where photos have masks:
        what is outside was not trained, and finer levels may be farther from it.
        """
        own = {**asdict(self), "psnr_full": self.psnr}
        if self.masked:
            own["psnr_photo"] = None
        return {name: round(value, 5) for name, value in own.items() if value is not None}


@dataclass(frozen=True)
class LevelScore:
    """Everything about one level.

    Attributes:
        level: 0 is the coarsest.
        anchors: Anchors.
        slots: Live slots, that is Gaussians before any are hidden by their opacity.
        own_scale: The photos' size is divided by this for the `own` figures.
        own_size: Width and height of the first held-out view at that scale, pixels.
        quality: Means over the held-out views.
        sizes: Bytes in four accountings.
        timing: Milliseconds.
        psnr_train: Mean PSNR on training photos at the scale of the run, dB: far above `psnr_full`
            the model is overfit, close to it underfit or well matched. None: no photo is held out.
        psnr_train_masked: The same inside the masks; None without masks.
    """

    level: int
    anchors: int
    slots: int
    own_scale: float
    own_size: tuple[int, int]
    quality: Quality
    sizes: LevelSizes
    timing: Timing
    psnr_train: float | None = None
    psnr_train_masked: float | None = None


@dataclass(frozen=True)
class ViewScore:
    """One held-out view at one level."""

    view: str
    level: int
    quality: Quality


@dataclass(frozen=True)
class Pictures:
    """One held-out view to look at: the photo and each level's rendering, at the full scale."""

    view: str
    truth: Image8
    levels: tuple[Image8, ...]


@dataclass(frozen=True)
class Switch:
    """Visibility of a switch from one level to the next finer one on a smooth flight.

    Change of colour from a frame to the next, of 255, the camera's own motion taken out.

    Attributes:
        level: The finer one.
        hard_largest: Largest change of a pixel's channel, switched at once.
        hard_mean: Largest mean change over an image, switched at once.
        faded_largest: As `hard_largest`, faded.
        faded_mean: As `hard_mean`, faded.
    """

    level: int
    hard_largest: float
    hard_mean: float
    faded_largest: float
    faded_mean: float


@dataclass(frozen=True)
class AtPhotoSize:
    """Photos that the `photo` figures were measured on.

    Attributes:
        width: Width of the first of these photos, pixels.
        height: Its height, pixels.
        views: Held-out photos that were compared at their own size.
        held_out: Held-out photos there are.
    """

    width: int
    height: int
    views: int
    held_out: int


@dataclass(frozen=True)
class Report:
    """One evaluation of one file.

    Attributes:
        scene: Name of the scene.
        fingerprint: Digest that tells scenes of one name apart.
        scale: The photos' width and height were divided by this.
        width: Width of the first held-out view at that scale, pixels.
        height: Its height at that scale, pixels.
        notes: Oddities in how the scene was read.
        account: Account of the scene's folder: files used, and files that are not.
        provenance: Origin of the file.
        renderer: Name of the rasteriser.
        lpips: Name of the learnt measure, None if there was none.
        machine: Machine of the measurement.
        build: Build of gsynopsis.
        levels: Coarsest first.
        views: Every view at every level, views in the split's order.
        pictures: Not part of the JSON form.
        switches: Visibility of changes of levels, if that was measured.
        photo: Photos of the `photo` figures, None if there are none.
        train_views: Training photos of the `train` figures, and all there are.
    """

    scene: str
    fingerprint: str
    scale: float
    width: int
    height: int
    notes: tuple[str, ...]
    account: Account
    provenance: Provenance
    renderer: str
    lpips: str | None
    machine: Machine
    build: Build
    levels: tuple[LevelScore, ...]
    views: tuple[ViewScore, ...]
    pictures: tuple[Pictures, ...] = field(default=(), repr=False)
    switches: tuple[Switch, ...] = ()
    photo: AtPhotoSize | None = None
    train_views: tuple[int, int] = (0, 0)

    @property
    def masked(self) -> bool:
        """Photos have masks, inside of which `Quality.psnr` counts."""
        return self.levels[-1].quality.masked

    def __repr__(self) -> str:
        """Counts; the figures of every view fill pages."""
        views = len({score.view for score in self.views})
        size = f"{self.width} × {self.height}"
        return f"Report({self.scene}: {len(self.levels)} levels, {views} views of {size} pixels)"

    def _repr_html_(self) -> str:
        """The table of levels, for notebooks."""
        return f"<pre>{escape(report_table(self))}</pre>"


def level_row(report: Report, score: LevelScore) -> dict[str, Json]:
    """One level as flat columns; the names are a promise to scripts."""
    row: dict[str, Json] = {"level": score.level, "anchors": score.anchors, "slots": score.slots}
    row |= asdict(score.quality)
    row |= {"psnr_train": score.psnr_train, "psnr_train_masked": score.psnr_train_masked}
    row |= asdict(score.sizes)
    row |= {"render_ms": score.timing.total_ms, "own_scale": score.own_scale}
    row |= asdict(score.timing)
    row |= {"width_full": report.width, "height_full": report.height}
    row |= {"width_own": score.own_size[0], "height_own": score.own_size[1]}
    photo = report.photo
    row |= {"width_photo": photo.width if photo else None}
    return row | {"height_photo": photo.height if photo else None}


def view_row(score: ViewScore) -> dict[str, Json]:
    """One view at one level as flat columns."""
    row: dict[str, Json] = {"view": score.view, "level": score.level}
    return row | asdict(score.quality)


def report_document(report: Report) -> dict[str, Json]:
    """The report as plain values: what `metrics.json` holds."""
    document: dict[str, Json] = {
        "scene": report.scene,
        "scale": report.scale,
        "preset": report.provenance.preset,
        "seed": report.provenance.seed,
        "steps": report.provenance.steps,
        "train_seconds": report.provenance.train_seconds,
        "anchors": report.levels[-1].anchors,
        "levels": [level_row(report, score) for score in report.levels],
    }
    return document | {
        "fingerprint": report.fingerprint,
        "size": [report.width, report.height],
        "photo_size": [report.photo.width, report.photo.height] if report.photo else None,
        "photo_views": report.photo.views if report.photo else 0,
        "held_out_views": len({score.view for score in report.views}),
        "train_views": list(report.train_views),
        "split": report.provenance.split,
        "pyramid": PYRAMID,
        "notes": list(report.notes),
        "account": report.account.document(),
        "protocol": PROTOCOL,
        "renderer": report.renderer,
        "lpips": report.lpips or "n/a",
        "machine": asdict(report.machine),
        "gsynopsis": report.build.version,
        "commit": report.build.commit,
        "per_view": [view_row(score) for score in report.views],
        "popping": [asdict(switch) for switch in report.switches],
    }


def report_json(report: Report) -> str:
    """The text of `metrics.json`, which is also what `--json` prints; no NaN, no Infinity."""
    text = json.dumps(report_document(report), indent=2, ensure_ascii=False, allow_nan=False)
    return text + "\n"


def columns_of(report: Report) -> list[str]:
    """COLUMNS, those of quality with the size of their images."""
    named = {"PSNR": pixels(report.width, report.height), "SSIM": ""}
    if report.photo:
        named["PSNR at photo size"] = pixels(report.photo.width, report.photo.height)
    named["SSIM"] = named["PSNR"]
    named["PSNR"] += ", inside the masks" if report.masked else ""
    sized = {"PSNR at photo size": "PSNR"}
    return [f"{sized.get(n, n)}, {named[n]}" if n in named else n for n in COLUMNS]


def level_cells(score: LevelScore) -> list[str]:
    """One level as text, in the order of COLUMNS."""
    quality, sizes = score.quality, score.sizes
    return [
        f"L{score.level}",
        f"{score.anchors:,}",
        f"{score.slots:,}",
        f"{quality.psnr:.2f}",
        f"{quality.ssim_full:.4f}",
        "n/a" if quality.flip_full is None else f"{quality.flip_full:.4f}",
        _decibels(score.psnr_train_masked if quality.masked else score.psnr_train),
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


def switch_cells(switch: Switch) -> list[str]:
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


def report_table(report: Report) -> str:
    """The tables of levels, and of switches if they were measured, that the command line prints.

    What more was measured stands in the CSV and the report.
    """
    header = ["level", "anchors", "MiB", "dB", "ms"]
    rows = [
        [
            f"L{score.level}",
            f"{score.anchors:,}",
            mib(score.sizes.bytes_compact),
            f"{score.quality.psnr:.2f}",
            f"{score.timing.total_ms:.1f}",
        ]
        for score in report.levels
    ]
    tables = [f"{text_table(header, rows)}\n{sizes_text(report)}"]
    if report.switches:
        switches = [switch_cells(switch) for switch in report.switches]
        tables.append(text_table(SWITCH_COLUMNS, switches))
    return "\n\n".join(tables)


def sizes_text(report: Report) -> str:
    """Text on the images that the decibels are of, and the finest level at the photos' own size."""
    count = len({score.view for score in report.views})
    where = " inside the masks" if report.masked else ""
    said = f"dB: PSNR{where} of {count} {views_text(report)}"
    said += f" of {pixels(report.width, report.height)}"
    return f"{said}{at_photo_size_text(report)}{adjusted_text(report)}{train_text(report)}"


def at_photo_size_text(report: Report) -> str:
    """End of the line on images: the levels' PSNR at the photos' own size."""
    photo, finest = report.photo, report.levels[-1].quality.psnr_photo
    if photo is None or finest is None:
        return "; at the photos' own size: not measured"
    if report.scale == 1:
        return ", the photos' own size"
    size = pixels(photo.width, photo.height)
    some = "all" if photo.views == photo.held_out else f"{photo.views}, evenly chosen,"
    values = " ".join(_decibels(score.quality.psnr_photo) for score in report.levels)
    whole = " of whole photos" if report.masked else ""
    return f"\n    {values} dB{whole} at the photos' own size, {size} ({some} of {photo.held_out})"


def train_text(report: Report) -> str:
    """Line of the levels' PSNR on training photos; empty where none was measured."""
    lines, (some, count) = "", report.train_views
    whole = ", whole" if report.masked else ""
    for name, where in (("psnr_train_masked", ", inside the masks"), ("psnr_train", whole)):
        values = [getattr(score, name) for score in report.levels]
        if values[-1] is not None:
            of = f"{some} of {count}" if some < count else f"the {count}"
            lines += f"\n    {' '.join(map(_decibels, values))} dB on {of} training photos{where}"
    return lines


def adjusted_text(report: Report) -> str:
    """Figures of another part of each photo, a line each; empty where there are none."""
    lines, exposed = "", "in the right half, in the photo's exposure as the left half solves it"
    whole = [("psnr_full", "of whole photos")] if report.masked else []
    for name, what in (*whole, ("psnr_exposed", exposed)):
        values = [getattr(score.quality, name) for score in report.levels]
        if values[-1] is not None:
            lines += f"\n    {' '.join(map(_decibels, values))} dB {what}"
    return lines


def views_text(report: Report) -> str:
    """Name of the views: held out, or (split `none`) seen in training."""
    return "views seen in training" if report.provenance.split == "none" else "held-out views"


def photos_text(report: Report) -> str:
    """The photos' own size, and how many of them were compared at it."""
    photo = report.photo
    if photo is None:
        return "not measured at their own size"
    size = pixels(photo.width, photo.height)
    return f"{size}, {photo.views} of {photo.held_out} compared at that size"


def settings_of(report: Report) -> list[tuple[str, str]]:
    """Settings of the measurement, as pairs of a name and a text."""
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
        ("pyramid", PYRAMID),
        ("renderer", report.renderer),
        ("timing", f"median of {timing.frames} frames, {timing.views} cameras"),
        ("LPIPS", report.lpips or "n/a (no weights supplied)"),
        ("machine", f"{machine.cpu}, {machine.cores} cores, {machine.threads} threads{gpu}"),
        ("software", f"Python {machine.python}, PyTorch {machine.torch}, {machine.system}"),
        ("gsynopsis", f"{report.build.version}{commit}"),
    ]
