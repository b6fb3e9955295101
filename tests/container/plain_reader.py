"""A second, slow reader from docs/format.md alone: plain loops, no NumPy, nothing shared."""

import json
import struct
import zlib
from typing import Any

HEADER = struct.Struct("<8sIIHHHHHHHHIIdddddd")
LEVEL = struct.Struct("<QIIIHHHHHHBBBBfff")
CHUNK = struct.Struct("<BBBBIQQQII")
BLOCK = struct.Struct("<IIIIIIiiiiiifI")
PAGE = struct.Struct("<IIIIIIIiiiiiifQQ")
MANIFEST, DIRECTORY, NETWORKS, CODEBOOK, GRID, BLOCKS = range(1, 7)
FLOAT, HALF, AFFINE8, AFFINE16, CURVE8 = range(5)
WIDTH = {FLOAT: 4, HALF: 2, AFFINE8: 1, AFFINE16: 2, CURVE8: 1}


class Refused(Exception):
    """The bytes are not what docs/format.md promises."""


def need(good: bool, what: str) -> None:
    if not good:
        raise Refused(what)


def to_float32(value: float) -> float:
    return struct.unpack("<f", struct.pack("<f", value))[0]


def inflate(stored: bytes, raw: int, crc: int) -> bytes:
    need(zlib.crc32(stored) == crc, "checksum")
    if len(stored) == raw:
        return stored
    stream = zlib.decompressobj(-15)
    data = stream.decompress(stored, raw + 1)
    need(len(data) == raw and stream.eof and not stream.unused_data, "DEFLATE stream")
    return data


def from_planes(data: bytes, rows: int, columns: int, width: int) -> list[list[int]]:
    """Unsigned numbers [rows][columns] from byte planes."""
    table = [[0] * columns for _ in range(rows)]
    for column in range(columns):
        for byte in range(width):
            plane = (column * width + byte) * rows
            for row in range(rows):
                table[row][column] |= data[plane + row] << (8 * byte)
    return table


class Cursor:
    """Takes bytes from the front."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, count: int) -> bytes:
        need(self.at + count <= len(self.data), "length")
        self.at += count
        return self.data[self.at - count : self.at]

    def done(self) -> None:
        need(self.at == len(self.data), "length")


def read_values(cursor: Cursor, coding: int, rows: int, columns: int) -> list[list[float]]:
    if not rows * columns:
        return [[] for _ in range(rows)]
    stepped = coding in (AFFINE8, AFFINE16, CURVE8)
    pairs = [struct.unpack("<ff", cursor.take(8)) for _ in range(columns)] if stepped else []
    width = WIDTH[coding]
    numbers = from_planes(cursor.take(rows * columns * width), rows, columns, width)
    values: list[list[float]] = []
    for row in numbers:
        if coding == FLOAT:
            values.append([struct.unpack("<f", struct.pack("<I", n))[0] for n in row])
        elif coding == HALF:
            values.append([struct.unpack("<e", struct.pack("<H", n))[0] for n in row])
        else:
            line: list[float] = []
            for number, (low, step) in zip(row, pairs, strict=True):
                steps = float(number)
                if coding == CURVE8:
                    c = number - 128
                    steps = c + c * abs(c) / 64
                line.append(to_float32(low + step * steps))
            values.append(line)
    for row in values:
        need(all(abs(v) <= 3.4028234663852886e38 for v in row), "finite values")
    return values


def read_lattice(cursor: Cursor, fresh: int, width: int) -> list[list[int]]:
    if not fresh:
        return []
    if not width:
        table = from_planes(cursor.take(12 * fresh), fresh, 3, 4)
        return [[n - (1 << 32) * (n >> 31) for n in row] for row in table]
    origin = struct.unpack("<iii", cursor.take(12))
    code = struct.unpack("<Q", cursor.take(8))[0]
    points: list[list[int]] = []
    for (step,) in from_planes(cursor.take(fresh * width), fresh, 1, width):
        code += step
        need(code < 1 << 63, "Morton code")
        axes = [0, 0, 0]
        for bit in range(63):
            axes[bit % 3] |= (code >> bit & 1) << (bit // 3)
        points.append([o + a for o, a in zip(origin, axes, strict=True)])
    return points


def network_shapes(head: dict[str, int], level: dict[str, Any]) -> dict[str, tuple[int, int]]:
    width = level["grids"] * head["features"] + level["columns"] + head["residual"]
    shapes: dict[str, tuple[int, int]] = {}
    if level["fuse_hidden"]:
        hidden, out = level["fuse_hidden"], level["fuse_out"]
        shapes |= {"fuse_w1": (hidden, width), "fuse_b1": (hidden, 1)}
        shapes |= {"fuse_w2": (out, hidden), "fuse_b2": (out, 1)}
        width = out
    for name, outputs in (("opacity", 1), ("cov", 7), ("color", 3)):
        hidden, out = level["head_hidden"], outputs * head["slots"]
        shapes |= {f"{name}_w1": (hidden, width + 4), f"{name}_b1": (hidden, 1)}
        shapes |= {f"{name}_w2": (out, hidden), f"{name}_b2": (out, 1)}
    return shapes


def read_index(data: bytes) -> tuple[dict[str, Any], list[dict[str, Any]], list[tuple[int, ...]]]:
    need(data[:8] == b"GSYN\r\n\x1a\n" and len(data) >= HEADER.size, "magic")
    f = HEADER.unpack_from(data)
    need(f[1] == 1 and f[2] < 16, "version")
    names = ("levels", "chunks", "slots", "features", "residual", "contract", "front")
    head: dict[str, Any] = dict(zip(names, f[3:10], strict=True))
    head["splats"], head["paged"], head["stand_ins"] = bool(f[2] & 2), bool(f[2] & 4), f[10]
    need(bool(f[2] & 8) == (f[10] > 0), "required")
    need(f[10] < (head["levels"] if head["splats"] else 1), "stand-ins")
    head |= {"voxel": f[13], "center": list(f[14:17]), "radius": f[17], "extent": f[18]}
    size = HEADER.size + head["levels"] * LEVEL.size + head["chunks"] * CHUNK.size
    need(size <= 16384 and size <= len(data), "index")
    blank = data[:32] + bytes(4) + data[36:size]
    need(zlib.crc32(blank) == f[11], "index checksum")
    at, levels, chunks = HEADER.size, [], []
    names = ("end", "anchors", "live", "blocks", "grids", "head_hidden", "fuse_hidden", "fuse_out")
    names += ("rows", "columns", "log_scales", "residual", "offsets", "inherits")
    for _ in range(head["levels"]):
        record = LEVEL.unpack_from(data, at)
        levels.append(dict(zip(names, record, strict=False)) | {"gain": list(record[14:])})
        at += LEVEL.size
    for _ in range(head["chunks"]):
        chunks.append(CHUNK.unpack_from(data, at))
        need(chunks[-1][5] == (chunks[-2][5] + chunks[-2][6] if len(chunks) > 1 else size), "gap")
        at += CHUNK.size
    need(chunks[-1][5] + chunks[-1][6] == levels[-1]["end"], "end")
    need(any(level["inherits"] for level in levels) == f[2] & 1, "required")
    return head, levels, chunks


def read_plain(data: bytes) -> dict[str, Any]:
    """Everything in a file or prefix, as lists: shared arrays, levels and notes."""
    head, levels, chunks = read_index(data)
    held = [level["end"] for level in levels].index(len(data)) + 1
    scene: dict[str, Any] = {"head": head, "lattice": {}, "log_scales": {}, "codes": {}}
    scene |= {"residual": {}, "offsets": {}, "grids": [], "resolutions": []}
    directories: dict[int, list[tuple[tuple[Any, ...], list[int]]]] = {}
    masks: list[dict[int, list[bool]]] = []
    for kind, k, coding, _, rows, offset, stored, raw, crc, resolution in chunks:
        if k >= held and offset >= len(data):
            break
        body = data[offset : offset + stored]
        if kind == BLOCKS:
            starts = [levels[j - 1]["anchors"] if j else 0 for j in range(k + 1)]
            masks.append({})
            directories[k], body = take_pages(head, directories, k, body)
            for record, counts in directories[k]:
                block, body = body[: record[0]], body[record[0] :]
                read_block(scene, levels, k, (record, counts, starts), block, masks)
                starts = [s + n for s, n in zip(starts, counts, strict=True)]
            need(sum(map(sum, masks[k].values())) == levels[k]["live"], "live")
            levels[k]["mask"] = [masks[k][row] for row in sorted(masks[k])]
            inherit_codebook(head, levels, k)
            continue
        cursor = Cursor(inflate(body, raw, crc))
        if kind == MANIFEST:
            scene |= json.loads(cursor.take(rows))
        elif kind == DIRECTORY:
            directories[k] = read_directory(cursor, rows, k, PAGE if head["paged"] else BLOCK)
        elif kind == NETWORKS:
            above = levels[k - 1]["networks"] if levels[k]["inherits"] else {}
            levels[k]["networks"] = read_networks(cursor, coding, (head, levels[k]), above)
        elif kind == CODEBOOK:
            levels[k]["codebook"] = read_values(cursor, coding, rows, levels[k]["columns"])
        else:
            scene["grids"].append(read_values(cursor, coding, rows, head["features"]))
            scene["resolutions"].append(resolution)
        cursor.done()
    for name in ("lattice", "log_scales", "codes", "residual"):
        scene[name] = [scene[name][row] for row in sorted(scene[name])]
    return scene | {"levels": levels[:held]}


def inherit_codebook(head: dict[str, Any], levels: list[dict[str, Any]], k: int) -> None:
    """Of splats, which have no networks."""
    if head["splats"]:
        levels[k]["networks"] = {}
        if levels[k]["inherits"]:
            levels[k]["codebook"] = levels[k - 1]["codebook"]


def read_networks(cursor: Cursor, coding: int, place: tuple[Any, Any], above: Any) -> Any:
    found = dict(above)  # of these, matrices are inherited
    for name, (a, b) in network_shapes(*place).items():
        if name not in above or "b" in name[-2:]:
            found[name] = [v for row in read_values(cursor, coding, a * b, 1) for v in row]
    return found


def read_directory(
    cursor: Cursor, rows: int, level: int, kind: struct.Struct = BLOCK
) -> list[tuple[Any, list[int]]]:
    size = kind.size + 4 * (level + 1)
    planes = cursor.take(rows * size)
    records: list[tuple[Any, list[int]]] = []
    for row in range(rows):
        record = bytes(planes[byte * rows + row] for byte in range(size))
        counts = list(struct.unpack_from(f"<{level + 1}I", record, kind.size))
        records.append((kind.unpack_from(record), counts))
    return records


def take_pages(
    head: dict[str, Any], directories: Any, k: int, body: bytes
) -> tuple[list[tuple[Any, list[int]]], bytes]:
    """The records of all pages of a level, and the bytes of the blocks among which they stand."""
    if not head["paged"]:
        return directories[k], body
    found: list[tuple[Any, list[int]]] = []
    blocks = b""
    parent = 0
    for page, rows in directories[k]:
        stored, count, length = page[0], page[3], page[14]
        raw = inflate(body[:stored], count * (BLOCK.size + 4 * (k + 1)), page[1])
        own = read_directory(Cursor(raw), count, k)
        blocks, body = blocks + body[stored : stored + length], body[stored + length :]
        for at, total in ((0, length), (1, page[15]), (4, page[5]), (5, page[6])):
            need(sum(record[at] for record, _ in own) == total, "sums of a page")
        need([sum(column) for column in zip(*(c for _, c in own), strict=True)] == rows, "rows")
        for record, counts in own:
            inside = all(lo <= a <= b <= hi for lo, a, b, hi in zip(
                page[7:10], record[6:9], record[9:12], page[10:13], strict=True))  # fmt: skip
            need(not sum(counts) or (inside and record[12] <= page[13]), "box of a page")
        links = sorted({record[3] for record, _ in own})
        need(not k or links == list(range(parent, parent + page[4])), "parents of a page")
        parent += page[4]
        found += own
    need(not body, "bytes behind the last block")
    return found, blocks


def read_block(
    scene: dict[str, Any],
    levels: list[dict[str, Any]],
    k: int,
    place: tuple[tuple[Any, ...], list[int], list[int]],
    body: bytes,
    masks: list[dict[int, list[bool]]],
) -> None:
    record, counts, starts = place
    slots, level = scene["head"]["slots"], levels[k]
    cursor = Cursor(inflate(body, record[1], record[2]) if record[1] else b"")
    anchors = [s + i for s, n in zip(starts, counts, strict=True) for i in range(n)]
    new = anchors[len(anchors) - counts[-1] :]
    points = read_lattice(cursor, len(new), record[13])
    splats, harmonics = scene["head"]["splats"], scene["head"]["features"] or 1
    scales = read_values(cursor, level["log_scales"], len(new), 3 if splats else 6)
    each = level["columns"] // harmonics if splats else int(level["rows"] > 0)
    table = from_planes(cursor.take(len(new) * each), len(new), each, 1)
    need(all(code < level["rows"] for row in table for code in row), "code")
    codes = table if splats else [row[0] for row in table if row]
    residual = read_values(cursor, level["residual"], len(new), scene["head"]["residual"])
    before = {a: masks[k - 1].get(a, [False] * slots) if k else [False] * slots for a in anchors}
    off = [(a, s) for a in anchors for s in range(slots) if not before[a][s]]
    bits = b"\xff" * len(off) if splats else cursor.take((len(off) + 7) // 8)
    fresh = [place for i, place in enumerate(off) if bits[i // 8] >> (i % 8) & 1]
    need(len(fresh) == record[4] - record[5], "mask")
    masks[k].update({a: list(before[a]) for a in anchors})
    for a, s in fresh:
        masks[k][a][s] = True
    offsets = read_values(cursor, level["offsets"], 0 if splats else len(fresh), 3)
    cursor.done()
    scene["offsets"].update(zip(fresh, offsets, strict=not splats))
    for i, a in enumerate(new):
        need(all(lo <= p <= hi for lo, p, hi in zip(record[6:9], points[i], record[9:12],
                                                    strict=True)), "box")  # fmt: skip
        scene["lattice"][a], scene["log_scales"][a] = points[i], scales[i]
        scene["residual"][a] = residual[i]
        if codes:
            scene["codes"][a] = codes[i]
