// Counts one view for growing and pruning; twin of GrowthStatistics.count.
//use place slots
struct Params { count: u32, slots: u32, half_width: f32, half_height: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> raw: array<f32>;
@group(0) @binding(4) var<storage, read> grads: array<f32>;
@group(0) @binding(5) var<storage, read> touched: array<u32>;
@group(0) @binding(6) var<storage, read_write> gradient: array<f32>;
@group(0) @binding(7) var<storage, read_write> drawn: array<f32>;
@group(0) @binding(8) var<storage, read_write> opacity: array<f32>;
@group(0) @binding(9) var<storage, read_write> visits: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let v = place_of(at, groups);
  if (v >= params.count) { return; }
  let n = rows[v];
  var sum = 0.0;
  for (var k = 0u; k < params.slots; k++) {
    sum += max(0.0, activated(raw[opacity_at(v, k, params.slots)]));
    let i = v * params.slots + k;
    let g = starts[i];
    if (starts[i + 1u] == g || touched[g] == 0u) { continue; }
    let screen = vec2<f32>(grads[16u * g + 14u], grads[16u * g + 15u]);
    let slot = n * params.slots + k;
    gradient[slot] += length(screen * vec2<f32>(params.half_width, params.half_height));
    drawn[slot] += 1.0;
  }
  opacity[n] += sum;
  visits[n] += 1.0;
}
