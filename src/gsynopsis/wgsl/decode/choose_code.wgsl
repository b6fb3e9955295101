// The codebook row of each visible anchor, and its values among the inputs of the heads: by the
// largest logit, the first of equal ones, or by what was frozen.
//use place
struct Params { count: u32, entries: u32, width: u32, frozen: u32, stride: u32, first: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> logits: array<f32>;
@group(0) @binding(3) var<storage, read> frozen_codes: array<u32>;
@group(0) @binding(4) var<storage, read> codebook: array<f32>;
@group(0) @binding(5) var<storage, read_write> codes: array<u32>;
@group(0) @binding(6) var<storage, read_write> inputs: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let v = place_of(at, groups);
  if (v >= params.count) { return; }
  var best = 0u;
  if (params.frozen != 0u) {
    best = frozen_codes[rows[v]];
  } else {
    let row = rows[v] * params.entries;
    for (var c = 1u; c < params.entries; c++) {
      if (logits[row + c] > logits[row + best]) { best = c; }
    }
  }
  codes[v] = best;
  for (var i = 0u; i < params.width; i++) {
    inputs[v * params.stride + params.first + i] = codebook[best * params.width + i];
  }
}
