// The same walk again: for each pair a row of sums over the tile's pixels, in a fixed order.
//
// With s the gradient of ln alpha: Σ s, Σ s dx, Σ s dy, Σ s dx², Σ s dx dy, Σ s dy², then the
// gradient of the three colours. Eight splats at a time leave weight and s of each pixel in shared
// memory; 32 lanes add up 8 pixels each for one splat, then 72 lanes one sum of 32 each. No
// subgroups, no float atomics: a row is written by one invocation, the same bits each time.
//use splat
struct Params { width: u32, height: u32, tiles_x: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read> slots: array<u32>;
@group(0) @binding(4) var<storage, read> starts: array<u32>;
@group(0) @binding(5) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> pulls: array<f32>;  // of the loss on the image, [H, W, 3]
@group(0) @binding(7) var<storage, read_write> partials: array<f32>;
const AT_ONCE = 8u;
var<workgroup> batch: array<Splat, 8>;
var<workgroup> rows: array<u32, 8>;
var<workgroup> shares: array<vec2<f32>, 2048>;  // weight and s by splat and pixel
var<workgroup> red: array<f32, 256>;
var<workgroup> green: array<f32, 256>;
var<workgroup> blue: array<f32, 256>;
var<workgroup> sums: array<f32, 2304>;
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
  let corner = vec2<f32>(f32(group.x * TILE), f32(group.y * TILE)) + 0.5;
  let x = f32(at.x) + 0.5;
  let y = f32(at.y) + 0.5;
  var pull = vec3<f32>(0.0);
  var owed = 0.0;  // the pull times all that is blended base here on, the background included
  if (inside) {
    let pixel = at.y * params.width + at.x;
    pull = vec3<f32>(pulls[3u * pixel], pulls[3u * pixel + 1u], pulls[3u * pixel + 2u]);
    owed = dot(pull, image[pixel].xyz);
  }
  red[lane] = pull.x;
  green[lane] = pull.y;
  blue[lane] = pull.z;
  var left = 1.0;
  var done = !inside;
  for (var base = first; base < end; base += AT_ONCE) {
    let count = min(AT_ONCE, end - base);
    if (lane < count) {
      let slot = slots[base + lane];
      rows[lane] = slot * PARTIAL_SUMS;
      batch[lane] = splats[pair_splats[slot]];
    }
    if (lane == 0u) { atomicStore(&open, 0u); }
    workgroupBarrier();
    for (var j = 0u; j < count; j++) {
      var share = vec2<f32>(0.0);
      if (!done) {
        let dx = x - batch[j].x;
        let dy = y - batch[j].y;
        let log_alpha = batch[j].log_opacity
          + (batch[j].xx * dx + batch[j].xy * dy) * dx + batch[j].yy * dy * dy;
        if (log_alpha >= LOG_ALPHA_MIN) {
          let capped = log_alpha >= LOG_ALPHA_MAX;
          var alpha = ALPHA_MAX;
          if (!capped) { alpha = exp2(log_alpha); }
          let weight = left * alpha;
          let after = left - weight;
          if (after < TRANSMITTANCE_MIN) {
            done = true;
          } else {
            left = after;
            let paid = weight * dot(pull, vec3<f32>(batch[j].red, batch[j].green, batch[j].blue));
            owed -= paid;
            share.x = weight;
            if (!capped) { share.y = paid - owed * alpha / (1.0 - alpha); }
          }
        }
      }
      shares[j * 256u + lane] = share;
    }
    if (!done) { atomicStore(&open, 1u); }
    workgroupBarrier();
    if (lane == 0u) { goes_on = atomicLoad(&open); }
    let j = lane / 32u;
    if (j < count) {
      var sum = array<f32, 9>();  // said, as naga clears it only once otherwise
      for (var i = 0u; i < 8u; i++) {
        let pixel = (lane & 31u) + 32u * i;
        let share = shares[j * 256u + pixel];
        let dx = corner.x + f32(pixel & 15u) - batch[j].x;
        let dy = corner.y + f32(pixel >> 4u) - batch[j].y;
        let by_x = share.y * dx;
        let by_y = share.y * dy;
        sum[0] += share.y;
        sum[1] += by_x;
        sum[2] += by_y;
        sum[3] += by_x * dx;
        sum[4] += by_x * dy;
        sum[5] += by_y * dy;
        sum[6] += share.x * red[pixel];
        sum[7] += share.x * green[pixel];
        sum[8] += share.x * blue[pixel];
      }
      for (var k = 0u; k < 9u; k++) { sums[lane * 9u + k] = sum[k]; }
    }
    workgroupBarrier();
    if (lane < count * 9u) {
      let which = lane / 9u;
      let k = lane % 9u;
      var sum = 0.0;
      for (var i = 0u; i < 32u; i++) { sum += sums[(which * 32u + i) * 9u + k]; }
      partials[rows[which] + k] = sum;
    }
    if (workgroupUniformLoad(&goes_on) == 0u) { break; }
  }
}
