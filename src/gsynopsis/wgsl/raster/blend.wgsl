// A tile's splats front to back: colour and remaining transmittance of each pixel.
//use splat
struct Params { width: u32, height: u32, tiles_x: u32, red: f32, green: f32, blue: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read> slots: array<u32>;
@group(0) @binding(4) var<storage, read> starts: array<u32>;
@group(0) @binding(5) var<storage, read_write> image: array<vec4<f32>>;
var<workgroup> batch: array<Splat, 256>;
var<workgroup> open: atomic<u32>;
var<workgroup> goes_on: u32;

@compute @workgroup_size(16, 16)
fn main(
  @builtin(global_invocation_id) at: vec3<u32>,
  @builtin(local_invocation_index) lane: u32,
  @builtin(workgroup_id) group: vec3<u32>,
) {
  let tile = group.y * params.tiles_x + group.x;
  let first = starts[tile];
  let end = starts[tile + 1u];
  let inside = at.x < params.width && at.y < params.height;
  let x = f32(at.x) + 0.5;
  let y = f32(at.y) + 0.5;
  var left = 1.0;
  var color = vec3<f32>(0.0);
  var done = !inside;
  for (var base = first; base < end; base += 256u) {
    if (base + lane < end) { batch[lane] = splats[pair_splats[slots[base + lane]]]; }
    if (lane == 0u) { atomicStore(&open, 0u); }
    workgroupBarrier();
    let count = min(256u, end - base);
    for (var j = 0u; j < count && !done; j++) {
      let dx = x - batch[j].x;
      let dy = y - batch[j].y;
      let log_alpha = batch[j].log_opacity
        + (batch[j].xx * dx + batch[j].xy * dy) * dx + batch[j].yy * dy * dy;
      if (log_alpha < LOG_ALPHA_MIN) { continue; }
      var alpha = ALPHA_MAX;
      if (log_alpha < LOG_ALPHA_MAX) { alpha = exp2(log_alpha); }
      let weight = left * alpha;
      let after = left - weight;
      if (after < TRANSMITTANCE_MIN) {
        done = true;
        break;
      }
      color += weight * vec3<f32>(batch[j].red, batch[j].green, batch[j].blue);
      left = after;
    }
    if (!done) { atomicStore(&open, 1u); }
    workgroupBarrier();
    if (lane == 0u) { goes_on = atomicLoad(&open); }
    if (workgroupUniformLoad(&goes_on) == 0u) { break; }
  }
  if (inside) {
    color += left * vec3<f32>(params.red, params.green, params.blue);
    image[at.y * params.width + at.x] = vec4<f32>(color, left);
  }
}
