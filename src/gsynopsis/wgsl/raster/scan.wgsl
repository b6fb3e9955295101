// Exclusive prefix sums within blocks of 1,024, in place, and the sum of each block.
//use place
struct Params { count: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> values: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
var<workgroup> totals: array<u32, 256>;

@compute @workgroup_size(256)
fn main(
  @builtin(local_invocation_index) lane: u32,
  @builtin(workgroup_id) group: vec3<u32>,
  @builtin(num_workgroups) groups: vec3<u32>,
) {
  let block = group_of(group, groups);
  let first = block * 1024u + lane * 4u;
  var own: array<u32, 4>;
  var sum = 0u;
  for (var k = 0u; k < 4u; k++) {
    own[k] = sum;
    if (first + k < params.count) { sum += values[first + k]; }
  }
  totals[lane] = sum;
  workgroupBarrier();
  for (var step = 1u; step < 256u; step *= 2u) {
    var more = 0u;
    if (lane >= step) { more = totals[lane - step]; }
    workgroupBarrier();
    totals[lane] += more;
    workgroupBarrier();
  }
  let before = totals[lane] - sum;
  for (var k = 0u; k < 4u; k++) {
    if (first + k < params.count) { values[first + k] = before + own[k]; }
  }
  if (lane == 255u && block * 1024u < params.count) { sums[block] = totals[255]; }
}
