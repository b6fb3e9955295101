/** The order in which splats are drawn: far to near, by a counting sort. */

/** Buckets of depth; float32 bits of a positive number rise with it, so they serve as key. */
const BUCKET_BITS = 16;

export class Sorter {
  private centers = new Float32Array(0);
  private drawn = new Uint8Array(0);
  private keys = new Uint32Array(0);
  private readonly counts = new Uint32Array((1 << BUCKET_BITS) + 1);
  private limit = 0;

  reset(capacity: number): void {
    this.centers = new Float32Array(3 * capacity);
    this.drawn = new Uint8Array(capacity);
    this.keys = new Uint32Array(capacity);
    this.limit = 0;
  }

  setCenters(first: number, centers: Float32Array): void {
    this.centers.set(centers, 3 * first);
  }

  setDrawn(first: number, drawn: Uint8Array, limit: number): void {
    const room = Math.max(0, this.drawn.length - first);
    this.drawn.set(drawn.subarray(0, room), first);
    this.limit = Math.min(limit, this.drawn.length);
  }

  /**
   * Numbers of the splats that are drawn and lie at least `near` before the camera.
   *
   * `row` is the third row of world to camera [4]. Returns how many there are in `order`.
   */
  sort(row: readonly number[], near: number, order: Uint32Array): number {
    const { centers, drawn, keys, counts, limit } = this;
    const [a, b, c, d] = row;
    const depth = new Float32Array(1);
    const bits = new Uint32Array(depth.buffer);
    let low = 0xffffffff;
    let high = 0;
    for (let i = 0; i < limit; i++) {
      keys[i] = 0;
      if (!drawn[i]) continue;
      depth[0] = a * centers[3 * i] + b * centers[3 * i + 1] + c * centers[3 * i + 2] + d;
      if (!(depth[0] >= near)) continue;
      const key = bits[0];
      keys[i] = key;
      if (key < low) low = key;
      if (key > high) high = key;
    }
    if (high === 0) return 0;
    let shift = 0;
    while ((high - low) >>> shift >= 1 << BUCKET_BITS) shift++;
    counts.fill(0);
    let total = 0;
    for (let i = 0; i < limit; i++) {
      if (!keys[i]) continue;
      counts[(high - keys[i]) >>> shift]++;
      total++;
    }
    for (let bucket = 0, at = 0; bucket < counts.length; bucket++) {
      const count = counts[bucket];
      counts[bucket] = at;
      at += count;
    }
    for (let i = 0; i < limit; i++) {
      if (keys[i]) order[counts[(high - keys[i]) >>> shift]++] = i;
    }
    return total;
  }
}
