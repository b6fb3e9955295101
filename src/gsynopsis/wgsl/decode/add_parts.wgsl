// Adds the parts' sums, in order, to the gradients of weights [outputs, inputs] and bias [outputs].
//use place
struct Params { parts: u32, inputs: u32, outputs: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> partials: array<f32>;
@group(0) @binding(2) var<storage, read_write> weights: array<f32>;
@group(0) @binding(3) var<storage, read_write> bias: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  let columns = params.inputs + 1u;
  let size = columns * params.outputs;
  if (n >= size) { return; }
  var sum = 0.0;
  for (var part = 0u; part < params.parts; part++) { sum += partials[part * size + n]; }
  let i = n % columns;
  let o = n / columns;
  if (i < params.inputs) {
    weights[o * params.inputs + i] += sum;
  } else {
    bias[o] += sum;
  }
}
