// The sum of what each of a workgroup's 256 invocations has, in a fixed order; all of them call it.
var<workgroup> shares: array<vec3<f32>, 256>;

fn group_sum(lane: u32, share: vec3<f32>) -> vec3<f32> {
  workgroupBarrier();  // an earlier sum has been read
  shares[lane] = share;
  workgroupBarrier();
  for (var step = 128u; step > 0u; step /= 2u) {
    if (lane < step) { shares[lane] += shares[lane + step]; }
    workgroupBarrier();
  }
  return shares[0];
}
