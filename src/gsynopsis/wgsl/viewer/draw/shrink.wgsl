// A larger picture to one of its size divided by `times`: means of squares of pixels.
@group(0) @binding(0) var<uniform> times: u32;
@group(0) @binding(1) var large: texture_2d<f32>;

@vertex
fn cover(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(vec2<f32>(f32(vertex & 1u), f32(vertex >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn mean(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
  let first = vec2<u32>(at.xy) * times;
  var sum = vec4<f32>();
  for (var y = 0u; y < times; y++) {
    for (var x = 0u; x < times; x++) { sum += textureLoad(large, first + vec2<u32>(x, y), 0); }
  }
  return sum / f32(times * times);
}
