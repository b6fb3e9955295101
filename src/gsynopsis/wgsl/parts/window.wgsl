// The window of SSIM: 11 taps, σ = 1.5, sum 1; pixels beyond the image are zeros.
const RADIUS = 5;
const WINDOW = array<f32, 11>(
  0.00102838008, 0.00759875814, 0.0360007721, 0.10936069, 0.213005538, 0.266011725,
  0.213005538, 0.10936069, 0.0360007721, 0.00759875814, 0.00102838008);
const C1 = 0.0001;
const C2 = 0.0009;
// A photo over its view's background: the last byte is the grey that shows through.
fn photo_pixel(packed: u32) -> vec3<f32> {
  let behind = packed >> 24u;
  return vec3<f32>(
    f32((packed & 255u) + behind),
    f32(((packed >> 8u) & 255u) + behind),
    f32(((packed >> 16u) & 255u) + behind)) / 255.0;
}
