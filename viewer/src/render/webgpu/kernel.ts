/** Kernels on a WebGPU device: their parameters as bytes, their pipelines, and calls in a pass. */

import type { KernelText } from "./kernels.gen";

/** Invocations of a workgroup, and workgroups along one axis at most. */
const LANES = 256;
const ROW_MOST = 65_535;

/** Parameters in the layout of a kernel, a multiple of 16 bytes. */
export function packParams<Values extends readonly number[]>({ packing }: KernelText<Values>, values: Values): ArrayBuffer {
  const bytes = new ArrayBuffer(16 * Math.ceil(packing.length / 4));
  const [floats, whole] = [new Float32Array(bytes), new Uint32Array(bytes)];
  values.forEach((value, i) => { (packing[i] === "f" ? floats : whole)[i] = value; });
  return bytes;
}

/** A part of a buffer, or all of it. */
export type Bound = GPUBuffer | GPUBufferBinding;

const bindingOf = (bound: Bound): GPUBufferBinding => ("buffer" in bound ? bound : { buffer: bound });

/** Workgroups for so many invocations, as rows where one is too short. */
export function groupsOf(count: number, each = LANES): [number, number] {
  const groups = Math.max(1, Math.ceil(count / each));
  return [Math.min(groups, ROW_MOST), Math.ceil(groups / ROW_MOST)];
}

/** A kernel with the buffers that it works on. */
export interface Call {
  readonly pipeline: GPUComputePipeline;
  readonly group: GPUBindGroup;
}

/** The kernels of one device. */
export class Kernels {
  private readonly pipelines = new Map<string, GPUComputePipeline>();

  constructor(readonly device: GPUDevice) {}

  /** `bound`: what stands at bindings 0, 1, … */
  call({ code }: { readonly code: string }, ...bound: Bound[]): Call {
    const { device, pipelines } = this;
    let pipeline = pipelines.get(code);
    if (!pipeline) {
      const module = device.createShaderModule({ code });
      pipeline = device.createComputePipeline({ layout: "auto", compute: { module } });
      pipelines.set(code, pipeline);
    }
    return { pipeline, group: groupOf(device, pipeline, bound) };
  }

  /** Bytes for kernels, in which nothing is known to be. */
  buffer(bytes: number, usage = 0): GPUBuffer {
    const { STORAGE, COPY_DST } = GPUBufferUsage;
    return this.device.createBuffer({ size: Math.max(16, 4 * Math.ceil(bytes / 4)), usage: STORAGE | COPY_DST | usage });
  }

  /** A uniform buffer. */
  uniform(bytes: number): GPUBuffer {
    return this.device.createBuffer({ size: bytes, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
  }
}

/** Buffers, and a texture behind them, for the first group of a pipeline. */
export function groupOf(device: GPUDevice, pipeline: GPUComputePipeline | GPURenderPipeline, bound: readonly Bound[], view?: GPUTextureView): GPUBindGroup {
  const resources: GPUBindingResource[] = bound.map(bindingOf);
  if (view) resources.push(view);
  return device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries: resources.map((resource, binding) => ({ binding, resource })) });
}

export function run(pass: GPUComputePassEncoder, { pipeline, group }: Call, [x, y]: readonly [number, number]): void {
  pass.setPipeline(pipeline);
  pass.setBindGroup(0, group);
  pass.dispatchWorkgroups(x, y);
}

/** The same with workgroups that the device found, three words from a place of a buffer on. */
export function runPlanned(pass: GPUComputePassEncoder, { pipeline, group }: Call, plan: GPUBuffer, word: number): void {
  pass.setPipeline(pipeline);
  pass.setBindGroup(0, group);
  pass.dispatchWorkgroupsIndirect(plan, 4 * word);
}
