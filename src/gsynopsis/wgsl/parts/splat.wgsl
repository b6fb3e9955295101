// A projected Gaussian. The binary logarithm of alpha at (dx, dy) from the centre is
// log_opacity + xx dx² + xy dx dy + yy dy².
struct Splat {
  x: f32, y: f32,
  xx: f32, xy: f32, yy: f32,
  log_opacity: f32,
  red: f32, green: f32, blue: f32,
  columns: u32, rows: u32,  // of tiles: the first below, one past the last above bit 16
  spare: u32,
}
const TILE = 16u;
const ALPHA_MAX = 0.99;
const LOG_ALPHA_MAX = -0.01449956969511509;  // log2 0.99
const LOG_ALPHA_MIN = -7.994353436858858;    // log2 (1/255)
const TRANSMITTANCE_MIN = 1e-4;
const PARTIAL_SUMS = 9u;
