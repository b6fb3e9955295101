/** One level as it is shown: what of it has to be decoded next, and what was. */

import { Assembler, NOWHERE } from "../format/assembler";
import type { Decoder } from "./anchor-decoder";
import type { BlockRecord } from "../format/directory";
import type { Attributes } from "./messages";
import type { ViewPose } from "../base/view-pose";
import { WORDS } from "./pack-attributes";

/** Milliseconds of decoding between looks at the messages. */
const SLICE = 12;
/** An eye that moved less than this share of the scene's extent sees the same. */
const MOVED = 0.004;

/** Changes by one pass of decoding. */
export interface Changes {
  readonly pieces: readonly Attributes[];
  readonly limit: number;
  readonly fade: boolean;
}

export class LevelView {
  /** All anchors, or those of blocks that came since; none where only an answer is awaited, null where nothing is. */
  private stale: "all" | BlockRecord[] | null = "all";
  /** Blocks of levels between, whose looks may be over before anybody sees them. */
  private passing: BlockRecord[] = [];
  private seenFrom: readonly [number, number, number] | null = null;
  /** The level shown last; -1 before anything was. */
  private finest = -1;

  constructor(
    readonly decoder: Decoder,
    private readonly assembler: Assembler,
    /** Finest level shown. */
    public cap: number,
  ) {}

  /** Show no finer than a level, and answer in any case. */
  setCap(cap: number): void {
    if (cap !== this.cap) this.refreshAll();
    this.cap = cap;
    this.stale ??= [];
  }

  get waits(): boolean {
    return this.stale !== null;
  }

  refreshAll(): void {
    this.stale = "all";
    this.passing = [];
  }

  /** Blocks wait for `showPassing`. */
  get holdsBack(): boolean {
    return this.passing.length > 0;
  }

  /** Decode blocks of levels between too: somebody is there to see them. */
  showPassing(): void {
    for (const record of this.passing.splice(0)) this.addStale(record);
  }

  /** Decode again for an eye from which something looks otherwise: anything, and with an answer in any case, if `exact`. */
  follow(eye: ViewPose, exact: boolean): void {
    const { seenFrom, assembler, decoder } = this;
    const before = seenFrom && decoder.known(seenFrom);
    const moved = before ? Math.hypot(...decoder.known(eye.position).map((value, i) => value - before[i])) : Infinity;
    if (moved > (exact ? 0 : MOVED * assembler.index.header.extent)) this.refreshAll();
    if (!exact) return;
    this.stale ??= [];
    this.showPassing();
  }

  /** Decode what looks otherwise with a block: at once if it is of the base or of the level shown. */
  addBlock(record: BlockRecord): void {
    const level = record.rows.length - 1;
    if (level && level < this.cap) this.passing.push(record);
    else this.addStale(record);
  }

  /** Draw no more what an evicted block brought, and keep no features of its anchors, whose rows others get. */
  dropBlock(level: number, record: BlockRecord): void {
    const { decoder, assembler } = this;
    decoder.clear(...assembler.slotsOf(level, record));
    decoder.dropFeatures(...Assembler.rangesOf(record)[level]);
    this.addStale(record);
  }

  private addStale(record: BlockRecord): void {
    const stale = (this.stale ??= []);
    if (stale !== "all") stale.push(record);
  }

  /** Rows that look otherwise with a block, but those that a finer one, which has come too, changes again. */
  private *rangesOf(record: BlockRecord): Generator<readonly [number, number]> {
    const { decoder, assembler: { tables: { region }, index: { levels } } } = this;
    let again = record.rows.length;
    while (again < levels.length && !decoder.changesAt(again)) again++;
    for (const [first, count] of decoder.rangesOf(record)) {
      const end = first + count;
      for (let row = first, from = first; row <= end; row++) {
        if (row < end && (region[row] < again || region[row] === NOWHERE)) continue;
        if (row > from) yield [from, row - from];
        from = row + 1;
      }
    }
  }

  /** Send all again: the page has lost what it had. */
  restart(): void {
    this.finest = -1;
    this.refreshAll();
  }

  /** Decode what is stale, with a `pause` now and then. */
  async decode(eye: ViewPose, pause: () => Promise<void>): Promise<Changes> {
    const { decoder, assembler, cap } = this;
    const stale = this.stale ?? [];
    const ranges = stale === "all" ? undefined : stale.flatMap((record) => [...this.rangesOf(record)]);
    this.stale = null;
    // Blocks are decoded for the eye of what is there already; a view that moved decodes all.
    const from = ranges && this.seenFrom ? this.seenFrom : eye.position;
    this.seenFrom = from;
    let slice = performance.now();
    const steps = decoder.refresh(cap, from, ranges);
    while (!steps.next().done) {
      if (performance.now() - slice < SLICE) continue;
      await pause();
      slice = performance.now();
    }
    const finest = Math.max(0, Math.min(cap, decoder.finestShared));
    const { room, index } = assembler;
    const limit = room < Infinity ? room : index.levels[finest].live;
    // Blocks of the base stand beside each other: in them nothing is there yet that could turn into something.
    const refined = stale !== "all" && stale.some(({ rows }) => rows.length > 1);
    const fade = this.finest >= 0 && (refined || finest !== this.finest);
    this.finest = finest;
    const pieces = decoder.takeRuns().map(({ first, words }): Attributes => {
      const drawn = new Uint8Array(words.length / WORDS);
      for (let i = 0; i < drawn.length; i++) drawn[i] = Number(words[i * WORDS + 7] > 0xffff);
      return { first, words, drawn };
    });
    return { pieces, limit, fade };
  }
}
