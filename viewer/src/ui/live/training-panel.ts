/** Panel on the progress of a running training, from the report beside its file. */

import { appendElement } from "../shell";

/** Report of `train --viewer`; values that it does not know are null. */
interface Report {
  readonly phase: string;
  /** Steps done and to be done, of all phases. */
  readonly step: number;
  readonly steps: number;
  readonly loss: number | null;
  readonly held_out: { readonly psnr: number; readonly step: number; readonly views: number } | null;
  /** Seconds. */
  readonly remaining: number | null;
  readonly finished: boolean;
  /** The file's last version. */
  readonly version: { readonly step: number; readonly bytes: number } | null;
  /** Steps and their loss. */
  readonly curve: readonly (readonly [number, number])[];
}

const MIB = 2 ** 20;

export class TrainingPanel {
  private readonly address: string;
  /** The server says nothing beside this file. */
  private silent = false;
  private closed = false;

  /** Tells in `place` what stands beside a file, under its name with the ending `.json`. */
  constructor(file: URL, private readonly place: HTMLElement) {
    const beside = new URL(file);
    beside.pathname = beside.pathname.replace(/\.\w+$/, "") + ".json";
    beside.search = "";
    this.address = beside.href;
  }

  /** Ask, and show the answer; `shown` is the size of the file on screen, bytes. */
  async look(shown: number): Promise<void> {
    if (this.silent) return;
    const answer = await fetch(this.address, { cache: "no-store" }).catch(() => null);
    this.silent = answer?.status === 404;
    const report = answer?.ok ? ((await answer.json().catch(() => null)) as Report | null) : null;
    if (report && !this.closed) this.show(report, shown);
  }

  close(): void {
    this.closed = true;
    this.place.hidden = true;
  }

  private show(report: Report, shown: number): void {
    const { place } = this;
    const { finished, held_out: heldOut, remaining, version } = report;
    place.hidden = false;
    place.replaceChildren();
    const header = appendElement("header", "", place);
    appendElement("span", "", header).textContent = finished ? "Trained" : `Training: ${report.phase}`;
    if (!finished && remaining !== null) appendElement("span", "", header).textContent = `${duration(remaining)} left`;
    const share = appendElement("i", "", appendElement("div", "share", place));
    share.style.width = `${(100 * report.step) / Math.max(1, report.steps)}%`;
    const list = appendElement("dl", "", place);
    const say = (term: string, text: string) => {
      appendElement("dt", "", list).textContent = term;
      appendElement("dd", "", list).textContent = text;
    };
    say("step", `${count(report.step)} of ${count(report.steps)}`);
    if (report.loss !== null) say("loss", report.loss.toFixed(4));
    if (heldOut) say("held-out", `${heldOut.psnr.toFixed(2)} dB on ${heldOut.views} photo${heldOut.views === 1 ? "" : "s"}`);
    if (shown) {
      const step = version?.bytes === shown ? `step ${count(version.step)}, ` : "";
      say("shown", `${step}${(shown / MIB).toFixed(2)} MiB`);
    }
    if (report.curve.length > 1) place.append(plot(report));
  }
}

/** The loss over the steps, on a logarithmic scale. Nothing but numbers goes into the text. */
function plot({ curve, steps }: Report): DocumentFragment {
  const heights = curve.map(([, loss]) => Math.log(Math.max(loss, 1e-6)));
  const low = Math.min(...heights);
  const span = Math.max(...heights) - low || 1;
  const points = curve.map(([step], k) => `${(100 * step) / Math.max(1, steps)},${96 - (92 * (heights[k] - low)) / span}`);
  const label = `Loss from ${curve[0][1].toFixed(4)} to ${curve[curve.length - 1][1].toFixed(4)}`;
  const template = document.createElement("template");
  template.innerHTML =
    `<svg viewBox="0 0 100 100" preserveAspectRatio="none" role="img" aria-label="${label}">` +
    `<line x1="0" x2="100" y1="99" y2="99"/><polyline points="${points.join(" ")}"/></svg>`;
  return template.content;
}

function count(value: number): string {
  return value.toLocaleString("en");
}

function duration(seconds: number): string {
  if (seconds < 100) return `${Math.max(1, Math.round(seconds))} s`;
  const minutes = Math.round(seconds / 60);
  return minutes < 100 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}
