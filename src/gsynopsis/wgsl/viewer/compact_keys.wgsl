// Numbers and keys of the splats that were marked, ascending by number, from the prefix sums of the marks.
//use place
struct Params { count: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> places: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> seen_keys: array<u32>;
@group(0) @binding(4) var<storage, read_write> rows: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  if (n >= params.count || places[n + 1u] == places[n]) { return; }
  rows[places[n]] = n;
  seen_keys[places[n]] = keys[n];
}
