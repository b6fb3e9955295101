// One pass of a stable radix sort: keys and values to the places of an eight-bit digit.
//
// Ranks within 256 keys come from a bit for each key in a mask by digit: no subgroups, and no
// atomic whose result depends on who came first.
//use place
struct Params { count: u32, shift: u32, blocks: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<u32>;
@group(0) @binding(3) var<storage, read> places: array<u32>;
@group(0) @binding(4) var<storage, read_write> sorted_keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> sorted_values: array<u32>;
var<workgroup> masks: array<atomic<u32>, 2048>;
var<workgroup> next: array<u32, 256>;

@compute @workgroup_size(256)
fn main(
  @builtin(local_invocation_index) lane: u32,
  @builtin(workgroup_id) group: vec3<u32>,
  @builtin(num_workgroups) groups: vec3<u32>,
) {
  let block = group_of(group, groups);
  let word = lane / 32u;
  let bit = 1u << (lane & 31u);
  if (block < params.blocks) { next[lane] = places[lane * params.blocks + block]; }
  for (var round = 0u; round < 4u; round++) {
    for (var k = 0u; k < 8u; k++) { atomicStore(&masks[k * 256u + lane], 0u); }
    workgroupBarrier();
    let i = block * 1024u + round * 256u + lane;
    let there = i < params.count;
    var key = 0u;
    if (there) { key = keys[i]; }
    let digit = (key >> params.shift) & 255u;
    if (there) { atomicOr(&masks[digit * 8u + word], bit); }
    workgroupBarrier();
    if (there) {
      var rank = countOneBits(atomicLoad(&masks[digit * 8u + word]) & (bit - 1u));
      for (var w = 0u; w < word; w++) { rank += countOneBits(atomicLoad(&masks[digit * 8u + w])); }
      let to = next[digit] + rank;
      sorted_keys[to] = key;
      sorted_values[to] = values[i];
    }
    workgroupBarrier();
    var more = 0u;
    for (var w = 0u; w < 8u; w++) { more += countOneBits(atomicLoad(&masks[lane * 8u + w])); }
    next[lane] += more;
    workgroupBarrier();
  }
}
