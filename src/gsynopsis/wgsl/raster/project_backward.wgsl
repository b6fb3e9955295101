// Each Gaussian's rows of sums added in their order, then the chain rule; twin of
// _native/project_backward.cpp.
//use place projection splat
struct Params { view: View, count: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> gaussians: array<f32>;
@group(0) @binding(2) var<storage, read> touched: array<u32>;
@group(0) @binding(3) var<storage, read> first_slots: array<u32>;
@group(0) @binding(4) var<storage, read> partials: array<f32>;
@group(0) @binding(5) var<storage, read_write> grads: array<f32>;
const GRADIENT = 16u;  // floats: those of a Gaussian, then of its projected centre 2

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let g = place_of(at, groups);
  if (g >= params.count) { return; }
  let to = g * GRADIENT;
  for (var k = 0u; k < GRADIENT; k++) { grads[to + k] = 0.0; }
  let count = touched[g];
  if (count == 0u) { return; }
  var s = array<f32, 9>();
  for (var i = 0u; i < count; i++) {
    let row = (first_slots[g] + i) * PARTIAL_SUMS;
    for (var k = 0u; k < PARTIAL_SUMS; k++) { s[k] += partials[row + k]; }
  }
  let view = params.view;
  let o = g * GAUSSIAN;
  let p = project_one(
    vec3<f32>(gaussians[o], gaussians[o + 1u], gaussians[o + 2u]),
    vec4<f32>(gaussians[o + 3u], gaussians[o + 4u], gaussians[o + 5u], gaussians[o + 6u]),
    vec3<f32>(gaussians[o + 7u], gaussians[o + 8u], gaussians[o + 9u]),
    view);
  let inverse = 1.0 / p.determinant;
  let screen_x = (p.yy * s[1] - p.xy * s[2]) * inverse;
  let screen_y = (p.xx * s[2] - p.xy * s[1]) * inverse;

  // ln alpha = … − ½ (A dx² + 2 B dx dy + C dy²), so the inverse covariance has the symmetric
  // gradient −½ [[Σ s dx², Σ s dx dy], [Σ s dx dy, Σ s dy²]], called G; the covariance has −I G I.
  let A = p.yy * inverse;
  let B = -p.xy * inverse;
  let C = p.xx * inverse;
  let gxx = -0.5 * s[3];
  let gxy = -0.5 * s[4];
  let gyy = -0.5 * s[5];
  let e0 = A * gxx + B * gxy;
  let e1 = A * gxy + B * gyy;
  let e2 = B * gxx + C * gxy;
  let e3 = B * gxy + C * gyy;
  var cxx = -(e0 * A + e1 * B);
  var cxy = -(e0 * B + e1 * C);
  var cyy = -(e2 * B + e3 * C);
  if (view.own != view.dilation) {
    // ln alpha has ½ ln (own / determinant) too; ln of a determinant has the inverse matrix.
    let half = 0.5 * s[0];
    let own = 1.0 / p.own;
    let more = view.dilation - view.own;
    cxx += half * ((p.yy - more) * own - A);
    cxy += half * (-p.xy * own - B);
    cyy += half * ((p.xx - more) * own - C);
  }
  let da = 2.0 * (cxx * p.spread[0] + cxy * p.spread[1]);
  let db = 2.0 * (cxy * p.spread[0] + cyy * p.spread[1]);

  let s0 = p.to_screen[0].x * da + p.to_screen[1].x * db;
  let s1 = p.to_screen[0].y * da + p.to_screen[1].y * db;
  let s2 = p.to_screen[0].z * da + p.to_screen[1].z * db;
  let scale = s0 * p.rotation[0] + s1 * p.rotation[1] + s2 * p.rotation[2];
  let d0 = s0 * p.scale;
  let d1 = s1 * p.scale;
  let d2 = s2 * p.scale;
  let w = p.quat.x;
  let x = p.quat.y;
  let y = p.quat.z;
  let z = p.quat.w;
  let turn = vec4<f32>(
    2.0 * (x * (d2.y - d1.z) + y * (d0.z - d2.x) + z * (d1.x - d0.y)),
    2.0 * (w * (d2.y - d1.z) + y * (d0.y + d1.x) + z * (d0.z + d2.x) - 2.0 * x * (d1.y + d2.z)),
    2.0 * (w * (d0.z - d2.x) + x * (d0.y + d1.x) + z * (d1.z + d2.y) - 2.0 * y * (d0.x + d2.z)),
    2.0 * (w * (d1.x - d0.y) + x * (d0.z + d2.x) + y * (d1.z + d2.y) - 2.0 * z * (d0.x + d1.y)));
  let quat = (turn - dot(turn, p.quat) * p.quat) * p.inverse_norm;

  let t0 = vec3<f32>(dot(da, p.shaped[0]), dot(da, p.shaped[1]), dot(da, p.shaped[2]));
  let t1 = vec3<f32>(dot(db, p.shaped[0]), dot(db, p.shaped[1]), dot(db, p.shaped[2]));
  let r0 = vec3<f32>(view.r00, view.r01, view.r02);
  let r1 = vec3<f32>(view.r10, view.r11, view.r12);
  let r2 = vec3<f32>(view.r20, view.r21, view.r22);
  let jxx = dot(t0, r0);  // of the Jacobian's four entries
  let jxz = dot(t0, r2);
  let jyy = dot(t1, r1);
  let jyz = dot(t1, r2);
  let by_x = view.fx * p.inverse_z;
  let by_y = view.fy * p.inverse_z;
  var du = view.fx * screen_x;
  var dv = view.fy * screen_y;
  if (p.u == p.u_clamped) { du -= by_x * jxz; }
  if (p.v == p.v_clamped) { dv -= by_y * jyz; }
  let dx = du * p.inverse_z;
  let dy = dv * p.inverse_z;
  let dz = -(by_x * (jxx - p.u_clamped * jxz) + by_y * (jyy - p.v_clamped * jyz)) * p.inverse_z
    - dx * p.u - dy * p.v;
  let mean = r0 * dx + r1 * dy + r2 * dz;

  var out = array<f32, 16>(
    mean.x, mean.y, mean.z, quat.x, quat.y, quat.z, quat.w, scale.x, scale.y, scale.z,
    s[0] / gaussians[o + 10u], s[6], s[7], s[8], screen_x, screen_y);
  // Zero where some gradient of the same Gaussian overflowed: one freak must not spoil a model.
  var good = true;
  for (var k = 0u; k < GRADIENT; k++) { good = good && finite(out[k]); }
  if (!good) { return; }
  for (var k = 0u; k < GRADIENT; k++) { grads[to + k] = out[k]; }
}
