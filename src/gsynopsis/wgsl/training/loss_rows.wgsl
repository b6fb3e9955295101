// Sums along rows of a, b, a², b² and ab, window by window, [H, W, 15]; twin of
// _native/photometric.cpp.
//use place window
struct Params { width: u32, height: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
@group(0) @binding(3) var<storage, read_write> sums: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  if (n >= params.width * params.height) { return; }
  let column = i32(n % params.width);
  let row = n - u32(column);
  var window = WINDOW;
  var sum = array<vec3<f32>, 5>();
  for (var k = -RADIUS; k <= RADIUS; k++) {
    let x = column + k;
    if (x < 0 || x >= i32(params.width)) { continue; }
    let weight = window[k + RADIUS];
    let a = image[row + u32(x)].xyz;
    let b = photo_pixel(photo[row + u32(x)]);
    sum[0] += weight * a;
    sum[1] += weight * b;
    sum[2] += weight * a * a;
    sum[3] += weight * b * b;
    sum[4] += weight * a * b;
  }
  for (var q = 0u; q < 5u; q++) {
    sums[15u * n + 3u * q] = sum[q].x;
    sums[15u * n + 3u * q + 1u] = sum[q].y;
    sums[15u * n + 3u * q + 2u] = sum[q].z;
  }
}
