// Adds a stretch of the visible anchors' gradients to the rows of all anchors, [N, width].
//use place
struct Params { count: u32, width: u32, stride: u32, first: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> pulls: array<f32>;
@group(0) @binding(3) var<storage, read_write> grads: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  let v = n / params.width;
  let i = n % params.width;
  if (v >= params.count) { return; }
  grads[rows[v] * params.width + i] += pulls[v * params.stride + params.first + i];
}
