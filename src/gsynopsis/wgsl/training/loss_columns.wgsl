// Sums along columns, SSIM and its slopes [H, W, 9]; and of each workgroup the sums of |a − b|,
// SSIM and (a − b)² over its pixels and channels, [groups, 3].
//use place window group_sum
struct Params { width: u32, height: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
@group(0) @binding(3) var<storage, read> sums: array<f32>;
@group(0) @binding(4) var<storage, read_write> slopes: array<f32>;
@group(0) @binding(5) var<storage, read_write> totals: array<f32>;

@compute @workgroup_size(256)
fn main(
  @builtin(global_invocation_id) at: vec3<u32>,
  @builtin(local_invocation_index) lane: u32,
  @builtin(workgroup_id) group: vec3<u32>,
  @builtin(num_workgroups) groups: vec3<u32>,
) {
  let n = place_of(at, groups);
  let block = group_of(group, groups);
  let count = params.width * params.height;
  var share = vec3<f32>(0.0);
  if (n < count) {
    let row = i32(n / params.width);
    var window = WINDOW;
    var m = array<vec3<f32>, 5>();
    for (var k = -RADIUS; k <= RADIUS; k++) {
      let y = row + k;
      if (y < 0 || y >= i32(params.height)) { continue; }
      let weight = window[k + RADIUS];
      let place = 15u * (u32(y) * params.width + n % params.width);
      for (var q = 0u; q < 5u; q++) {
        let p = place + 3u * q;
        m[q] += weight * vec3<f32>(sums[p], sums[p + 1u], sums[p + 2u]);
      }
    }
    let a = m[0];
    let b = m[1];
    let t1 = 2.0 * a * b + C1;
    let t2 = 2.0 * (m[4] - a * b) + C2;
    let r1 = 1.0 / (a * a + b * b + C1);
    let r2 = 1.0 / (m[2] - a * a + (m[3] - b * b) + C2);
    let s = t1 * t2 * r1 * r2;
    let crossing = 2.0 * t1 * r1 * r2;
    let first = 2.0 * b * t2 * r1 * r2 - b * crossing + 2.0 * a * s * (r2 - r1);
    let second = -s * r2;
    let to = 9u * n;
    slopes[to] = first.x;
    slopes[to + 1u] = first.y;
    slopes[to + 2u] = first.z;
    slopes[to + 3u] = second.x;
    slopes[to + 4u] = second.y;
    slopes[to + 5u] = second.z;
    slopes[to + 6u] = crossing.x;
    slopes[to + 7u] = crossing.y;
    slopes[to + 8u] = crossing.z;
    let apart = image[n].xyz - photo_pixel(photo[n]);
    share = vec3<f32>(
      abs(apart.x) + abs(apart.y) + abs(apart.z), s.x + s.y + s.z, dot(apart, apart));
  }
  let total = group_sum(lane, share);
  if (lane == 0u && 256u * block < count) {
    totals[3u * block] = total.x;
    totals[3u * block + 1u] = total.y;
    totals[3u * block + 2u] = total.z;
  }
}
