// Where each tile's pairs begin among pairs sorted by tile, [tiles + 1].
//use place
struct Params { count: u32, tiles: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var<storage, read_write> starts: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = place_of(at, groups);
  if (i > params.count) { return; }
  var first = 0u;
  if (i > 0u) { first = tiles[i - 1u] + 1u; }
  var last = params.tiles;
  if (i < params.count) { last = tiles[i]; }
  for (var tile = first; tile <= last; tile++) { starts[tile] = i; }
}
