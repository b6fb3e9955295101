// The loss's gradient on the image, [H, W, 3]: of L1 and of SSIM, whose slopes are summed along
// columns here.
//use place window
struct Params { width: u32, height: u32, l1: f32, similar: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
@group(0) @binding(3) var<storage, read> sums: array<f32>;
@group(0) @binding(4) var<storage, read_write> pulls: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  if (n >= params.width * params.height) { return; }
  let row = i32(n / params.width);
  var window = WINDOW;
  var slope = array<vec3<f32>, 3>();
  for (var k = -RADIUS; k <= RADIUS; k++) {
    let y = row + k;
    if (y < 0 || y >= i32(params.height)) { continue; }
    let place = 9u * (u32(y) * params.width + n % params.width);
    for (var q = 0u; q < 3u; q++) {
      let p = place + 3u * q;
      slope[q] += window[k + RADIUS] * vec3<f32>(sums[p], sums[p + 1u], sums[p + 2u]);
    }
  }
  let a = image[n].xyz;
  let b = photo_pixel(photo[n]);
  let pull = params.l1 * sign(a - b)
    - params.similar * (slope[0] + 2.0 * a * slope[1] + b * slope[2]);
  pulls[3u * n] = pull.x;
  pulls[3u * n + 1u] = pull.y;
  pulls[3u * n + 2u] = pull.z;
}
