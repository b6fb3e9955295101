// The EWA projection of a Gaussian as both directions need it; twin of _native/projection.hpp.
//use screen
const GAUSSIAN = 14u;  // floats: mean 3, quaternion 4 (w first), scales 3, opacity, colour 3

struct Projection {
  z: f32, inverse_z: f32,
  u: f32, v: f32,                  // x/z and y/z
  u_clamped: f32, v_clamped: f32,  // as the Jacobian takes them
  quat: vec4<f32>,                 // unit length, w in x
  inverse_norm: f32,
  scale: vec3<f32>,
  rotation: array<vec3<f32>, 3>,   // rows, of the quaternion
  shaped: array<vec3<f32>, 3>,     // rows of rotation × scale
  to_screen: array<vec3<f32>, 2>,  // rows of Jacobian × world to camera
  spread: array<vec3<f32>, 2>,     // rows whose products are the covariance
  xx: f32, xy: f32, yy: f32,       // covariance, px², dilated
  determinant: f32,                // of it
  own: f32,                        // of the covariance with the Gaussian's own dilation alone
}

// By bits, as compilers may take it that no float is infinite or NaN.
fn finite(x: f32) -> bool {
  return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn project_one(mean: vec3<f32>, raw: vec4<f32>, scale: vec3<f32>, view: View) -> Projection {
  var p: Projection;
  let place = on_screen(mean, view);
  p.z = place.z;
  p.inverse_z = place.inverse_z;
  p.u = place.u;
  p.v = place.v;
  p.u_clamped = place.u_clamped;
  p.v_clamped = place.v_clamped;
  p.to_screen = place.to_screen;
  p.inverse_norm = 1.0 / sqrt(dot(raw, raw));
  p.quat = raw * p.inverse_norm;
  let w = p.quat.x;
  let x = p.quat.y;
  let y = p.quat.z;
  let z = p.quat.w;
  p.rotation[0] = vec3<f32>(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y));
  p.rotation[1] = vec3<f32>(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x));
  p.rotation[2] = vec3<f32>(2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y));
  p.scale = scale;
  p.shaped[0] = p.rotation[0] * scale;
  p.shaped[1] = p.rotation[1] * scale;
  p.shaped[2] = p.rotation[2] * scale;
  let t0 = place.to_screen[0];
  let t1 = place.to_screen[1];
  let a = t0.x * p.shaped[0] + t0.y * p.shaped[1] + t0.z * p.shaped[2];
  let b = t1.x * p.shaped[0] + t1.y * p.shaped[1] + t1.z * p.shaped[2];
  p.spread[0] = a;
  p.spread[1] = b;
  let aa = dot(a, a);
  let bb = dot(b, b);
  p.xx = aa + view.dilation;
  p.yy = bb + view.dilation;
  p.xy = dot(a, b);
  // xx yy − xy² loses everything for a long thin Gaussian; |a × b|² + dilation terms does not.
  let c = cross(a, b);
  let crossed = dot(c, c);
  p.determinant = crossed + view.dilation * (aa + bb) + view.dilation * view.dilation;
  p.own = crossed + view.own * (aa + bb) + view.own * view.own;
  return p;
}
