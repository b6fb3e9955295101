// A camera: world to camera row by row, pixels, and px² on the diagonal of covariances: a Gaussian's
// own, and all of it (render/base.py, low_pass_filter).
struct View {
  r00: f32, r01: f32, r02: f32,
  r10: f32, r11: f32, r12: f32,
  r20: f32, r21: f32, r22: f32,
  tx: f32, ty: f32, tz: f32,
  fx: f32, fy: f32, cx: f32, cy: f32,
  width: f32, height: f32, own: f32, dilation: f32,
}
