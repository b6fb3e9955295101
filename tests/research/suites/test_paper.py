"""Tables in the paper's layout: means over scenes and seeds, and the paper's figures as printed."""

from research.suites.paper import level_table, published_tables, size_table


def row(method: str, scene: str, level: int, psnr: float, size: int) -> dict[str, object]:
    sizes = {"bytes_compact": size, "bytes_raw": 4 * size, "delta_compact": size // 2}
    figures = {"psnr_full": psnr, "ssim_full": 0.5, "flip_full": 0.1}
    return {"method": method, "scene": scene, "level": level, "slots": 8, **sizes, **figures}


ROWS = [
    row("ours", "a", 0, 20.0, 2**20),
    row("ours", "b", 0, 30.0, 3 * 2**20),
    row("ours", "a", 1, 32.0, 2**22),
    row("ours", "b", 1, 34.0, 2**22),
    row("one level", "a", 1, 31.0, 2**23),
]


def test_levels_are_means_over_scenes_and_what_was_not_measured_is_not_a_number() -> None:
    table = level_table(ROWS, "full")
    assert table.columns == ("level", "method", "PSNR", "SSIM", "FLIP", "ms", "MiB", "ΔMiB")
    assert table.lines[0] == ("L0", "ours", "25.00", "0.500", "0.100", "n/a", "2.000", "1.000")
    assert [line[:3] for line in table.lines[1:]] == [
        ("L1", "ours", "33.00"),
        ("L1", "one level", "31.00"),
    ]
    measured = level_table([{**r, "lpips_full": 0.2, "total_ms": 3.25} for r in ROWS], "full")
    assert measured.columns[5:7] == ("LPIPS", "ms") and measured.lines[0][5:7] == ("0.200", "3.2")


def test_sizes_are_those_of_the_finest_level() -> None:
    rows = [{**r, "seconds": 90.0} for r in ROWS]
    ours, other = size_table(rows).lines
    assert ours == ("ours", "n/a", "n/a", "16.000", "4.000", f"{2**22:.1f}", "1.5")
    assert other[4] == "8.000"


def test_the_paper_s_figures_are_there_for_each_level_and_data_set() -> None:
    tables = published_tables()
    assert [table.title for table in tables][:2] == ["Mip-NeRF 360", "BungeeNeRF"]
    for table in tables:
        for method in ("3dgs", "octree-gs", "lapisgs", "igs"):
            assert [line[0] for line in table.lines if line[1] == method] == [
                "L0",
                "L1",
                "L2",
                "L3",
            ]
    finest = [line for line in tables[0].lines if line[:2] == ("L3", "igs")]
    assert finest == [("L3", "igs", "27.17", "0.790", "0.224", "118", "90.11", "27.32", "32.2")]
