"""Ways to spoil a folder: bytes, text, JSON, tensors, and the kind of file behind a name.

Of what stands in a compression or before a checksum the contents are spoilt as well, and packed
again as its writers would, so that readers do not stop at the checksum.
"""

import gzip
import json
import os
import re
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from benchmarks.robust.mutants import damaged
from gsynopsis.formats.readers.spz import HEAD
from gsynopsis.formats.writers.sog import zipped

Rng = np.random.Generator
OUTSIDE = "/".join(("..", "secret", "file"))
"""A name that leads out of the folder it stands in."""
VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 2**31, 2**63, 2**64, 10**400, 1e308, -1e308, 1e-320, 0.5),
    *("", "a", "-1", "\0", "a\0b", "\ud800", OUTSIDE, "/dev/zero", "é" * 300),
    *("x" * 100_000, [], {}, [[]], {"": {}}, [1] * 5, list(range(1000))),
)
DEPTHS = (40, 900, 3000)
TOKENS = (
    *("nan", "inf", "-1", "0", "1e308", "9" * 400, "x" * 100_000),
    *("", "\0", "é", OUTSIDE),
)
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
LARGE = 3 << 30
"""Bytes of a sparse file."""
ZEROS, BOMB = 1 << 24, 128
"""Bytes of a run of zeros, and their number in a stream that inflates to 2 GiB."""
PNG = b"\x89PNG\r\n\x1a\n"


def spoil(rng: Rng, folder: Path, names: tuple[str, ...], secret: Path) -> str:
    """Spoil one of the files of a folder; what was done to which."""
    path = folder / names[int(rng.integers(len(names)))]
    if rng.integers(20) == 0:
        return f"{replace(rng, path, secret)} as {path.name}"
    return f"{spoil_file(rng, path)} on {path.name}"


def spoil_file(rng: Rng, path: Path) -> str:
    """Spoil a file's contents; how."""
    kinds: list[Callable[[Rng, Path], None]] = [spoil_bytes, spoil_numbers, spoil_lines]
    start = path.read_bytes()[:8]
    kinds += [inside for magic, inside in PACKED.items() if start.startswith(magic)] * 6
    if path.suffix in (".json", ".toml"):
        kinds += [spoil_json] * 6 if path.suffix == ".json" else [spoil_numbers] * 3
    if path.suffix == ".safetensors":
        kinds = [spoil_bytes, spoil_tensor, spoil_tensor, spoil_state, spoil_state]
    chosen = kinds[int(rng.integers(len(kinds)))]
    chosen(rng, path)
    return chosen.__name__


def spoil_bytes(rng: Rng, path: Path) -> None:
    """Bits, runs, cuts, repeats and swaps; now and then all but a beginning goes."""
    data = path.read_bytes()
    if not data:
        return
    if rng.integers(6) == 0:
        path.write_bytes(data[: int(rng.integers(len(data)))])
    else:
        path.write_bytes(damaged(rng, data))


def spoil_numbers(rng: Rng, path: Path) -> None:
    """Other numbers or words where a text has numbers."""
    data = path.read_bytes()
    places = list(NUMBER.finditer(data[: 1 << 16]))
    if not places:
        return spoil_bytes(rng, path)
    place = places[int(rng.integers(len(places)))]
    token = TOKENS[int(rng.integers(len(TOKENS)))].encode()
    path.write_bytes(data[: place.start()] + token + data[place.end() :])


def spoil_lines(rng: Rng, path: Path) -> None:
    """A line more, less, or twice, or one of a megabyte."""
    lines = path.read_bytes().split(b"\n")
    at, kind = int(rng.integers(len(lines))), int(rng.integers(4))
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(at, lines[int(rng.integers(len(lines)))])
    elif kind == 2:
        lines[at] = lines[at] * int(rng.integers(2, 50))
    else:
        lines.insert(at, b"x" * 1_000_000)
    path.write_bytes(b"\n".join(lines))


def spoil_json(rng: Rng, path: Path) -> None:
    """Another value, a missing one, or one that is nested deeply, anywhere in a document."""
    path.write_text(changed_json(rng, path.read_text("utf-8")), "utf-8", "surrogatepass")


def changed_json(rng: Rng, text: str) -> str:
    """The same document with one value changed."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        return text
    if rng.integers(15) == 0:
        depth = DEPTHS[int(rng.integers(len(DEPTHS)))]
        kind = '{"a":' if rng.integers(2) else "["
        nested = kind * depth + "1" + ("}" if kind != "[" else "]") * depth
        mark = json.dumps("nested here")
        return json.dumps(changed(rng, document, "nested here")).replace(mark, nested)
    return json.dumps(changed(rng, document, VALUES[int(rng.integers(len(VALUES)))]))


def changed(rng: Rng, value: Any, new: Any) -> Any:
    """A document with another value at one place, or without it."""
    if isinstance(value, dict | list) and value and rng.integers(8):
        keys: list[Any] = list(value) if isinstance(value, dict) else list(range(len(value)))
        key = keys[int(rng.integers(len(keys)))]
        if rng.integers(8) == 0:
            del value[key]
        else:
            value[key] = changed(rng, value[key], new)
        return value
    return new


def spoil_tensor(rng: Rng, path: Path) -> None:
    """A tensor less, more, of another type or shape, or with other values."""
    tensors, metadata = tensors_of(path)
    name = sorted(tensors)[int(rng.integers(len(tensors)))]
    tensor, kind = tensors[name], int(rng.integers(8))
    if kind == 0:
        del tensors[name]
    elif kind == 1:
        tensors[f"{name}x"] = tensor.clone()
    elif kind == 2:
        types = (torch.float16, torch.float64, torch.int32, torch.int64, torch.bool, torch.uint8)
        tensors[name] = tensor.to(types[int(rng.integers(len(types)))])
    elif kind == 3:
        tensors[name] = tensor.reshape(-1)[: int(rng.integers(tensor.numel() + 1))].clone()
    elif kind == 4:
        tensors[name] = torch.cat([tensor[None], tensor[None]]).clone()
    elif kind == 5:
        tensors[name] = tensor.T.contiguous() if tensor.ndim == 2 else tensor[..., None].clone()
    else:
        flat = tensor.reshape(-1).clone()
        if len(flat):
            extreme = (float("nan"), float("inf"), 3e38, -3e38, 1e-40, -1.0, 2.0**40)
            value = extreme[int(rng.integers(len(extreme)))]
            flat[int(rng.integers(len(flat)))] = (
                value if flat.is_floating_point() else int(rng.integers(-(2**40), 2**40)) % 251
            )
            if flat.dtype == torch.int64:
                flat[0] = int(rng.integers(-(2**62), 2**62))
        tensors[name] = flat.reshape(tensor.shape)
    save_file(tensors, path, metadata=metadata)


def spoil_state(rng: Rng, path: Path) -> None:
    """Another record, or other settings in it."""
    tensors, metadata = tensors_of(path)
    state = metadata["state"]
    if rng.integers(3) == 0:
        record = json.loads(state)
        record["config"] = changed_json(rng, record["config"])
        state = json.dumps(record)
    else:
        state = changed_json(rng, state)
    metadata["state"] = state.encode("utf-8", "replace").decode()
    save_file(tensors, path, metadata=metadata)


def in_zip(rng: Rng, path: Path) -> None:
    """A file of a zip; JSON as often as the others together."""
    with zipfile.ZipFile(path) as bundle:
        members = {name: bundle.read(name) for name in bundle.namelist()}
    documents = [name for name in members if name.endswith(".json")]
    names = documents if documents and rng.integers(2) else list(members)
    name = names[int(rng.integers(len(names)))]
    member = path.with_name(f"member{Path(name).suffix}")
    member.write_bytes(members[name])
    spoil_file(rng, member)
    path.write_bytes(zipped(members | {name: member.read_bytes()}))
    member.unlink()


def in_gzip(rng: Rng, path: Path) -> None:
    """Contents of a gzip."""
    raw = gzip.decompress(path.read_bytes())
    if rng.integers(50):
        path.write_bytes(gzip.compress(damaged(rng, raw), 1))
    else:
        path.write_bytes(bomb(raw, 16 + zlib.MAX_WBITS))


def in_streams(rng: Rng, path: Path) -> None:
    """Contents of a zstd stream of SPZ 4, most often as long as they were."""
    from zstandard import ZstdCompressor, ZstdDecompressor

    data = path.read_bytes()
    (table,) = struct.unpack_from("<I", data, HEAD.size)
    count = HEAD.unpack_from(data)[-1]
    sizes = [struct.unpack_from("<QQ", data, table + 16 * number) for number in range(count)]
    streams, at = list[bytes](), table + 16 * count
    for stored, _ in sizes:
        streams.append(ZstdDecompressor().decompress(data[at : at + stored]))
        at += stored
    chosen = int(rng.integers(count))
    size, changed = len(streams[chosen]), damaged(rng, streams[chosen])
    streams[chosen] = changed[:size].ljust(size, b"\0") if rng.integers(4) else changed
    packed = [ZstdCompressor(1).compress(stream) for stream in streams]
    pairs = zip(packed, streams, strict=True)
    entries = b"".join(struct.pack("<QQ", len(new), len(raw)) for new, raw in pairs)
    path.write_bytes(data[:table] + entries + b"".join(packed))


def in_png(rng: Rng, path: Path) -> None:
    """A chunk of a PNG, or what its pixels' stream holds."""
    data, at, chunks = path.read_bytes(), len(PNG), list[tuple[bytes, bytes]]()
    while at < len(data):
        (size,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    chosen = int(rng.integers(len(chunks)))
    kind, body = chunks[chosen]
    if kind == b"IDAT" and rng.integers(2):
        raw = zlib.decompress(body)
        body = zlib.compress(damaged(rng, raw)) if rng.integers(400) else bomb(raw, zlib.MAX_WBITS)
    elif body:
        body = damaged(rng, body)
    chunks[chosen] = kind, body
    framed = (
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )
    path.write_bytes(PNG + b"".join(framed))


def bomb(raw: bytes, form: int) -> bytes:
    """A DEFLATE stream of some bytes and 2 GiB of zeros, in two megabytes."""
    packer = zlib.compressobj(1, zlib.DEFLATED, form)
    start = packer.compress(raw) + packer.flush(zlib.Z_FULL_FLUSH)
    # Behind a full flush nothing refers to what was before, so a run may be repeated.
    zeros = packer.compress(bytes(ZEROS)) + packer.flush(zlib.Z_FULL_FLUSH)
    return start + zeros * BOMB + packer.flush()


PACKED = {b"PK": in_zip, b"\x1f\x8b": in_gzip, b"NGSP": in_streams, PNG: in_png}
"""Spoilers of what a file holds, by its first bytes."""


def tensors_of(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """All of a safetensors file."""
    with safe_open(path, framework="pt") as file:
        return {n: file.get_tensor(n).clone() for n in file.keys()}, file.metadata() or {}  # noqa: SIM118


def replace(rng: Rng, path: Path, secret: Path) -> str:
    """Something else under a file's name."""
    kinds = ("a link", "a pipe", "a device", "a folder", "nothing", "empty", "a sparse file")
    kind = kinds[int(rng.integers(len(kinds)))]
    path.unlink(missing_ok=True)
    if kind == "a link":
        path.symlink_to(secret)
    elif kind == "a pipe":
        os.mkfifo(path)
    elif kind == "a device":
        path.symlink_to("/dev/zero")
    elif kind == "a folder":
        path.mkdir()
    elif kind != "nothing":
        path.touch()
    if kind == "a sparse file":
        os.truncate(path, LARGE)
    return kind


def restore(source: Path, folder: Path) -> None:
    """A folder as it was."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source, folder, symlinks=True)
