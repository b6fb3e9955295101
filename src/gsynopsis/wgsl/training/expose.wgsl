// A rendering as it is compared: in the photo's exposure, with the photo's values where that is
// saturated and the rendering brighter, and where the mask is zero; twin of view_step.compare.
//use place window exposure
struct Params { count: u32, masked: u32, exposed: u32, red: f32, green: f32, blue: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
@group(0) @binding(3) var<storage, read> mask: array<f32>;
@group(0) @binding(4) var<storage, read_write> shown: array<vec4<f32>>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  if (n >= params.count) { return; }
  let seen = photo_pixel(photo[n]);
  var color = image[n].xyz * vec3<f32>(params.red, params.green, params.blue);
  if (params.exposed != 0u) {
    color = select(color, seen, (seen >= vec3<f32>(SATURATED)) & (color > seen));
  }
  if (params.masked != 0u) { color = seen + mask[n] * (color - seen); }
  shown[n] = vec4<f32>(color, image[n].w);
}
