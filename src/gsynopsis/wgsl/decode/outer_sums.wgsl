// What each part of the rows adds to the gradients of a layer's weights and of its bias, which
// is the last column: partials[part, o, i] = Σ of[v, o] in[v, i] over the part's rows, in order.
//use place
struct Params {
  count: u32, inputs: u32, outputs: u32, part: u32,
  of_stride: u32, of_first: u32, in_stride: u32, in_first: u32,
}
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pulls: array<f32>;
@group(0) @binding(2) var<storage, read> given: array<f32>;
@group(0) @binding(3) var<storage, read_write> partials: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  let columns = params.inputs + 1u;
  let i = n % columns;
  let o = (n / columns) % params.outputs;
  let first = n / (columns * params.outputs) * params.part;
  if (first >= params.count) { return; }
  let end = min(first + params.part, params.count);
  var sum = 0.0;
  for (var v = first; v < end; v++) {
    let pull = pulls[v * params.of_stride + params.of_first + o];
    if (i < params.inputs) {
      sum += pull * given[v * params.in_stride + params.in_first + i];
    } else {
      sum += pull;
    }
  }
  partials[n] = sum;
}
