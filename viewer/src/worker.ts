/** The worker's two roles: to load and decode a scene, or to sort its splats. */

import { Assembler } from "./assembler";
import type { BlockRecord } from "./directory";
import { Decoder, PAGE } from "./decoder";
import { asViewerError } from "./errors";
import { bestKernel } from "./simd";
import { Loader } from "./loader";
import type { Attributes, Eye, FromDecoder, SceneFacts, ToDecoder, ToSorter } from "./messages";
import { WORDS } from "./pack";
import { PlainKernel } from "./plain";
import { Sorter } from "./sorter";
import { BlobSource, HttpSource } from "./source";

/** Milliseconds of decoding between looks at the messages. */
const SLICE = 12;
/** An eye that moved less than this share of the scene's extent sees the same. */
const MOVED = 0.004;

export interface Scope {
  onmessage: ((event: MessageEvent) => void) | null;
  postMessage(message: unknown, transfer?: Transferable[]): void;
}

/** Start as what the first message asks for. */
export function startWorker(scope: Scope): void {
  let decoding: Decoding | null = null;
  const sorter = new Sorter();
  scope.onmessage = (event: MessageEvent<ToDecoder | ToSorter>) => {
    const message = event.data;
    switch (message.type) {
      case "open":
        decoding = new Decoding(scope, message);
        break;
      case "reset":
        sorter.reset(message.capacity);
        break;
      case "centers":
        sorter.setCenters(message.first, message.centers);
        break;
      case "drawn":
        sorter.setDrawn(message.first, message.drawn, message.limit);
        break;
      case "sort": {
        const order = message.spare ?? new Uint32Array(0);
        const count = sorter.sort(message.row, message.near, order);
        scope.postMessage({ type: "order", order, count, serial: message.serial }, [order.buffer]);
        break;
      }
      default:
        decoding?.take(message);
    }
  };
}

/** One scene: its loader, its tables, and what of them has to be decoded next. */
class Decoding {
  private readonly started = performance.now();
  private readonly loader: Loader;
  private decoder: Decoder | null = null;
  private assembler: Assembler | null = null;
  private eye: Eye | null = null;
  private cap = 0;
  private most = 0;
  private serial = 0;
  private base = false;
  /** All anchors, or those of blocks that came since. */
  private stale: "all" | BlockRecord[] = [];
  private ready: { level: number; bytes: number }[] = [];
  private seenFrom: readonly number[] | null = null;
  private running = false;
  private kernelName: "wasm" | "plain" = "plain";

  constructor(
    private readonly scope: Scope,
    private readonly order: Extract<ToDecoder, { type: "open" }>,
  ) {
    const { source, name } = order;
    const bytes = typeof source === "string" ? new HttpSource(source) : new BlobSource(source, name);
    this.loader = new Loader(bytes, {
      header: (assembler) => { this.begin(assembler); },
      manifest: (assembler) => { if (assembler.manifest) this.post({ type: "manifest", manifest: assembler.manifest }); },
      block: (level, record) => { this.addBlock(level, record); },
      shared: () => { this.refreshAll(); },
      ready: (level, done) => { this.levelReady(level, done); },
      progress: (done, total, rate) => { this.post({ type: "progress", progress: { bytes: done, total, rate } }); },
      notice: (text) => { this.post({ type: "notice", text }); },
    }, new AbortController());
    this.loader.run().catch((error: unknown) => { this.fail(error); });
  }

  take(message: ToDecoder): void {
    switch (message.type) {
      case "view":
        this.eye = message.eye;
        this.loader.eye = message.eye;
        this.serial = message.serial;
        if (message.now || this.hasMoved()) this.refreshAll();
        break;
      case "level":
        this.cap = Math.min(message.cap, this.most);
        this.serial = message.serial;
        this.loader.cap = Math.max(this.loader.cap, this.cap);
        this.loader.poke();
        this.refreshAll();
        break;
      case "pause":
        this.loader.poke(message.paused);
        break;
      case "again":
        this.sendAllCenters();
        this.refreshAll();
        break;
      case "open":
        break;
    }
  }

  private post(message: FromDecoder, transfer: Transferable[] = []): void {
    this.scope.postMessage(message, transfer);
  }

  private fail(error: unknown): void {
    const problem = asViewerError(error);
    this.post({ type: "error", trouble: problem.trouble, message: problem.message });
  }

  private begin(assembler: Assembler): void {
    this.assembler = assembler;
    const { header, levels } = assembler.index;
    const fits = levels.filter((level) => level.live <= this.order.budget).length;
    this.most = Math.max(0, fits - 1);
    this.cap = this.most;
    this.loader.cap = this.most;
    const facts: SceneFacts = {
      name: this.order.name,
      levels: levels.map(({ end, anchors, live }) => ({ end, anchors, live })),
      manifest: assembler.manifest,
      center: [header.center_x, header.center_y, header.center_z],
      radius: header.radius,
      extent: header.extent,
      most: this.most,
    };
    this.post({ type: "header", facts });
    this.makeDecoder(assembler).catch((error: unknown) => { this.fail(error); });
  }

  private async makeDecoder(assembler: Assembler): Promise<void> {
    const kernel = (this.order.plain ? null : await bestKernel()) ?? new PlainKernel();
    this.kernelName = kernel.name;
    this.decoder = new Decoder(assembler, kernel);
    this.sendAllCenters();
    this.refreshAll();
  }

  private addBlock(level: number, record: BlockRecord): void {
    this.sendCenters(level, record);
    if (!this.base) return;
    if (this.stale !== "all") this.stale.push(record);
    this.work();
  }

  private levelReady(level: number, bytes: number): void {
    this.ready.push({ level, bytes });
    if (level === 0) {
      this.base = true;
      this.stale = "all";
    }
    this.work();
  }

  private sendCenters(level: number, record: BlockRecord): void {
    const { decoder, assembler } = this;
    const count = record.live - record.before;
    if (!decoder || !assembler || !count) return;
    const first = (level ? assembler.index.levels[level - 1].live : 0) + record.firstSlot;
    const centers = decoder.centers(first, count);
    this.post({ type: "centers", first, centers }, [centers.buffer]);
  }

  private sendAllCenters(): void {
    const { decoder, assembler } = this;
    const count = assembler?.tables.slot.length ?? 0;
    if (!decoder || !count) return;
    const centers = decoder.centers(0, count);
    this.post({ type: "centers", first: 0, centers }, [centers.buffer]);
  }

  private hasMoved(): boolean {
    const { eye, seenFrom, assembler } = this;
    if (!eye || !seenFrom || !assembler) return true;
    const [x, y, z] = eye.position.map((value, i) => value - seenFrom[i]);
    return Math.sqrt(x * x + y * y + z * z) > MOVED * assembler.index.header.extent;
  }

  private refreshAll(): void {
    this.stale = "all";
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
    while (this.decoder && this.base && this.eye && (this.stale === "all" || this.stale.length || this.ready.length)) {
      const { decoder, eye, cap, serial, stale } = this;
      const ready = this.ready.splice(0);
      const ranges = stale === "all" ? undefined : stale.flatMap((record) => Assembler.rangesOf(record));
      this.stale = [];
      // Blocks are decoded for the eye of what is there already; a view that moved decodes all.
      const from = ranges && this.seenFrom ? this.seenFrom : eye.position;
      this.seenFrom = from;
      const begun = performance.now();
      let slice = begun;
      const steps = decoder.refresh(cap, [from[0], from[1], from[2]], ranges);
      while (!steps.next().done) {
        if (performance.now() - slice < SLICE) continue;
        await pause();
        slice = performance.now();
      }
      this.sendAttributes(cap, serial, (performance.now() - begun) / 1000);
      for (const { level, bytes } of ready) {
        this.post({ type: "level-ready", level, bytes, seconds: this.seconds() });
        if (level === this.most) this.post({ type: "complete", bytes, seconds: this.seconds() });
      }
      if (this.hasMoved()) this.stale = "all";
      await pause();
    }
    // At once: who calls `work` after the last look at what is stale must find it stopped.
    this.running = false;
  }

  private seconds(): number {
    return (performance.now() - this.started) / 1000;
  }

  private sendAttributes(cap: number, serial: number, seconds: number): void {
    const decoder = this.decoder!;
    const assembler = this.assembler!;
    const pieces: Attributes[] = [];
    const transfer: Transferable[] = [];
    for (const [page, pages] of decoder.takePages()) {
      const words = decoder.words.slice(page * PAGE * WORDS, (page + pages) * PAGE * WORDS);
      const drawn = new Uint8Array(pages * PAGE);
      for (let i = 0; i < drawn.length; i++) drawn[i] = words[i * WORDS + 7] >>> 16 ? 1 : 0;
      pieces.push({ first: page * PAGE, words, drawn });
      transfer.push(words.buffer, drawn.buffer);
    }
    const finest = Math.max(0, Math.min(cap, decoder.finestShared));
    const limit = assembler.index.levels[finest].live;
    this.post({ type: "attributes", pieces, limit, serial, seconds }, transfer);
    const tables = Object.values(assembler.tables as unknown as Record<string, ArrayBufferView>).reduce((sum, a) => sum + a.byteLength, 0);
    this.post({ type: "memory", tables, decoded: decoder.bytes, kernel: this.kernelName });
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
