/** Throughput of a connection; as stream/policy.py. */

/** Half-lives of the two averages, seconds; the smaller average counts (dash.js). */
const FAST_SECONDS = 3;
const SLOW_SECONDS = 8;
/** Bytes per second before anything is measured: 500 kbit/s (hls.js). */
export const START_RATE = 62_500;

/** Bytes that arrived within some seconds. */
export interface Sample {
  readonly amount: number;
  readonly seconds: number;
}

/** Throughput to count on, bytes per second, before the safety factor. */
export function estimateThroughput(samples: readonly Sample[]): number {
  if (!samples.length) return START_RATE;
  const averages = [FAST_SECONDS, SLOW_SECONDS].map((half) => {
    let value = 0;
    let weight = 0;
    for (const { amount, seconds } of samples) {
      const keep = 0.5 ** (seconds / half);
      value = keep * value + ((1 - keep) * amount) / seconds;
      weight = keep * weight + 1 - keep;
    }
    return value / weight;
  });
  return Math.min(...averages);
}
