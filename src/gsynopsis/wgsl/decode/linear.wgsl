// A layer: out[v, o] = bias[o] + Σ weights[o, i] in[v, i], and ReLU if it is asked for.
//use place
struct Params {
  count: u32, inputs: u32, outputs: u32,
  in_stride: u32, in_first: u32, out_stride: u32, out_first: u32, relu: u32,
}
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read> bias: array<f32>;
@group(0) @binding(3) var<storage, read> given: array<f32>;
@group(0) @binding(4) var<storage, read_write> made: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = place_of(at, groups);
  let v = i / params.outputs;
  let o = i % params.outputs;
  if (v >= params.count) { return; }
  let x = v * params.in_stride + params.in_first;
  let w = o * params.inputs;
  var sum = bias[o];
  for (var k = 0u; k < params.inputs; k++) { sum += weights[w + k] * given[x + k]; }
  if (params.relu != 0u && sum < 0.0) { sum = 0.0; }  // not a maximum, so that NaN stays NaN
  made[v * params.out_stride + params.out_first + o] = sum;
}
