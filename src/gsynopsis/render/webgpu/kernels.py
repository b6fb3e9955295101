"""Kernels as text: files of gsynopsis/wgsl, the parts they share, and the layout of parameters.

A kernel is a file `NAME.wgsl` with one entry point `main`, in the folder of its subject. A line
`//use A B` takes in the files `parts/A.wgsl` and `parts/B.wgsl`, each once. Its numbers are a
uniform `struct Params` at binding 0, whose layout is read from the text; buffers follow from
binding 1 up.
"""

import re
import struct
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "wgsl"
SUBJECTS = ("decode", "raster", "training", "viewer")
CODES = {"u32": "I", "i32": "i", "f32": "f"}


@dataclass(frozen=True)
class Kernel:
    """A kernel's text and the layout of its parameters.

    Attributes:
        name: Of its file.
        source: WGSL with its parts.
        fields: Names of the parameters in order.
        packing: Their format for `struct`; empty if it has none.
        buffers: Of its storage buffers, the number.
    """

    name: str
    source: str
    fields: tuple[str, ...]
    packing: str
    buffers: int

    def packed(self, **values: float) -> bytes:
        """Parameters as bytes, a multiple of 16; every field must be given."""
        if not self.fields:
            return b""
        if set(values) != set(self.fields):
            odd = sorted(set(values) ^ set(self.fields))
            raise ValueError(f"kernel {self.name}: parameters {odd}")
        raw = struct.pack("<" + self.packing, *(values[name] for name in self.fields))
        return raw + bytes(-len(raw) % 16)


@cache
def kernel_files() -> dict[str, Path]:
    """The file of each kernel, by name in order."""
    found = [path for subject in SUBJECTS for path in (FOLDER / subject).glob("*.wgsl")]
    return {path.stem: path for path in sorted(found, key=lambda path: path.stem)}


@cache
def load_kernel(name: str) -> Kernel:
    """A kernel by name, with its parts."""
    source = with_parts(kernel_files()[name])
    fields: tuple[str, ...] = ()
    packing = ""
    if "struct Params" in source:
        flat = _flat_fields(source, "Params")
        fields = tuple(field for field, _ in flat)
        packing = "".join(CODES[kind] for _, kind in flat)
    buffers = len(re.findall(r"var<storage", source))
    return Kernel(name, source, fields, packing, buffers)


def with_parts(path: Path) -> str:
    """A file's text with its parts."""
    return "\n".join(_with_parts(path.read_text("utf-8"), set()))


def _with_parts(text: str, taken: set[str]) -> list[str]:
    """Lines of a text after those of its parts, each part once."""
    before, own = list[str](), list[str]()
    for line in text.splitlines():
        if not line.startswith("//use "):
            own.append(line)
            continue
        for part in line.split()[1:]:
            if part not in taken:
                taken.add(part)
                before += _with_parts((FOLDER / "parts" / f"{part}.wgsl").read_text("utf-8"), taken)
    return before + own


def _flat_fields(source: str, name: str) -> list[tuple[str, str]]:
    """Names and types of a struct's scalars; of structs within it (16-byte multiples) theirs."""
    body = re.search(rf"struct {name} \{{(.*?)\}}", source, re.DOTALL)
    if body is None:
        raise ValueError(f"no struct {name}")
    flat: list[tuple[str, str]] = []
    for field, kind in re.findall(r"(\w+): (\w+)", re.sub(r"//.*", "", body[1])):
        flat += [(field, kind)] if kind in CODES else _flat_fields(source, kind)
    return flat
