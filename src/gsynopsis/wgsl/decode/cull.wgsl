// Anchors that could touch the image, 1 or 0, and a zero behind them; twin of model/culling.py.
//use place view
struct Params { view: View, count: u32, slots: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> positions: array<f32>;
@group(0) @binding(2) var<storage, read> log_scales: array<f32>;
@group(0) @binding(3) var<storage, read> offsets: array<f32>;
@group(0) @binding(4) var<storage, read> live: array<u32>;  // a bit for each slot
@group(0) @binding(5) var<storage, read> log_gain: array<f32>;
@group(0) @binding(6) var<storage, read_write> seen: array<u32>;
const NEAR_PLANE = 0.01;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  if (n > params.count) { return; }
  if (n == params.count) {
    seen[n] = 0u;
    return;
  }
  seen[n] = 0u;
  if (live[n] == 0u) { return; }
  var reach = 0.0;
  for (var k = 0u; k < params.slots; k++) {
    let o = (n * params.slots + k) * 3u;
    let far = max(abs(offsets[o]), max(abs(offsets[o + 1u]), abs(offsets[o + 2u])));
    if (((live[n] >> k) & 1u) != 0u) { reach = max(reach, far); }
  }
  let l = n * 6u;
  let offset_size = exp(max(log_scales[l], max(log_scales[l + 1u], log_scales[l + 2u])));
  let splat_size = exp(max(log_scales[l + 3u], max(log_scales[l + 4u], log_scales[l + 5u])));
  let gain = exp(max(log_gain[0], max(log_gain[1], log_gain[2])));
  let margin = 3.0 * gain * splat_size + reach * offset_size;
  let v = params.view;
  let p = vec3<f32>(positions[3u * n], positions[3u * n + 1u], positions[3u * n + 2u]);
  let x = dot(vec3<f32>(v.r00, v.r01, v.r02), p) + v.tx;
  let y = dot(vec3<f32>(v.r10, v.r11, v.r12), p) + v.ty;
  let z = dot(vec3<f32>(v.r20, v.r21, v.r22), p) + v.tz;
  let inverse = 1.0 / max(z, 5.0 * NEAR_PLANE);
  let across = v.fx * x * inverse;
  let wide = v.fx * margin * inverse;
  let down = v.fy * y * inverse;
  let high = v.fy * margin * inverse;
  let inside = z + margin > NEAR_PLANE && across + wide > -v.cx && across - wide < v.width - v.cx
    && down + high > -v.cy && down - high < v.height - v.cy;
  seen[n] = select(0u, 1u, inside);
}
