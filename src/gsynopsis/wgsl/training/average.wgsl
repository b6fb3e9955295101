// Moves a running average towards the values.
//use place
struct Params { count: u32, share: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> averages: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = place_of(at, groups);
  if (i < params.count) { averages[i] += params.share * (values[i] - averages[i]); }
}
