// The gradient on the rendering, from that on what was compared.
//use place window exposure
struct Params { count: u32, masked: u32, exposed: u32, red: f32, green: f32, blue: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
@group(0) @binding(3) var<storage, read> mask: array<f32>;
@group(0) @binding(4) var<storage, read_write> pulls: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  if (n >= params.count) { return; }
  let seen = photo_pixel(photo[n]);
  let gain = vec3<f32>(params.red, params.green, params.blue);
  var pull = gain * vec3<f32>(pulls[3u * n], pulls[3u * n + 1u], pulls[3u * n + 2u]);
  if (params.exposed != 0u) {
    let cut = (seen >= vec3<f32>(SATURATED)) & (image[n].xyz * gain > seen);
    pull = select(pull, vec3<f32>(0.0), cut);
  }
  if (params.masked != 0u) { pull *= mask[n]; }
  pulls[3u * n] = pull.x;
  pulls[3u * n + 1u] = pull.y;
  pulls[3u * n + 2u] = pull.z;
}
