/** Eviction for a scene that is larger than its budget: its rows go to the blocks that the views ahead need most. */

import { Assembler, NOWHERE } from "../format/assembler";
import { hasSplats } from "../format/file-index";
import type { Index } from "../format/file-index";
import type { Item } from "../policy/catalog";
import type { BlockUtilities } from "../policy/prediction";
import { RowAllocator } from "./row-allocator";

/** Number of blocks of the highest utility that are tried for a place. */
const TRIED = 512;
/** Rows for anchors, relative to what slots have on average. */
const SPARE = 1.25;
/** A block takes the place of others that are worth less than this share of it. */
const SHARE = 0.5;

/** A block that has rows from now on, and those that had them. */
export interface Placement {
  readonly number: number;
  readonly lost: readonly number[];
}

export class Residency {
  private readonly slots: RowAllocator;
  /** Null for splats, which are their own slots. */
  private readonly anchors: RowAllocator | null;
  /** Numbers in the whole file of the first anchors of blocks, as the directories had them. */
  private readonly starts: number[][][];
  /** Blocks that have rows. */
  private readonly placed = new Set<number>();

  constructor(private readonly assembler: Assembler) {
    const { index, directories, room } = assembler;
    const { live, anchors } = index.levels[0];
    const splats = hasSplats(index.header);
    const anchorRows = splats ? room : anchorRowsFor(index, room);
    assembler.reserve({ anchors: anchorRows, live: room });
    this.slots = new RowAllocator(live, room - live);
    this.anchors = splats ? null : new RowAllocator(anchors, anchorRows - anchors);
    this.starts = directories.map((records) => records.map((record) => record.starts.slice()));
  }

  /**
   * Rows for the block of so many levels that the pictures need most, if there are some or others need theirs
   * less; null if all is as it should be. Its parent has rows, and those that lose theirs are held and have no children.
   */
  next({ items, worth }: BlockUtilities, levels: number, isHeld: (number: number) => boolean): Placement | null {
    const { placed } = this;
    const parents = new Set<number>();
    for (const number of placed) parents.add(items[number].needs[0]);
    const lacking = items.flatMap(({ level, block, needs }, number) =>
      level && level < levels && block >= 0 && !placed.has(number) && (level === 1 || placed.has(needs[0])) ? [number] : []);
    lacking.sort((a, b) => worth[b] / Math.max(1, items[b].slots) - worth[a] / Math.max(1, items[a].slots) || a - b);
    const costs = new Map<number, number>();
    for (const number of placed) costs.set(number, parents.has(number) || !isHeld(number) ? Infinity : worth[number]);
    for (const number of lacking.slice(0, TRIED)) {
      const lost = this.place(items[number], number, SHARE * worth[number], costs);
      if (!lost) continue;
      for (const other of lost) placed.delete(other);
      placed.add(number);
      return { number, lost };
    }
    return null;
  }

  /** Assign rows to a block in place of others that together are worth at most `most`: those others; null where none can be had. */
  private place({ level, block, slots, needs }: Item, number: number, most: number, costs: ReadonlyMap<number, number>): number[] | null {
    const record = this.assembler.directories[level][block];
    const costOf = (owner: number) => (owner === needs[0] ? Infinity : costs.get(owner)!);
    const window = this.slots.find(slots, costOf);
    if (!window || window.cost > most) return null;
    if (!this.anchors) {
      const { row, lost } = this.slots.take(window, slots, number);
      this.put(level, block, row);
      return lost;
    }
    // What goes for its slots costs nothing more for its anchors.
    const gone = new Set(this.slots.ownersIn(window));
    const own = record.rows[level];
    const beside = this.anchors.find(own, (owner) => (gone.has(owner) ? 0 : costOf(owner)));
    if (!beside || window.cost + beside.cost > most) return null;
    const [taken, rows] = [this.slots.take(window, slots, number), this.anchors.take(beside, own, number)];
    for (const other of taken.lost) this.anchors.free(other);
    for (const other of rows.lost) this.slots.free(other);
    this.put(level, block, rows.row);
    record.firstSlot = taken.row;
    return [...new Set([...taken.lost, ...rows.lost])];
  }

  /** Let the anchors of a block be those from a row on, for itself and what lies on it. */
  private put(level: number, block: number, row: number): void {
    const { directories } = this.assembler;
    const shift = row - this.starts[level][block][level];
    let above = new Set([block]);
    for (let k = level; k < directories.length; k++) {
      const records = directories[k];
      const here = k === level ? above : new Set(records.flatMap(({ parent }, number) => (above.has(parent) ? [number] : [])));
      for (const number of here) records[number].starts[level] = this.starts[k][number][level] + shift;
      above = here;
    }
  }
}

/** Rows for so many anchors that slots run short first. */
function anchorRowsFor({ levels }: Index, room: number): number {
  const share = Math.max(...levels.map(({ anchors, live }) => anchors / Math.max(1, live)));
  return Math.max(levels[0].anchors, Math.min(room, Math.ceil(SPARE * share * room)));
}

/** Take a block without children out of the tables: its parent's anchors are what they were before it came. */
export function dropBlock(assembler: Assembler, level: number, number: number): void {
  const { directories, held, tables } = assembler;
  const record = directories[level][number];
  held[level].delete(number);
  const [first, count] = assembler.slotsOf(level, record);
  for (const [start, rows] of Assembler.rangesOf(record)) {
    // The slots that came last are the first of an anchor's.
    for (let anchor = start; anchor < start + rows; anchor++) {
      while (tables.head[anchor] >= first && tables.head[anchor] < first + count) tables.head[anchor] = tables.next[tables.head[anchor]];
    }
  }
  record.starts.forEach((start, k) => {
    tables.region.fill(k < level ? level - 1 : NOWHERE, start, start + record.rows[k]);
  });
  tables.owner.fill(-1, first, first + count);
}
