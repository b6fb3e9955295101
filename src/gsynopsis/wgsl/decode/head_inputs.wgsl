// Inputs of the heads but the grids' and the codebook's: residual, unit direction from the eye,
// and distance within what training cameras had; twin of model/heads_kernel.py.
//use place
struct Params {
  count: u32, stride: u32, first: u32, residual: u32,
  x: f32, y: f32, z: f32, extent: f32, low: f32, high: f32,
}
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> positions: array<f32>;
@group(0) @binding(3) var<storage, read> residuals: array<f32>;
@group(0) @binding(4) var<storage, read_write> inputs: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let v = place_of(at, groups);
  if (v >= params.count) { return; }
  let n = rows[v];
  var to = v * params.stride + params.first;
  for (var k = 0u; k < params.residual; k++) {
    inputs[to] = residuals[n * params.residual + k];
    to++;
  }
  let p = vec3<f32>(positions[3u * n], positions[3u * n + 1u], positions[3u * n + 2u]);
  let away = p - vec3<f32>(params.x, params.y, params.z);
  let distance = max(length(away), 1e-8);
  inputs[to] = away.x / distance;
  inputs[to + 1u] = away.y / distance;
  inputs[to + 2u] = away.z / distance;
  inputs[to + 3u] = clamp(distance / params.extent, params.low, params.high);
}
