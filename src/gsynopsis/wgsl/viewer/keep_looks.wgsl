// Looks of splats first … first + count at a time, kept to turn into what is set next.
//use place look
struct Params { first: u32, count: u32, limit: u32, changing: u32, time: f32, fade: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> words: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> before: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> times: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = place_of(at, groups);
  if (i >= params.count) { return; }
  let splat = params.first + i;
  let look = look_of(splat);
  before[2u * splat] = look.one;
  before[2u * splat + 1u] = look.two;
}
