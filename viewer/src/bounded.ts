/** What is held of a scene of splats that is larger than its budget: what the pictures ahead need most. */

import { NOWHERE } from "./assembler";
import type { Assembler } from "./assembler";
import type { BlockRecord } from "./directory";
import type { Worth } from "./foresight";
import { Room } from "./room";

/** A block takes the place of others that are worth less than this share of it. */
const SHARE = 0.5;

/** A block that has rows from now on, and those that had them. */
export interface Placed {
  readonly number: number;
  readonly lost: readonly number[];
}

export class Bounded {
  private readonly room: Room;
  /** Numbers in the whole file of the first splats of blocks, as the directories had them. */
  private readonly starts: number[][][];
  /** Blocks that have rows. */
  private readonly placed = new Set<number>();

  constructor(private readonly assembler: Assembler) {
    const { index, directories, room } = assembler;
    const base = index.levels[0].live;
    this.room = new Room(base, room - base);
    this.starts = directories.map((records) => records.map((record) => record.starts.slice()));
  }

  /**
   * Rows for the block of so many levels that the pictures need most, if there are some or others need theirs
   * less; null if all is as it should be. Its parent has rows, and those that lose theirs are held and have no children.
   */
  next({ items, worth }: Worth, levels: number, isHeld: (number: number) => boolean): Placed | null {
    const { placed } = this;
    const parents = new Set<number>();
    for (const number of placed) parents.add(items[number].needs[0]);
    const lacking = items.flatMap(({ level, block, needs }, number) =>
      level && level < levels && block >= 0 && !placed.has(number) && (level === 1 || placed.has(needs[0])) ? [number] : []);
    lacking.sort((a, b) => worth[b] / Math.max(1, items[b].slots) - worth[a] / Math.max(1, items[a].slots) || a - b);
    const costs = new Map<number, number>();
    for (const number of placed) costs.set(number, parents.has(number) || !isHeld(number) ? Infinity : worth[number]);
    for (const number of lacking) {
      const { level, block, slots, needs } = items[number];
      const window = this.room.find(slots, (owner) => (owner === needs[0] ? Infinity : costs.get(owner)!));
      if (!window || window.cost > SHARE * worth[number]) continue;
      const { row, lost } = this.room.take(window, slots, number);
      for (const other of lost) placed.delete(other);
      placed.add(number);
      this.put(level, block, row);
      return { number, lost };
    }
    return null;
  }

  /** Let the splats of a block be those from a row on, for itself and what lies on it. */
  private put(level: number, block: number, row: number): void {
    const { directories } = this.assembler;
    const shift = row - this.starts[level][block][level];
    let above = new Set([block]);
    for (let k = level; k < directories.length; k++) {
      const records = directories[k];
      const here = k === level ? above : new Set(records.flatMap(({ parent }, number) => (above.has(parent) ? [number] : [])));
      for (const number of here) (records[number].starts as number[])[level] = this.starts[k][number][level] + shift;
      above = here;
    }
  }
}

/** Forget the splats of a block on which nothing lies: its parent's are what they were without it. */
export function drop({ held, tables }: Assembler, level: number, number: number, record: BlockRecord): void {
  held[level].delete(number);
  record.starts.forEach((start, k) => {
    tables.region.fill(k < level ? level - 1 : NOWHERE, start, start + record.rows[k]);
  });
  const [start, end] = [record.starts[level], record.starts[level] + record.rows[level]];
  tables.head.fill(-1, start, end);
  tables.owner.fill(-1, start, end);
}
