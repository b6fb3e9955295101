// One image's sums, added up in order: |a − b|, SSIM, (a − b)²; then opacity, volume, opacities
// that are not a number; eight words of the log, the last two spare.
struct Params { pixel_groups: u32, slot_groups: u32, row: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pixels: array<f32>;
@group(0) @binding(2) var<storage, read> slots: array<f32>;
@group(0) @binding(3) var<storage, read_write> log: array<f32>;
var<workgroup> shares: array<f32, 1536>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
  var sum = array<f32, 6>();
  for (var i = lane; i < params.pixel_groups; i += 256u) {
    for (var k = 0u; k < 3u; k++) { sum[k] += pixels[3u * i + k]; }
  }
  for (var i = lane; i < params.slot_groups; i += 256u) {
    for (var k = 0u; k < 3u; k++) { sum[3u + k] += slots[3u * i + k]; }
  }
  for (var k = 0u; k < 6u; k++) { shares[256u * k + lane] = sum[k]; }
  workgroupBarrier();
  for (var step = 128u; step > 0u; step /= 2u) {
    if (lane < step) {
      for (var k = 0u; k < 6u; k++) { shares[256u * k + lane] += shares[256u * k + lane + step]; }
    }
    workgroupBarrier();
  }
  if (lane < 6u) { log[8u * params.row + lane] = shares[256u * lane]; }
}
