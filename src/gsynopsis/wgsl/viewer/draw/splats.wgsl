// Splats far to near, each an equilateral triangle around the circle of radius 1, where its ellipse ends.
//use drawn_splat
@group(0) @binding(0) var<uniform> size: vec2<f32>;
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> drawn: array<DrawnSplat>;

struct Corner {
  @builtin(position) position: vec4<f32>,
  @location(0) place: vec2<f32>,
  @location(1) @interpolate(flat) color: vec4<f32>,
}

@vertex
fn corner(@builtin(vertex_index) vertex: u32) -> Corner {
  let splat = drawn[order[vertex / 3u]];
  let side = vertex % 3u;
  let corner = select(vec2<f32>(select(1.7320509, -1.7320509, side == 1u), -1.0), vec2<f32>(0.0, 2.0), side == 0u);
  let place = corner * sqrt(2.0 * log(255.0 * splat.opacity));
  let pixel = splat.middle + place.x * splat.axis + place.y * splat.ratio * vec2<f32>(-splat.axis.y, splat.axis.x);
  let position = vec4<f32>(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
  return Corner(position, place, vec4<f32>(unpack2x16float(splat.red_green), unpack2x16float(splat.blue).x, splat.opacity));
}

@fragment
fn coverage(at: Corner) -> @location(0) vec4<f32> {
  let alpha = min(0.99, at.color.a * exp(-0.5 * dot(at.place, at.place)));
  if (alpha < 1.0 / 255.0) { discard; }
  return vec4<f32>(at.color.rgb * alpha, alpha);
}
