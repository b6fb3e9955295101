// Sums of the slopes along rows, window by window, [H, W, 9].
//use place window
struct Params { width: u32, height: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> slopes: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  if (n >= params.width * params.height) { return; }
  let column = i32(n % params.width);
  let row = n - u32(column);
  var window = WINDOW;
  var sum = array<f32, 9>();
  for (var k = -RADIUS; k <= RADIUS; k++) {
    let x = column + k;
    if (x < 0 || x >= i32(params.width)) { continue; }
    let place = 9u * (row + u32(x));
    for (var q = 0u; q < 9u; q++) { sum[q] += window[k + RADIUS] * slopes[place + q]; }
  }
  for (var q = 0u; q < 9u; q++) { sums[9u * n + q] = sum[q]; }
}
