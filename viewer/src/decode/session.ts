/** One scene in a worker: its loader, its tables, and the one or two levels of it that are shown. */

import type { Assembler } from "../format/assembler";
import type { BlockRecord } from "../format/directory";
import { Decoder } from "./anchor-decoder";
import { ViewerError, asViewerError } from "../base/errors";
import { trainingFocalsOf } from "../format/notes/training-focals";
import type { Kernel } from "./kernel/kernel";
import { Loader } from "../fetch/base-loader";
import { LevelView } from "./level-view";
import type { ViewPose } from "../base/view-pose";
import type { FromDecoder, SceneFacts, Side, ToDecoder } from "./messages";
import type { PackedNetworks } from "./packed-networks";
import { bestKernel, jsKernelModule } from "./kernel/wasm";
import { BlobSource, HttpSource } from "../fetch/source";

/** The part of a worker's global scope through which it talks to the page. */
export interface WorkerScope {
  onmessage: ((event: MessageEvent) => void) | null;
  postMessage(message: unknown, transfer?: Transferable[]): void;
}

const MORE = "This device has not enough memory for more detail.";

export class DecodeSession {
  private readonly started = performance.now();
  private readonly loader: Loader;
  private readonly kernel: Promise<Kernel>;
  private made: Kernel | null = null;
  private assembler: Assembler | null = null;
  private readonly parts = new Map<number, PackedNetworks>();
  /** Side 0 is there once header and kernel are. */
  private readonly looks: [LevelView | null, LevelView | null] = [null, null];
  private readonly caps: [number, number | null] = [0, null];
  private eye: ViewPose | null = null;
  private most = 0;
  private serial = 0;
  /** Something of level 0 can be shown, if not all. */
  private base = false;
  private ready: { level: number; bytes: number }[] = [];
  /** The last level that the page was told of. */
  private last: { level: number; bytes: number } | null = null;
  private complete = false;
  private running = false;
  /** Attributes are on their way to a picture: what is soon over waits for it. */
  private unseen = false;

  constructor(
    private readonly scope: WorkerScope,
    private readonly order: Extract<ToDecoder, { type: "open" }>,
  ) {
    // While the first bytes come.
    this.kernel = order.plain ? jsKernelModule.get().then(({ PlainKernel }) => new PlainKernel()) : bestKernel();
    const { source, name } = order;
    const bytes = typeof source === "string" ? new HttpSource(source, order.preloaded) : new BlobSource(source, name);
    this.loader = new Loader(bytes, {
      header: (assembler) => { this.begin(assembler); },
      manifest: (assembler) => { if (assembler.manifest) this.post({ type: "manifest", manifest: assembler.manifest }); },
      block: (level, record) => { this.addBlock(level, record); },
      shared: () => { this.refreshAll(); },
      ready: (level, done) => { this.levelReady(level, done); },
      progress: (done, total, rate) => { this.post({ type: "progress", progress: { bytes: done, total, rate } }); },
      notice: (text) => { this.post({ type: "notice", text }); },
      dropped: (level, record) => {
        for (const look of this.looks) look?.dropBlock(level, record);
        this.work();
      },
      rest: (bytes) => { this.rest(bytes); },
    }, new AbortController());
    this.loader.run().catch((error: unknown) => { this.fail(error); });
  }

  take(message: ToDecoder): void {
    switch (message.type) {
      case "view":
        this.eye = message.eye;
        this.loader.look(message.eye);
        this.serial = message.serial;
        for (const look of this.looks) look?.follow(message.eye, message.now);
        this.work();
        break;
      case "level":
        this.serial = message.serial;
        this.setLevel(message.side, message.cap);
        break;
      case "most":
        this.setMost(message.most);
        break;
      case "pause":
        this.loader.poke(message.paused);
        break;
      case "seen":
        if (this.unseen) this.resume();
        break;
      case "again":
        this.sendCenters();
        for (const look of this.looks) look?.restart();
        this.work();
        break;
      case "open":
        break;
    }
  }

  private setMost(most: number): void {
    this.most = Math.min(this.most, most);
    this.loader.cap = Math.min(this.loader.cap, this.most);
    this.setLevel(0, Math.min(this.caps[0], this.most));
    this.tellComplete();
  }

  private setLevel(side: Side, wanted: number | null): void {
    const cap = wanted === null ? null : Math.min(wanted, this.most);
    if (cap === null) {
      if (side) this.caps[1] = this.looks[1] = null;
      return;
    }
    this.caps[side] = cap;
    this.loader.cap = Math.max(this.loader.cap, cap);
    this.loader.poke();
    const look = this.looks[side];
    if (look) look.setCap(cap);
    else this.makeLook(side);
    this.work();
  }

  private makeLook(side: Side): void {
    const { assembler, made } = this;
    const cap = this.caps[side];
    if (!assembler || !made || cap === null) return;
    this.looks[side] = new LevelView(new Decoder(assembler, made, this.parts), assembler, cap);
  }

  private post(message: FromDecoder, transfer: Transferable[] = []): void {
    this.scope.postMessage(message, transfer);
  }

  private fail(error: unknown): void {
    const more = this.base && error instanceof RangeError;
    const problem = more ? new ViewerError("DeviceError", MORE) : asViewerError(error);
    this.post({ type: "error", trouble: problem.trouble, message: problem.message });
  }

  private begin(assembler: Assembler): void {
    this.assembler = assembler;
    const { header, levels } = assembler.index;
    const { budget } = this.order;
    const count = this.loader.levelsInFile();
    // There may be more splats than the budget: each region stands at what level it can.
    if (levels.slice(0, count).some(({ live }) => live > budget)) assembler.room = Math.max(budget, levels[0].live);
    this.most = Math.max(0, count - 1);
    this.caps[0] = this.most;
    this.loader.cap = this.most;
    this.loader.cores = this.order.cores ?? 1;
    const facts: SceneFacts = {
      name: this.order.name,
      levels,
      manifest: assembler.manifest,
      center: [header.center_x, header.center_y, header.center_z],
      radius: header.radius,
      extent: header.extent,
      most: this.most,
      room: assembler.room,
      cut: this.loader.cut !== "",
    };
    this.post({ type: "header", facts });
    this.kernel.then((kernel) => {
      this.made = kernel;
      this.makeLook(0);
      this.makeLook(1);
      this.sendCenters();
      this.work();
    }).catch((error: unknown) => { this.fail(error); });
  }

  private addBlock(level: number, record: BlockRecord): void {
    const { order, assembler } = this;
    this.sendCenters(...assembler!.slotsOf(level, record));
    if (!this.base) {
      // With the last block of the base it is ready as a whole, which is told next.
      if (order.whole || assembler!.levelsReady) return;
      this.base = true;
    }
    for (const look of this.looks) look?.addBlock(record);
    this.work();
  }

  /** Do not wait for blocks that get no rows. */
  private rest(bytes: number): void {
    this.last = { level: this.most, bytes };
    this.resume();
  }

  /** Decode what waited for a picture too. */
  private resume(): void {
    this.unseen = false;
    this.work();
  }

  private levelReady(level: number, bytes: number): void {
    if (!level) this.reserveAll(this.assembler!);
    this.ready.push({ level, bytes });
    if (!this.base) {
      this.base = true;
      this.refreshAll();
    }
    this.work();
  }

  /** Make all tables at once, which cost nothing until they are filled; without room for them a coarser level is shown still. */
  private reserveAll(assembler: Assembler): void {
    if (assembler.room < Infinity) return;
    try {
      assembler.reserve(assembler.index.levels[this.most]);
    } catch { /* Said when that level comes. */ }
  }

  /** Send the centres of slots, of all that may have come by default. */
  private sendCenters(first = 0, count = this.assembler?.rowsUpTo(this.most).live): void {
    const decoder = this.looks[0]?.decoder;
    if (!decoder || !count) return;
    const centers = decoder.centers(first, count);
    this.post({ type: "centers", first, centers }, [centers.buffer]);
  }

  private refreshAll(): void {
    for (const look of this.looks) look?.refreshAll();
    this.work();
  }

  /** Decode what is stale, in slices, until nothing is. */
  private work(): void {
    if (this.running) return;
    this.running = true;
    this.workOn().catch((error: unknown) => {
      this.running = false;
      this.fail(error);
    });
  }

  private async workOn(): Promise<void> {
    while (this.looks[0] && this.base && this.eye) {
      const { level = -1 } = this.ready.at(-1) ?? this.last ?? {};
      if (!this.unseen || level >= this.caps[0]) for (const look of this.looks) look?.showPassing();
      const due = this.looks[0].holdsBack ? 0 : this.ready.length;
      const side = this.looks[0].waits || due ? 0 : 1;
      const look = this.looks[side];
      if (!look || (side && !look.waits)) break;
      const { eye, serial } = this;
      const ready = this.ready.splice(0, side ? 0 : due);
      const begun = performance.now();
      const changes = await look.decode(eye, pause);
      const transfer = changes.pieces.flatMap(({ words, drawn }) => [words.buffer, drawn.buffer]);
      const seconds = (performance.now() - begun) / 1000;
      // Where regions stand at different levels, the coarsest counts.
      const focals = trainingFocalsOf(this.assembler!.manifest, Math.min(look.cap, Math.max(0, this.assembler!.levelsReady - 1)));
      this.unseen = true;
      // A side that was closed meanwhile is not shown again.
      if (this.looks[side] === look) this.post({ type: "attributes", side, ...changes, focals, serial, seconds }, transfer);
      this.tellMemory();
      for (const { level, bytes } of ready) {
        this.post({ type: "level-ready", level, bytes, seconds: this.seconds() });
        // What there is no room for is never ready: `rest` may have come before.
        if ((this.last?.level ?? 0) <= level) this.last = { level, bytes };
      }
      this.tellComplete();
      look.follow(this.eye, false);
      await pause();
    }
    // At once: who calls `work` after the last look at what is stale must find it stopped.
    this.running = false;
    this.tellComplete();
  }

  private tellComplete(): void {
    const { last } = this;
    if (this.complete || !last || last.level < this.most) return;
    this.complete = true;
    this.post({ type: "complete", bytes: last.bytes, seconds: this.seconds() });
  }

  private seconds(): number {
    return (performance.now() - this.started) / 1000;
  }

  private tellMemory(): void {
    let tables = 0;
    for (const array of Object.values(this.assembler!.tables)) tables += array.byteLength;
    const decoded = this.looks.reduce((sum, look) => sum + (look?.decoder.bytes ?? 0), 0);
    this.post({ type: "memory", tables, decoded, kernel: this.made!.name, workers: this.loader.workers });
  }
}

/** Let messages in. */
function pause(): Promise<void> {
  return new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      port1.close();
      resolve();
    };
    port2.postMessage(0);
  });
}
