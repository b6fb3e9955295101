// Of each workgroup, over pixels whose photo is not saturated, weighted by the mask: sums of the
// photo and of the rendering, [groups, 3] each; twin of Exposures.solve.
//use place window exposure group_sum
struct Params { count: u32, masked: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
@group(0) @binding(3) var<storage, read> mask: array<f32>;
@group(0) @binding(4) var<storage, read_write> photo_totals: array<f32>;
@group(0) @binding(5) var<storage, read_write> image_totals: array<f32>;

@compute @workgroup_size(256)
fn main(
  @builtin(global_invocation_id) at: vec3<u32>,
  @builtin(local_invocation_index) lane: u32,
  @builtin(workgroup_id) group: vec3<u32>,
  @builtin(num_workgroups) groups: vec3<u32>,
) {
  let n = place_of(at, groups);
  let block = group_of(group, groups);
  var own_photo = vec3<f32>(0.0);
  var own_image = vec3<f32>(0.0);
  if (n < params.count) {
    let seen = photo_pixel(photo[n]);
    var weight = 0.0;
    if (max(seen.x, max(seen.y, seen.z)) < SATURATED) { weight = 1.0; }
    if (params.masked != 0u) { weight *= mask[n]; }
    own_photo = weight * seen;
    own_image = weight * image[n].xyz;
  }
  let photo_sum = group_sum(lane, own_photo);
  let image_sum = group_sum(lane, own_image);
  if (lane == 0u && 256u * block < params.count) {
    photo_totals[3u * block] = photo_sum.x;
    photo_totals[3u * block + 1u] = photo_sum.y;
    photo_totals[3u * block + 2u] = photo_sum.z;
    image_totals[3u * block] = image_sum.x;
    image_totals[3u * block + 1u] = image_sum.y;
    image_totals[3u * block + 2u] = image_sum.z;
  }
}
