"""Ways to spoil a folder: bytes, text, JSON, tensors, and the kind of file behind a name."""

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from benchmarks.robust.mutants import damaged

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


def spoil(
    rng: Rng, folder: Path, names: tuple[str, ...], secret: Path, *, sparse: bool = True
) -> str:
    """Spoil one of the files of a folder; what was done to which."""
    path = folder / names[int(rng.integers(len(names)))]
    kinds: list[Callable[[Rng, Path], None]] = [spoil_bytes, spoil_numbers, spoil_lines]
    if path.suffix in (".json", ".toml"):
        kinds += [spoil_json] * 6 if path.suffix == ".json" else [spoil_numbers] * 3
    if path.suffix == ".safetensors":
        kinds = [spoil_bytes, spoil_tensor, spoil_tensor, spoil_state, spoil_state]
    chosen = kinds[int(rng.integers(len(kinds)))]
    if rng.integers(20) == 0:
        return f"{replace(rng, path, secret, sparse=sparse)} as {path.name}"
    chosen(rng, path)
    return f"{chosen.__name__} on {path.name}"


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


def tensors_of(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """All of a safetensors file."""
    with safe_open(path, framework="pt") as file:
        return {n: file.get_tensor(n).clone() for n in file.keys()}, file.metadata() or {}  # noqa: SIM118


def replace(rng: Rng, path: Path, secret: Path, *, sparse: bool) -> str:
    """Something else under a file's name."""
    kinds = ("a link", "a pipe", "a device", "a folder", "nothing", "empty", "a sparse file")
    kind = kinds[int(rng.integers(len(kinds) - (not sparse)))]
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
