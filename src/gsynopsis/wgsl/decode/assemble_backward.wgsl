// Gradients of Gaussians to those of the heads' outputs, of sizes and of offsets; the level scale's
// shares stand behind the outputs of each anchor. Volume and opacity of the loss come in here.
//use place slots
struct Params { count: u32, slots: u32, volume: f32, opacity: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> raw: array<f32>;
@group(0) @binding(4) var<storage, read> grads: array<f32>;
@group(0) @binding(5) var<storage, read> log_scales: array<f32>;
@group(0) @binding(6) var<storage, read> offsets: array<f32>;
@group(0) @binding(7) var<storage, read> log_gain: array<f32>;
@group(0) @binding(8) var<storage, read_write> pulls: array<f32>;
@group(0) @binding(9) var<storage, read_write> size_grads: array<f32>;
@group(0) @binding(10) var<storage, read_write> offset_grads: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let v = place_of(at, groups);
  if (v >= params.count) { return; }
  let n = rows[v];
  let slots = params.slots;
  let stride = 11u * slots + 3u;
  let to = v * stride;
  for (var i = 0u; i < stride; i++) { pulls[to + i] = 0.0; }
  var logs = array<f32, 6>();
  var base = array<f32, 6>();
  var gain = array<f32, 3>();
  var gain_pull = array<f32, 3>();
  for (var a = 0u; a < 6u; a++) { base[a] = exp(log_scales[6u * n + a]); }
  for (var a = 0u; a < 3u; a++) { gain[a] = exp(log_gain[a]); }
  for (var k = 0u; k < slots; k++) {
    let i = v * slots + k;
    if (starts[i + 1u] == starts[i]) { continue; }
    let g = starts[i] * 16u;
    let offset = (n * slots + k) * 3u;
    let cov = covariance_at(v, k, slots);
    let color = color_at(v, k, slots);
    var half = array<f32, 3>();
    var size = array<f32, 3>();
    for (var a = 0u; a < 3u; a++) {
      half[a] = sigmoid(raw[cov + a]);
      size[a] = base[3u + a] * half[a] * gain[a];
    }
    for (var a = 0u; a < 3u; a++) {
      let along = grads[g + a] * base[a];
      offset_grads[offset + a] += along;
      logs[a] += along * offsets[offset + a];
      let others = size[(a + 1u) % 3u] * size[(a + 2u) % 3u];
      let pull = (grads[g + 7u + a] + params.volume * others) * size[a];
      logs[3u + a] += pull;
      gain_pull[a] += pull;
      pulls[to + slots + 7u * k + a] = pull * (1.0 - half[a]);
      let c = sigmoid(raw[color + a]);
      pulls[to + 8u * slots + 3u * k + a] = grads[g + 11u + a] * c * (1.0 - c);
    }
    let q = vec4<f32>(raw[cov + 3u], raw[cov + 4u], raw[cov + 5u], raw[cov + 6u]);
    let gq = vec4<f32>(grads[g + 3u], grads[g + 4u], grads[g + 5u], grads[g + 6u]);
    let norm = max(length(q), 1e-12);
    // Where the norm is limited it is a constant.
    let inner = select(0.0, dot(q, gq) / (norm * norm), norm > 1e-12);
    let turned = (gq - q * inner) / norm;
    pulls[to + slots + 7u * k + 3u] = turned.x;
    pulls[to + slots + 7u * k + 4u] = turned.y;
    pulls[to + slots + 7u * k + 5u] = turned.z;
    pulls[to + slots + 7u * k + 6u] = turned.w;
    let t = activated(raw[opacity_at(v, k, slots)]);
    pulls[to + k] = (grads[g + 10u] + params.opacity) * (1.0 - t * t);
  }
  for (var a = 0u; a < 6u; a++) { size_grads[6u * n + a] += logs[a]; }
  for (var a = 0u; a < 3u; a++) { pulls[to + 11u * slots + a] = gain_pull[a]; }
}
