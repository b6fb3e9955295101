// The soft choice of a codebook row: with w = softmax(logits) and u the pull on each row's values,
// the logits' gradient is w (u − ⟨w, u⟩); twin of StraightThrough in model/encoding.py.
//use place
struct Params { count: u32, entries: u32, width: u32, stride: u32, first: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> logits: array<f32>;
@group(0) @binding(3) var<storage, read> codebook: array<f32>;
@group(0) @binding(4) var<storage, read> pulls: array<f32>;
@group(0) @binding(5) var<storage, read_write> grads: array<f32>;

fn pull_on(v: u32, c: u32) -> f32 {
  var sum = 0.0;
  for (var i = 0u; i < params.width; i++) {
    sum += codebook[c * params.width + i] * pulls[v * params.stride + params.first + i];
  }
  return sum;
}

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let v = place_of(at, groups);
  if (v >= params.count) { return; }
  let row = rows[v] * params.entries;
  var most = logits[row];
  for (var c = 1u; c < params.entries; c++) { most = max(most, logits[row + c]); }
  var total = 0.0;
  var inner = 0.0;
  for (var c = 0u; c < params.entries; c++) {
    let weight = exp(logits[row + c] - most);
    total += weight;
    inner += weight * pull_on(v, c);
  }
  let mean = inner / total;
  for (var c = 0u; c < params.entries; c++) {
    grads[row + c] += exp(logits[row + c] - most) / total * (pull_on(v, c) - mean);
  }
}
