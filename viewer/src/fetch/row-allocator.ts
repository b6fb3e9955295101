/** Rows of the tables for the blocks of a scene that is larger than they are. */

/** Rows that belong to one block, or to none. */
interface Segment {
  readonly count: number;
  /** The block's number, -1 where there is none. */
  readonly owner: number;
}

/** Neighbours that together have enough rows. */
export interface Window {
  /** The first segment, and the first behind it. */
  readonly at: number;
  readonly end: number;
  /** Cost of the blocks that would lose their rows. */
  readonly cost: number;
}

const NONE = -1;

export class RowAllocator {
  private segments: Segment[];

  /** Rows `first` … `first` + `count`, all of them free. */
  constructor(
    private readonly first: number,
    count: number,
  ) {
    this.segments = [{ count, owner: NONE }];
  }

  /** The cheapest rows for `count`, side by side, the first of equals; null where all hold what must stay. */
  find(count: number, costOf: (owner: number) => number): Window | null {
    const { segments } = this;
    const costs = segments.map(({ owner }) => (owner === NONE ? 0 : costOf(owner)));
    let best: Window | null = null;
    for (let at = 0; at < segments.length; at++) {
      let [rows, cost, end] = [0, 0, at];
      while (rows < count && end < segments.length) {
        rows += segments[end].count;
        cost += costs[end++];
      }
      if (rows < count) break;
      if (cost < (best?.cost ?? Infinity)) best = { at, end, cost };
    }
    return best;
  }

  /** Give such rows to a block: its first row, and the blocks that had them. */
  take(window: Window, count: number, owner: number): { row: number; lost: number[] } {
    const { segments } = this;
    const { at, end } = window;
    const before = segments.slice(at, end);
    const rows = sum(before);
    const made: Segment[] = [{ count, owner }];
    if (rows > count) made.push({ count: rows - count, owner: NONE });
    const [row, lost] = [this.first + sum(segments.slice(0, at)), this.ownersIn(window)];
    this.segments = joined([...segments.slice(0, at), ...made, ...segments.slice(end)]);
    return { row, lost };
  }

  /** Blocks of such rows. */
  ownersIn({ at, end }: Window): number[] {
    return this.segments.slice(at, end).flatMap(({ owner }) => (owner === NONE ? [] : [owner]));
  }

  /** A block needs its rows no more. */
  free(owner: number): void {
    this.segments = joined(this.segments.map((segment) => (segment.owner === owner ? { ...segment, owner: NONE } : segment)));
  }
}

function sum(segments: readonly Segment[]): number {
  return segments.reduce((rows, { count }) => rows + count, 0);
}

/** Free rows side by side as one. */
function joined(segments: readonly Segment[]): Segment[] {
  const found: Segment[] = [];
  for (const segment of segments) {
    const last = found.at(-1);
    if (segment.owner === NONE && last?.owner === NONE) found[found.length - 1] = { owner: NONE, count: last.count + segment.count };
    else found.push(segment);
  }
  return found;
}
