// Numbers of tiles in the order of depth, and a zero behind them for their sum.
//use place
struct Params { count: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> touched: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = place_of(at, groups);
  if (i > params.count) { return; }
  if (i == params.count) {
    counts[i] = 0u;
  } else {
    counts[i] = touched[order[i]];
  }
}
