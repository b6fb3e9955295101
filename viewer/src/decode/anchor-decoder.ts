/** Tables to Gaussians: features once per level, heads again when the camera has moved. */

import { Assembler, NOWHERE } from "../format/assembler";
import type { BlockRecord } from "../format/directory";
import type { Vec } from "../base/vec3";
import type { Attributes } from "./messages";
import { must } from "../format/records";
import { gridCoordinates, latticePosition } from "../format/lattice";
import { ALPHA_MIN, BATCH, SLOT_VALUES } from "./kernel/kernel";
import type { Kernel } from "./kernel/kernel";
import { SLOTS_PER_MESSAGE, WORDS, packSlot } from "./pack-attributes";
import { hasSplats, ownerOf } from "../format/file-index";
import { packNetworks } from "./packed-networks";
import { clampToBounds, viewBoundsOf } from "../format/notes/view-bounds";
import type { ViewBounds } from "../format/notes/view-bounds";
import { SplatDecoder } from "./splat-decoder";
import type { PackedNetworks } from "./packed-networks";
import { Kind } from "../format/layout.gen";

/** Anchors whose features are kept as one piece. */
const PIECE = 1024;
/** Features of so many bytes are kept; those of other anchors are computed for each view. */
const FEATURE_BYTES_MAX = 256 << 20;
const NONE = 255;
/** The eye of what looks the same from everywhere. */
const NO_EYE: Vector = [0, 0, 0];

export type Vector = readonly [number, number, number];

/** Attributes of some slots; words are 0 where nothing is drawn. */
type WordRun = Pick<Attributes, "first" | "words">;

/** The Gaussians of an assembler's tables for one eye point. */
export class Decoder {
  /** Attributes of every slot of anchors. */
  private words = new Uint32Array(0);
  private floats = new Float32Array(0);
  /** Pages of anchors' slots changed since `takeRuns`. */
  private dirty = new Set<number>();
  /** Splats decoded since then: only the page keeps their attributes. */
  private runs: WordRun[] = [];
  /** Features of anchors, and the levels they are of. */
  private readonly pieces = new Map<number, { values: Float32Array; levels: Uint8Array }>();
  private readonly batch: BatchBuffers;
  private readonly stride: number;
  private eye: Vector = [0, 0, 0];
  private seen: ViewBounds | null = null;
  /** Decoder of splats; null for files with networks. */
  private readonly splats: SplatDecoder | null;
  private readonly values = new Float32Array(SLOT_VALUES);

  constructor(
    private readonly assembler: Assembler,
    private readonly kernel: Kernel,
    /** Networks in kernel order by level; decoders of one file share them, as a kernel never frees. */
    private readonly parts = new Map<number, PackedNetworks>(),
  ) {
    const { header, levels } = assembler.index;
    this.batch = new BatchBuffers(header.slots, header.residual, Math.max(...levels.map((l) => l.head_hidden)));
    this.stride = this.batch.stride;
    this.splats = hasSplats(header) ? new SplatDecoder(assembler) : null;
  }

  /** The finest level whose networks, codebook and grids, and all before it, are there. */
  get finestShared(): number {
    const count = this.assembler.index.levels.length;
    let level = 0;
    while (level < count && this.assembler.hasShared(level)) level++;
    return level - 1;
  }

  /** Keep no features of anchors first … first + count. */
  dropFeatures(first: number, count: number): void {
    for (let piece = (first / PIECE) | 0; piece * PIECE < first + count; piece++) this.pieces.delete(piece);
  }

  /** Bytes of arrays held beside the assembler's tables. */
  get bytes(): number {
    let total = this.words.byteLength;
    for (const piece of this.pieces.values()) total += piece.values.byteLength + PIECE;
    return total;
  }

  /**
   * Decode anchors held, all of them or those of some ranges [first, count], no finer than `cap`,
   * as seen from `eye`.
   *
   * Yields between batches, so that the caller can look after other things.
   */
  *refresh(cap: number, eye: Vector, ranges?: readonly (readonly [number, number])[]): Generator<void, void, void> {
    const { splats, batch, assembler } = this;
    this.seen = splats ? null : viewBoundsOf(assembler.manifest);
    this.eye = this.known(eye);
    const finest = Math.min(cap, this.finestShared);
    if (finest < 0) return;
    batch.clear(0);
    if (!splats) this.reserve(assembler.tables.brought.length);
    const n = assembler.rowsUpTo(finest).anchors;
    for (const [first, count] of ranges ?? [[0, n]]) {
      const end = Math.max(first, Math.min(n, first + count));
      const words = new Uint32Array(splats ? (end - first) * WORDS : 0);
      const floats = new Float32Array(words.buffer);
      if (words.length) this.runs.push({ first, words });
      for (let anchor = first; anchor < end; anchor++) {
        if (splats && anchor % BATCH === 0) yield;
        // Tables that have grown meanwhile are others.
        const { brought, region } = assembler.tables;
        if (region[anchor] === NOWHERE) continue;
        const level = Math.min(region[anchor], finest);
        if (splats) {
          if (brought[anchor] > finest || splats.isReplaced(anchor, level)) continue;
          splats.decode(anchor, level, this.eye, this.values);
          this.put(anchor, this.values, 0, floats, words, (anchor - first) * WORDS);
          continue;
        }
        if (batch.count === BATCH || (batch.count && level !== batch.level)) {
          this.decodeBatch();
          yield;
        }
        if (!batch.count) batch.clear(level);
        batch.anchors[batch.count++] = anchor;
      }
    }
    if (batch.count) this.decodeBatch();
  }

  /** Rows that look otherwise with a block than without, as ranges [first, count]. */
  rangesOf(record: BlockRecord): [number, number][] {
    const ranges = Assembler.rangesOf(record);
    return this.changesAt(ranges.length - 1) ? ranges : ranges.slice(-1);
  }

  /** Tell whether what coarser levels brought looks otherwise at this level than at the one before. */
  changesAt(level: number): boolean {
    return this.splats?.changesAt(level) ?? true;
  }

  /** Draw nothing in these slots; splats that are gone are left out when they are decoded again. */
  clear(first: number, count: number): void {
    if (this.splats) return;
    for (let row = first; row < first + count; row++) {
      this.dirty.add((row / SLOTS_PER_MESSAGE) | 0);
      this.words[row * WORDS + 7] = 0;
    }
  }

  /** The eye point that the heads are evaluated for; equal for eyes with equal results. */
  known(eye: Vector): Vector {
    if (this.splats && !this.splats.turns) return NO_EYE;
    return this.seen ? clampToBounds(this.seen, eye as Vec) : eye;
  }

  /** Runs of slots that changed since the last call, of anchors' slots in whole pages. */
  takeRuns(): WordRun[] {
    const { runs } = this;
    const pages = [...this.dirty].sort((a, b) => a - b);
    this.dirty = new Set();
    this.runs = [];
    for (let i = 0, from = 0; i < pages.length; i++) {
      if (pages[i + 1] === pages[i] + 1) continue;
      const first = pages[from] * SLOTS_PER_MESSAGE;
      runs.push({ first, words: this.words.slice(first * WORDS, (pages[i] + 1) * SLOTS_PER_MESSAGE * WORDS) });
      from = i + 1;
    }
    return runs;
  }

  /** Centres of slots first … first + count, [count, 3] world units. */
  centers(first: number, count: number): Float32Array {
    const { tables } = this.assembler;
    const { voxel } = this.assembler.index.header;
    const out = new Float32Array(3 * count);
    for (let i = 0; i < count; i++) {
      const anchor = this.splats ? first + i : tables.owner[first + i];
      if (anchor < 0) continue;
      for (let a = 0; a < 3; a++) {
        const base = this.splats ? 0 : Math.fround(Math.exp(tables.logScales[6 * anchor + a]));
        const shift = this.splats ? 0 : Math.fround(tables.offsets[3 * (first + i) + a] * base);
        out[3 * i + a] = latticePosition(tables.lattice[3 * anchor + a], voxel) + shift;
      }
    }
    return out;
  }

  private reserve(rows: number): void {
    const size = Math.ceil(rows / SLOTS_PER_MESSAGE) * SLOTS_PER_MESSAGE * WORDS;
    if (this.words.length >= size) return;
    const words = new Uint32Array(size);
    words.set(this.words);
    this.words = words;
    this.floats = new Float32Array(words.buffer);
  }

  /** A level's networks in kernel order; made once. */
  part(level: number): PackedNetworks {
    let part = this.parts.get(level);
    if (!part) {
      const { index, networks, codebooks, grids } = this.assembler;
      const entry = index.levels[level];
      const chunks = index.chunks.filter((c) => c.kind === Kind.grid && c.part < entry.grids);
      const tables = chunks.map((chunk) => ({
        table: must(grids.get(chunk.part), "grid"),
        rows: chunk.rows,
        resolution: chunk.resolution,
      }));
      const codebook = codebooks.get(level) ?? new Float32Array(0);
      const [inherited, own] = [ownerOf(index, level), level].map((k) => must(networks.get(k), "networks"));
      const weights = new Map([...inherited, ...own]);
      part = packNetworks(level, index.header, entry, weights, codebook, tables);
      this.parts.set(level, part);
    }
    return part;
  }

  private decodeBatch(): void {
    const { batch } = this;
    const part = this.part(batch.level);
    this.loadFeatures(part);
    this.loadView();
    this.loadSlots(batch.level);
    const { count, hidden, view, slots, result } = batch;
    this.kernel.heads(part, count, hidden, view, slots, result);
    const { logScales } = this.assembler.tables;
    const base = batch.base;
    for (let i = 0; i < count; i++) {
      for (let a = 0; a < 3; a++) {
        base[3 * i + a] = Math.exp(logScales[6 * batch.anchors[i] + 3 + a]) * part.gain[a];
      }
    }
    for (let i = 0, at = 0; i < slots.count; i++, at += SLOT_VALUES) {
      const owner = 3 * slots.owners[i];
      for (let a = 0; a < 3; a++) result[at + 1 + a] *= base[owner + a];
      const row = batch.rows[i];
      this.clear(row, 1);
      this.put(row, result, at, this.floats, this.words, row * WORDS);
    }
    batch.count = 0;
  }

  /** Attributes of a slot, from its opacity, scales, quaternion and colour, to a place where there are none. */
  protected put(_row: number, values: Float32Array, at: number, floats: Float32Array, words: Uint32Array, to: number): void {
    if (values[at] >= ALPHA_MIN) packSlot(values[at], values, at + 1, floats, words, to);
  }

  /** Features of the batch's anchors into `hidden`, from what is kept or computed and then kept. */
  private loadFeatures(part: PackedNetworks): void {
    const { batch, stride } = this;
    const width = part.first.outs;
    let known = true;
    for (let i = 0; known && i < batch.count; i++) {
      const anchor = batch.anchors[i];
      const piece = this.pieces.get((anchor / PIECE) | 0);
      known = piece?.levels[anchor % PIECE] === part.level;
    }
    if (!known) {
      this.loadInputs();
      this.kernel.features(part, batch, batch.hidden);
    }
    for (let i = 0; i < batch.count; i++) {
      const anchor = batch.anchors[i];
      const number = (anchor / PIECE) | 0;
      const from = (anchor % PIECE) * stride;
      let piece = this.pieces.get(number);
      if (known && piece) {
        batch.hidden.set(piece.values.subarray(from, from + width), i * width);
        continue;
      }
      if (!piece && (this.pieces.size + 1) * PIECE * stride * 4 <= FEATURE_BYTES_MAX) {
        const values = new Float32Array(PIECE * stride);
        piece = { values, levels: new Uint8Array(PIECE).fill(NONE) };
        this.pieces.set(number, piece);
      }
      piece?.values.set(batch.hidden.subarray(i * width, (i + 1) * width), from);
      if (piece) piece.levels[anchor % PIECE] = part.level;
    }
  }

  private loadInputs(): void {
    const { batch } = this;
    const { tables, index } = this.assembler;
    const { header } = index;
    const { voxel, residual } = header;
    for (let i = 0; i < batch.count; i++) {
      const anchor = batch.anchors[i];
      const x = latticePosition(tables.lattice[3 * anchor], voxel);
      const y = latticePosition(tables.lattice[3 * anchor + 1], voxel);
      const z = latticePosition(tables.lattice[3 * anchor + 2], voxel);
      gridCoordinates(header, x, y, z, batch.u, 3 * i);
      batch.codes[i] = tables.codes[anchor];
      for (let r = 0; r < residual; r++) batch.residual[i * residual + r] = tables.residual[anchor * residual + r];
    }
  }

  /** Unit direction from the eye and distance in units of `extent`, as far as training knew it. */
  private loadView(): void {
    const { batch, eye } = this;
    const { low, high } = this.seen ?? { low: 0, high: Infinity };
    const { lattice } = this.assembler.tables;
    const { voxel, extent } = this.assembler.index.header;
    for (let i = 0; i < batch.count; i++) {
      const anchor = 3 * batch.anchors[i];
      const x = latticePosition(lattice[anchor], voxel) - eye[0];
      const y = latticePosition(lattice[anchor + 1], voxel) - eye[1];
      const z = latticePosition(lattice[anchor + 2], voxel) - eye[2];
      const distance = Math.max(Math.sqrt(x * x + y * y + z * z), 1e-8);
      batch.view[4 * i] = x / distance;
      batch.view[4 * i + 1] = y / distance;
      batch.view[4 * i + 2] = z / distance;
      batch.view[4 * i + 3] = Math.min(Math.max(distance / extent, low), high);
    }
  }

  private loadSlots(level: number): void {
    const { batch } = this;
    const { head, next, slot, brought } = this.assembler.tables;
    let count = 0;
    for (let i = 0; i < batch.count; i++) {
      for (let row = head[batch.anchors[i]]; row >= 0; row = next[row]) {
        // But for scenes larger than their budget, slots of finer levels stand behind those of this one.
        if (brought[row] > level) {
          if (this.assembler.room < Infinity) this.clear(row, 1);
          continue;
        }
        batch.slots.owners[count] = i;
        batch.slots.slots[count] = slot[row];
        batch.rows[count++] = row;
      }
    }
    batch.slots.count = count;
  }
}

/** Inputs and results of one batch of anchors. */
class BatchBuffers {
  count = 0;
  level = 0;
  /** Most values of `features` for an anchor. */
  readonly stride: number;
  readonly anchors = new Uint32Array(BATCH);
  readonly u = new Float32Array(3 * BATCH);
  readonly codes = new Uint8Array(BATCH);
  readonly residual: Float32Array;
  readonly view = new Float32Array(4 * BATCH);
  readonly base = new Float32Array(3 * BATCH);
  readonly hidden: Float32Array;
  readonly slots: { count: number; owners: Uint32Array; slots: Uint8Array };
  readonly rows: Uint32Array;
  readonly result: Float32Array;

  constructor(slots: number, residual: number, hidden: number) {
    this.stride = 3 * ((hidden + 3) & ~3);
    this.residual = new Float32Array(residual * BATCH);
    this.hidden = new Float32Array(this.stride * BATCH);
    const most = slots * BATCH;
    this.slots = { count: 0, owners: new Uint32Array(most), slots: new Uint8Array(most) };
    this.rows = new Uint32Array(most);
    this.result = new Float32Array(SLOT_VALUES * most);
  }

  clear(level: number): void {
    this.count = 0;
    this.level = level;
  }
}
