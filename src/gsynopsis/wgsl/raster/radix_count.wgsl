// Numbers of keys by an eight-bit digit in each block of 1,024: [digit, block].
//use place
struct Params { count: u32, shift: u32, blocks: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;
var<workgroup> found: array<atomic<u32>, 256>;

@compute @workgroup_size(256)
fn main(
  @builtin(local_invocation_index) lane: u32,
  @builtin(workgroup_id) group: vec3<u32>,
  @builtin(num_workgroups) groups: vec3<u32>,
) {
  let block = group_of(group, groups);
  atomicStore(&found[lane], 0u);
  workgroupBarrier();
  for (var round = 0u; round < 4u; round++) {
    let i = block * 1024u + round * 256u + lane;
    if (i < params.count) { atomicAdd(&found[(keys[i] >> params.shift) & 255u], 1u); }
  }
  workgroupBarrier();
  if (block < params.blocks) { counts[lane * params.blocks + block] = atomicLoad(&found[lane]); }
}
