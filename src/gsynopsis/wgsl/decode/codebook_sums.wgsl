// What each part of the rows adds to the codebook's gradient: [part, entries, width], in order.
//use place
struct Params { count: u32, entries: u32, width: u32, part: u32, stride: u32, first: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> codes: array<u32>;
@group(0) @binding(2) var<storage, read> pulls: array<f32>;
@group(0) @binding(3) var<storage, read_write> partials: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = place_of(at, groups);
  let i = n % params.width;
  let c = (n / params.width) % params.entries;
  let begin = n / (params.width * params.entries) * params.part;
  if (begin >= params.count) { return; }
  let end = min(begin + params.part, params.count);
  var sum = 0.0;
  for (var v = begin; v < end; v++) {
    if (codes[v] == c) { sum += pulls[v * params.stride + params.first + i]; }
  }
  partials[n] = sum;
}
