/** Pictures of projected splats: on a view of a texture, shrunk, or read back. */

import type { DepthSort } from "./depth-sort";
import { SHRINK, SPLATS } from "./kernels.gen";
import { groupOf } from "./kernel";
import type { Kernels } from "./kernel";

/** Left edge and width of the columns that are drawn. */
export type Columns = readonly [left: number, width: number];

export class Pictures {
  private readonly pipelines = new Map<string, GPURenderPipeline>();
  private readonly size: GPUBuffer;
  private readonly times: GPUBuffer;

  constructor(private readonly kernels: Kernels) {
    this.size = kernels.uniform(16);
    this.times = kernels.uniform(16);
  }

  /** Draw what was sorted on a view of so many pixels, cleared before if `first`. */
  draw(encoder: GPUCommandEncoder, sorted: DepthSort, view: GPUTextureView, format: GPUTextureFormat, [left, width]: Columns, size: readonly [number, number], first: boolean): void {
    const { device } = this.kernels;
    const pipeline = this.pipeline("splats", SPLATS, format, true);
    device.queue.writeBuffer(this.size, 0, new Float32Array(size));
    const pass = passOn(encoder, view, first);
    pass.setScissorRect(left, 0, width, size[1]);
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, groupOf(device, pipeline, [this.size, sorted.order, sorted.drawn]));
    pass.drawIndirect(sorted.plan, sorted.draw);
    pass.end();
  }

  /** Draw a larger picture on a view, each pixel of which is the mean of a square. */
  shrink(encoder: GPUCommandEncoder, large: GPUTexture, view: GPUTextureView, format: GPUTextureFormat, times: number): void {
    const { device } = this.kernels;
    const pipeline = this.pipeline("shrink", SHRINK, format, false);
    device.queue.writeBuffer(this.times, 0, new Uint32Array([times]));
    const pass = passOn(encoder, view, true);
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, groupOf(device, pipeline, [this.times], large.createView()));
    pass.draw(3);
    pass.end();
  }

  close(): void {
    this.size.destroy();
    this.times.destroy();
  }

  private pipeline(name: string, code: string, format: GPUTextureFormat, blends: boolean): GPURenderPipeline {
    const key = `${name} ${format}`;
    let found = this.pipelines.get(key);
    if (!found) {
      const { device } = this.kernels;
      const module = device.createShaderModule({ code });
      const over = { srcFactor: "one", dstFactor: "one-minus-src-alpha" } as const;
      const target = blends ? { format, blend: { color: over, alpha: over } } : { format };
      found = device.createRenderPipeline({ layout: "auto", vertex: { module }, fragment: { module, targets: [target] } });
      this.pipelines.set(key, found);
    }
    return found;
  }
}

function passOn(encoder: GPUCommandEncoder, view: GPUTextureView, clear: boolean): GPURenderPassEncoder {
  return encoder.beginRenderPass({ colorAttachments: [{ view, loadOp: clear ? "clear" : "load", storeOp: "store", clearValue: [0, 0, 0, 0] }] });
}

/** Clear a view. */
export function clear(encoder: GPUCommandEncoder, view: GPUTextureView): void {
  passOn(encoder, view, true).end();
}

/** The number of binary16 bits that is not below 0. */
export function ofHalf(bits: number): number {
  const exponent = bits >> 10;
  const fraction = bits & 1023;
  return exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : fraction * 2 ** -24;
}

/** RGBA8 of a texture of rgba16float, top row first. */
export async function readBack(device: GPUDevice, texture: GPUTexture): Promise<Uint8ClampedArray> {
  const { width, height } = texture;
  const row = 256 * Math.ceil((8 * width) / 256);
  const buffer = device.createBuffer({ size: row * height, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
  const encoder = device.createCommandEncoder();
  encoder.copyTextureToBuffer({ texture }, { buffer, bytesPerRow: row }, [width, height]);
  device.queue.submit([encoder.finish()]);
  await buffer.mapAsync(GPUMapMode.READ);
  const halves = new Uint16Array(buffer.getMappedRange());
  const out = new Uint8ClampedArray(4 * width * height);
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < 4 * width; x++) out[4 * width * y + x] = 255 * ofHalf(halves[(row / 2) * y + x]);
  }
  buffer.destroy();
  return out;
}
