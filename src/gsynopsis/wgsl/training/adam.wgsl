// A step of Adam on one tensor, by a share of its gradient; twin of _native/adam.cpp.
//use place
struct Params { count: u32, rate: f32, root: f32, epsilon: f32, share: f32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grads: array<f32>;
@group(0) @binding(2) var<storage, read_write> values: array<f32>;
@group(0) @binding(3) var<storage, read_write> means: array<f32>;
@group(0) @binding(4) var<storage, read_write> squares: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = place_of(at, groups);
  if (i >= params.count) { return; }
  let g = params.share * grads[i];
  let m = means[i] + 0.1 * (g - means[i]);
  let v = 0.999 * squares[i] + 0.001 * g * g;
  means[i] = m;
  squares[i] = v;
  values[i] -= params.rate * m / (sqrt(v) * params.root + params.epsilon);
}
