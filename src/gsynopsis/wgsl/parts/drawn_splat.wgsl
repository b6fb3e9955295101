// A splat in the picture, as the viewer draws it.
struct DrawnSplat {
  middle: vec2<f32>,  // px
  axis: vec2<f32>,    // px: the longer one of its ellipse at one deviation
  ratio: f32,         // of the shorter axis to it
  opacity: f32,
  red_green: u32, blue: u32,  // halves
}
