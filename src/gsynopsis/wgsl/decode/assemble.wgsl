// Drawn slots to Gaussians; twin of model/assemble.py.
//use place slots
struct Params { count: u32, slots: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> raw: array<f32>;
@group(0) @binding(4) var<storage, read> positions: array<f32>;
@group(0) @binding(5) var<storage, read> log_scales: array<f32>;
@group(0) @binding(6) var<storage, read> offsets: array<f32>;
@group(0) @binding(7) var<storage, read> log_gain: array<f32>;
@group(0) @binding(8) var<storage, read_write> gaussians: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = place_of(at, groups);
  let v = i / params.slots;
  let k = i % params.slots;
  if (v >= params.count || starts[i + 1u] == starts[i]) { return; }
  let g = starts[i] * 14u;
  let n = rows[v];
  let offset = (n * params.slots + k) * 3u;
  let cov = covariance_at(v, k, params.slots);
  let color = color_at(v, k, params.slots);
  for (var a = 0u; a < 3u; a++) {
    gaussians[g + a] = positions[3u * n + a] + offsets[offset + a] * exp(log_scales[6u * n + a]);
    let size = exp(log_scales[6u * n + 3u + a]);
    gaussians[g + 7u + a] = size * sigmoid(raw[cov + a]) * exp(log_gain[a]);
    gaussians[g + 11u + a] = sigmoid(raw[color + a]);
  }
  let q = vec4<f32>(raw[cov + 3u], raw[cov + 4u], raw[cov + 5u], raw[cov + 6u]);
  let unit = q / max(length(q), 1e-12);
  gaussians[g + 3u] = unit.x;
  gaussians[g + 4u] = unit.y;
  gaussians[g + 5u] = unit.z;
  gaussians[g + 6u] = unit.w;
  gaussians[g + 10u] = activated(raw[opacity_at(v, k, params.slots)]);
}
