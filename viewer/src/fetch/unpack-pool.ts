/** Workers that unpack blocks for a decoder's worker: checksum, inflating, values. */

import type { Assembler } from "../format/assembler";
import { unpackBlock } from "../format/block";
import type { Block, Packed } from "../format/block";
import { ViewerError, asViewerError } from "../base/errors";
import type { Trouble } from "../base/errors";
import type { Index } from "../format/file-index";

/** Scenes of fewer slots are there before another worker has started. */
const SLOTS_LEAST = 250_000;
const WORKERS_MAX = 4;

interface Job {
  readonly number: number;
  readonly packed: Packed;
}

type Done = { readonly number: number } & ({ readonly block: Block } | { readonly trouble: Trouble; readonly message: string });

interface Helper {
  readonly worker: Worker;
  readonly port: MessagePort;
  /** Jobs that it has not answered yet, by number. */
  readonly jobs: Map<number, { packed: Packed; resolve: (block: Block) => void; reject: (error: unknown) => void }>;
}

/** Unpacks in several workers at once; with the last of them gone, here. */
export class UnpackPool {
  private helpers: Helper[];
  private number = 0;

  constructor(
    private readonly index: Index,
    workers: number,
  ) {
    this.helpers = Array.from({ length: workers }, () => this.start());
  }

  get workers(): number {
    return Math.max(1, this.helpers.length);
  }

  /** Blocks that keep all workers busy while the next ones are handed out. */
  get most(): number {
    return 2 * this.workers;
  }

  /** The values of a block; an error is that of `unpackBlock`. */
  unpack(packed: Packed): Promise<Block> {
    const { helpers } = this;
    if (!helpers.length) return unpackBlock(packed, this.index);
    const least = helpers.reduce((a, b) => (b.jobs.size < a.jobs.size ? b : a));
    const number = this.number++;
    return new Promise((resolve, reject) => {
      least.jobs.set(number, { packed, resolve, reject });
      least.port.postMessage({ number, packed } satisfies Job);
    });
  }

  private start(): Helper {
    // The script that runs here: of a page that is one file it is no module.
    const worker = new Worker(location.href, { type: import.meta.url ? "module" : "classic" });
    const { port1, port2 } = new MessageChannel();
    const helper: Helper = { worker, port: port1, jobs: new Map() };
    port1.onmessage = ({ data }: MessageEvent<Done>) => { settle(helper, data); };
    worker.onerror = (event) => {
      event.preventDefault();
      this.lose(helper);
    };
    worker.postMessage({ type: "unpack", port: port2, index: this.index }, [port2]);
    return helper;
  }

  /** Give the jobs of a worker that broke to others. */
  private lose(helper: Helper): void {
    this.helpers = this.helpers.filter((other) => other !== helper);
    helper.worker.terminate();
    for (const { packed, resolve, reject } of helper.jobs.values()) this.unpack(packed).then(resolve, reject);
  }
}

function settle({ jobs }: Helper, done: Done): void {
  const job = jobs.get(done.number);
  jobs.delete(done.number);
  if ("block" in done) job?.resolve(done.block);
  else job?.reject(new ViewerError(done.trouble, done.message));
}

/** The pool for a large scene on a machine of so many cores; null where one worker does as well. */
export function poolFor({ index }: Assembler, level: number, cores: number): UnpackPool | null {
  const workers = Math.min(WORKERS_MAX, cores - 1);
  if (workers < 2 || index.levels[level].live < SLOTS_LEAST || typeof Worker === "undefined") return null;
  return new UnpackPool(index, workers);
}

/** Unpack what comes by `port`, as one of a pool's workers. */
export function serveUnpackPool(port: MessagePort, index: Index): void {
  port.onmessage = ({ data: { number, packed } }: MessageEvent<Job>) => {
    unpackBlock(packed, index).then(
      (block) => {
        const transfer = new Set(Object.values(block).map(({ buffer }) => buffer as ArrayBuffer));
        port.postMessage({ number, block } satisfies Done, [...transfer]);
      },
      (error: unknown) => {
        const { trouble, message } = asViewerError(error);
        port.postMessage({ number, trouble, message } satisfies Done);
      },
    );
  };
}
