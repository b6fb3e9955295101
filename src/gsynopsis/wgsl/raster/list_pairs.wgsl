// The pairs of splat and tile, splat by splat from near to far: a pair's number is its slot.
//use place splat
struct Params { count: u32, tiles_x: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> touched: array<u32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> splats: array<Splat>;
@group(0) @binding(5) var<storage, read_write> tiles: array<u32>;
@group(0) @binding(6) var<storage, read_write> slots: array<u32>;
@group(0) @binding(7) var<storage, read_write> pair_splats: array<u32>;
@group(0) @binding(8) var<storage, read_write> first_slots: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = place_of(at, groups);
  if (i >= params.count) { return; }
  let g = order[i];
  var slot = starts[i];
  first_slots[g] = slot;
  if (touched[g] == 0u) { return; }
  let columns = splats[g].columns;
  let rows = splats[g].rows;
  for (var row = rows & 0xffffu; row < (rows >> 16u); row++) {
    for (var column = columns & 0xffffu; column < (columns >> 16u); column++) {
      tiles[slot] = row * params.tiles_x + column;
      slots[slot] = slot;
      pair_splats[slot] = g;
      slot++;
    }
  }
}
