// Slots that are drawn, 1 or 0, and a zero behind them: live, with a positive opacity.
//use place slots
struct Params { count: u32, slots: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> live: array<u32>;
@group(0) @binding(3) var<storage, read> raw: array<f32>;
@group(0) @binding(4) var<storage, read_write> drawn: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = place_of(at, groups);
  let v = i / params.slots;
  let k = i % params.slots;
  if (i > params.count * params.slots) { return; }
  var mark = 0u;
  if (v < params.count && ((live[rows[v]] >> k) & 1u) != 0u) {
    if (activated(raw[opacity_at(v, k, params.slots)]) > 0.0) { mark = 1u; }
  }
  drawn[i] = mark;
}
