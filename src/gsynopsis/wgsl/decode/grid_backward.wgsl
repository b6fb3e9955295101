// The table's gradient: each row gathers from the corners that stand on it, in the order of anchors,
// those of other levels and of unseen anchors left out.
//use place
struct Params { rows: u32, levels: u32, all_levels: u32, features: u32, stride: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>;   // of each row among the corners
@group(0) @binding(2) var<storage, read> order: array<u32>;    // corners by row
@group(0) @binding(3) var<storage, read> weights: array<f32>;  // [N, all levels, 8]
@group(0) @binding(4) var<storage, read> places: array<u32>;   // [N + 1] visible ones before
@group(0) @binding(5) var<storage, read> pulls: array<f32>;
@group(0) @binding(6) var<storage, read_write> grads: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  let row = n / params.features;
  let f = n % params.features;
  if (row >= params.rows) { return; }
  var sum = 0.0;
  for (var i = starts[row]; i < starts[row + 1u]; i++) {
    let corner = order[i];
    let level = (corner / 8u) % params.all_levels;
    let anchor = corner / (8u * params.all_levels);
    let v = places[anchor];
    if (level >= params.levels || places[anchor + 1u] == v) { continue; }
    sum += weights[corner] * pulls[v * params.stride + level * params.features + f];
  }
  grads[row * params.features + f] += sum;
}
