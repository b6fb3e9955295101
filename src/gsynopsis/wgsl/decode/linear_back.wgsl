// The gradient of a layer's inputs: pulls[v, i] (+)= Σ weights[o, i] of[v, o], where the input
// was open (above zero) if it came from a ReLU.
//use place
struct Params {
  count: u32, inputs: u32, outputs: u32,
  of_stride: u32, of_first: u32, to_stride: u32, to_first: u32, relu: u32, add: u32,
}
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read> pulls: array<f32>;
@group(0) @binding(3) var<storage, read> opened: array<f32>;
@group(0) @binding(4) var<storage, read_write> to: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  let v = n / params.inputs;
  let i = n % params.inputs;
  if (v >= params.count) { return; }
  let place = v * params.to_stride + params.to_first + i;
  let from_row = v * params.of_stride + params.of_first;
  var sum = 0.0;
  for (var o = 0u; o < params.outputs; o++) {
    sum += weights[o * params.inputs + i] * pulls[from_row + o];
  }
  if (params.relu != 0u && !(opened[place] > 0.0)) { sum = 0.0; }
  if (params.add != 0u) { sum += to[place]; }
  to[place] = sum;
}
