"""A finished splat and its levels side by side from a held-out camera: docs/unfold_levels.png.

    python -m benchmarks.unfold.picture SPLATS.ply FILE.gsyn --scene SCENE [--scale 2]

Bytes and the PSNR on all held-out photos of the scene that the splats are of stand above them.
"""

import argparse
from pathlib import Path

import torch
from PIL import Image, ImageDraw, ImageFont

from benchmarks.unfold.run import against
from gsynopsis.container.info import describe
from gsynopsis.container.reader import read_gsyn
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.model.splats import SplatModel, decoder_of
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.load import load_scene

PICTURE = Path(__file__).parents[2] / "docs" / "unfold_levels.png"
TITLE, GAP, INK, PAPER = 24, 6, (20, 20, 20), (255, 255, 255)
"""Height of the line above each picture and width between them, pixels, and colours."""


def main() -> None:
    """Draw the input and all levels."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n")[0])
    parser.add_argument("splats", type=Path)
    parser.add_argument("file", type=Path)
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--scale", type=float, default=1.0)
    args = parser.parse_args()
    scene = load_scene(args.scene)
    camera = scene.camera(scene.test[0], args.scale)
    given, levels = (
        SplatModel(read_splats(args.splats).levels[-1]),
        decoder_of(read_gsyn(args.file)),
    )
    shown = [("the input", given, 0, args.splats.stat().st_size)]
    shown += [(f"level {k.level}", levels, k.level, k.bytes) for k in describe(args.file).levels]
    width, height = camera.width + GAP, camera.height + TITLE
    sheet = Image.new("RGB", (width * len(shown) - GAP, height), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for column, (name, model, level, size) in enumerate(shown):
        with torch.no_grad():
            painted = LevelRenderer(model, CpuRenderer(1)).paint(camera, level)
        image = Image.fromarray(painted)
        sheet.paste(image, (column * width, TITLE))
        db = against(model, level, scene, args.scale)
        line = f"{name}: {size / 1024:,.0f} KiB, {db:.2f} dB"
        draw.text((column * width, 4), line, INK, font)
        print(line, flush=True)
    sheet.save(PICTURE, optimize=True)
    print(PICTURE)


if __name__ == "__main__":
    main()
