// Of each workgroup, over its slots: opacity and volume of the drawn ones, and how many opacities
// are not a number. [groups, 3]
//use place slots group_sum
struct Params { count: u32, slots: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>;
@group(0) @binding(2) var<storage, read> raw: array<f32>;
@group(0) @binding(3) var<storage, read> gaussians: array<f32>;
@group(0) @binding(4) var<storage, read_write> totals: array<f32>;

@compute @workgroup_size(256)
fn main(
  @builtin(global_invocation_id) at: vec3<u32>,
  @builtin(local_invocation_index) lane: u32,
  @builtin(workgroup_id) group: vec3<u32>,
  @builtin(num_workgroups) groups: vec3<u32>,
) {
  let i = place_of(at, groups);
  let block = group_of(group, groups);
  let count = params.count * params.slots;
  var share = vec3<f32>(0.0);
  if (i < count) {
    let value = raw[opacity_at(i / params.slots, i % params.slots, params.slots)];
    // By its bits: a compiler may take zero times anything for zero.
    if ((bitcast<u32>(value) & 0x7fffffffu) > 0x7f800000u) { share.z = 1.0; }
    if (starts[i + 1u] > starts[i]) {
      let g = starts[i] * 14u;
      share.x = activated(value);  // before dropout
      share.y = gaussians[g + 7u] * gaussians[g + 8u] * gaussians[g + 9u];
    }
  }
  let total = group_sum(lane, share);
  if (lane == 0u && 256u * block < count) {
    totals[3u * block] = total.x;
    totals[3u * block + 1u] = total.y;
    totals[3u * block + 2u] = total.z;
  }
}
