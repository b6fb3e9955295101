// Hash grids' features of each visible anchor, trilinear: rows and weights of each anchor's corners
// are made once, as anchors do not move; twin of model/encoding.py.
//use place
struct Params { count: u32, levels: u32, all_levels: u32, features: u32, stride: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> corners: array<u32>;   // [N, all levels, 8]
@group(0) @binding(3) var<storage, read> weights: array<f32>;  // likewise
@group(0) @binding(4) var<storage, read> table: array<f32>;
@group(0) @binding(5) var<storage, read_write> inputs: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  let columns = params.levels * params.features;
  let v = n / columns;
  let level = (n % columns) / params.features;
  let f = n % params.features;
  if (v >= params.count) { return; }
  let corner = (rows[v] * params.all_levels + level) * 8u;
  var sum = 0.0;
  for (var c = 0u; c < 8u; c++) {
    sum += weights[corner + c] * table[corners[corner + c] * params.features + f];
  }
  inputs[v * params.stride + level * params.features + f] = sum;
}
