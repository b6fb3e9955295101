// Dropout: opacities times their factors, which are kept for the way back; twin of
// training/regularize/dropout.py. `kept` holds 0 or 1 and becomes the factors.
//use place
struct Params { count: u32, most: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> kept: array<f32>;
@group(0) @binding(2) var<storage, read_write> gaussians: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let g = place_of(at, groups);
  if (g >= params.count) { return; }
  let opacity = gaussians[14u * g + 10u];
  let factor = kept[g] * min(1.0 / max(opacity, 1e-12), params.most);
  kept[g] = factor;
  gaussians[14u * g + 10u] = opacity * factor;
}
