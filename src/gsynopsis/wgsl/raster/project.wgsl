// Gaussians to splats, the number of tiles that each touches, and their depths as sorting keys.
//use place projection splat
struct Params { view: View, count: u32, tiles_x: u32, tiles_y: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> gaussians: array<f32>;
@group(0) @binding(2) var<storage, read_write> splats: array<Splat>;
@group(0) @binding(3) var<storage, read_write> touched: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> order: array<u32>;

const NEAR_PLANE = 0.01;
const LN_2 = 0.6931471805599453;
const LOG2_E = 1.4426950408889634;
const SLACK = 0.01;  // px, for rounding: a tile too many costs a little time, one too few is wrong

// The first of `count` tiles with a pixel centre in [low, high], and one past the last above bit 16.
fn tiles_between(low: f32, high: f32, count: u32) -> u32 {
  let size = f32(TILE);
  let first = clamp(ceil((low - SLACK - (size - 0.5)) / size), 0.0, f32(count));
  let end = clamp(floor((high + SLACK - 0.5) / size) + 1.0, 0.0, f32(count));
  return u32(first) | (u32(max(first, end)) << 16u);
}

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let g = place_of(at, groups);
  if (g >= params.count) { return; }
  order[g] = g;
  touched[g] = 0u;
  keys[g] = 0xffffffffu;
  let o = g * GAUSSIAN;
  let mean = vec3<f32>(gaussians[o], gaussians[o + 1u], gaussians[o + 2u]);
  let quat = vec4<f32>(gaussians[o + 3u], gaussians[o + 4u], gaussians[o + 5u], gaussians[o + 6u]);
  let scale = vec3<f32>(gaussians[o + 7u], gaussians[o + 8u], gaussians[o + 9u]);
  var opacity = gaussians[o + 10u];
  let color = vec3<f32>(gaussians[o + 11u], gaussians[o + 12u], gaussians[o + 13u]);
  for (var k = 0u; k < GAUSSIAN; k++) {
    if (!finite(gaussians[o + k])) { return; }
  }
  let view = params.view;
  let p = project_one(mean, quat, scale, view);
  if (!(p.z >= NEAR_PLANE) || dot(quat, quat) <= 0.0 || !finite(p.inverse_norm)) { return; }
  if (view.own != view.dilation) { opacity *= sqrt(p.own / p.determinant); }
  if (!(opacity >= 1.0 / 255.0)) { return; }
  let log_opacity = log2(opacity);
  // alpha >= 1/255 where half the Mahalanobis distance squared is at most ln opacity + ln 255.
  let reach = max(0.0, 2.0 * LN_2 * (log_opacity - LOG_ALPHA_MIN));
  let half_width = sqrt(reach * p.xx);
  let half_height = sqrt(reach * p.yy);
  let x = view.fx * p.u + view.cx;
  let y = view.fy * p.v + view.cy;
  let inverse = LOG2_E / p.determinant;
  if (!finite(inverse) || !finite(p.determinant) || !finite(half_width + half_height)) { return; }
  if (!finite(x + y)) { return; }
  if (x + half_width < 0.5 || y + half_height < 0.5) { return; }
  if (x - half_width > view.width - 0.5 || y - half_height > view.height - 0.5) { return; }
  let columns = tiles_between(x - half_width, x + half_width, params.tiles_x);
  let rows = tiles_between(y - half_height, y + half_height, params.tiles_y);
  let across = (columns >> 16u) - (columns & 0xffffu);
  let down = (rows >> 16u) - (rows & 0xffffu);
  touched[g] = across * down;
  if (across * down == 0u) { return; }
  keys[g] = bitcast<u32>(p.z);
  splats[g] = Splat(
    x, y, -0.5 * p.yy * inverse, p.xy * inverse, -0.5 * p.xx * inverse, log_opacity,
    color.x, color.y, color.z, columns, rows, 0u);
}
