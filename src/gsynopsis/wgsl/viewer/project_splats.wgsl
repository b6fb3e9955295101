// Splats to what is drawn of them, 1 or 0 for those that are in the picture with a zero behind them, and sorting keys.
//
// As the vertex shader of viewer/src/render/shaders.ts; keys rise from far to near.
//use place screen look drawn_splat
struct Params { view: View, count: u32, limit: u32, changing: u32, time: f32, fade: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> centers: array<f32>;
@group(0) @binding(2) var<storage, read> words: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> before: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> times: array<f32>;
@group(0) @binding(5) var<storage, read_write> drawn: array<DrawnSplat>;
@group(0) @binding(6) var<storage, read_write> seen: array<u32>;
@group(0) @binding(7) var<storage, read_write> keys: array<u32>;

const NEAR_PLANE = 0.01;
const NEAR_BITS = 0x3c23d70au;  // of the near plane as a float
const KEY_MOST = 0xffffffu;     // three digits of eight bits: 32 octaves of depth, in 2^19 steps each
const ALPHA_MIN = 1.0 / 255.0;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  if (n > params.count) { return; }
  seen[n] = 0u;
  if (n == params.count) { return; }
  let look = look_of(n);
  let blue_opacity = unpack2x16float(look.two.w);
  var opacity = blue_opacity.y;
  if (opacity < ALPHA_MIN) { return; }
  let view = params.view;
  let p = on_screen(vec3<f32>(centers[3u * n], centers[3u * n + 1u], centers[3u * n + 2u]), view);
  if (!(p.z >= NEAR_PLANE)) { return; }
  let one = bitcast<vec4<f32>>(look.one);
  let two = bitcast<vec2<f32>>(look.two.xy);
  let covariance = mat3x3<f32>(one.x, one.y, one.z, one.y, one.w, two.x, one.z, two.x, two.y);
  let cx = covariance * p.to_screen[0];
  let cy = covariance * p.to_screen[1];
  var a = dot(p.to_screen[0], cx);
  let b = dot(p.to_screen[0], cy);
  var c = dot(p.to_screen[1], cy);
  let own = vec2<f32>(a, c) + view.own;
  a += view.dilation;
  c += view.dilation;
  if (view.own < view.dilation) { opacity *= sqrt(clamp((own.x * own.y - b * b) / (a * c - b * b), 0.0, 1.0)); }
  if (opacity < ALPHA_MIN) { return; }
  let middle = vec2<f32>(view.fx * p.u + view.cx, view.fy * p.v + view.cy);
  // alpha >= 1/255 where half the Mahalanobis distance squared is at most ln (255 opacity).
  let reach = sqrt(2.0 * log(255.0 * opacity) * vec2<f32>(a, c)) + 1.0;
  if (any(middle + reach < vec2<f32>(0.0)) || any(middle - reach > vec2<f32>(view.width, view.height))) { return; }
  let mean = 0.5 * (a + c);
  let spread = length(vec2<f32>(0.5 * (a - c), b));
  let large = mean + spread;
  let small = max(mean - spread, 1e-9);
  // The longer of two ways to write the first axis, so that neither cancels out.
  var axis = vec2<f32>(b, 0.5 * (c - a) + spread);
  if (a >= c) { axis = vec2<f32>(0.5 * (a - c) + spread, b); }
  let size = length(axis);
  if (size > 0.0) { axis *= sqrt(large) / size; } else { axis = vec2<f32>(sqrt(large), 0.0); }
  drawn[n] = DrawnSplat(middle, axis, sqrt(small / large), opacity, look.two.z, look.two.w & 0xffffu);
  seen[n] = 1u;
  keys[n] = KEY_MOST - min((bitcast<u32>(p.z) - NEAR_BITS) >> 4u, KEY_MOST);
}
