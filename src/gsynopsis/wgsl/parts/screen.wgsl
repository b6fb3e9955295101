// A place before a camera, and the rows of Jacobian × world to camera there; as in _native/raster/projection.hpp.
//use view
const FOV_CLAMP = 1.3;

struct OnScreen {
  z: f32, inverse_z: f32,
  u: f32, v: f32,                  // x/z and y/z
  u_clamped: f32, v_clamped: f32,  // as the Jacobian takes them
  to_screen: array<vec3<f32>, 2>,
}

fn on_screen(mean: vec3<f32>, view: View) -> OnScreen {
  var p: OnScreen;
  let r0 = vec3<f32>(view.r00, view.r01, view.r02);
  let r1 = vec3<f32>(view.r10, view.r11, view.r12);
  let r2 = vec3<f32>(view.r20, view.r21, view.r22);
  p.z = dot(r2, mean) + view.tz;
  p.inverse_z = 1.0 / p.z;
  p.u = (dot(r0, mean) + view.tx) * p.inverse_z;
  p.v = (dot(r1, mean) + view.ty) * p.inverse_z;
  let u_limit = FOV_CLAMP * 0.5 * view.width / view.fx;
  let v_limit = FOV_CLAMP * 0.5 * view.height / view.fy;
  p.u_clamped = clamp(p.u, -u_limit, u_limit);
  p.v_clamped = clamp(p.v, -v_limit, v_limit);
  let x_by_x = view.fx * p.inverse_z;
  let y_by_y = view.fy * p.inverse_z;
  p.to_screen[0] = x_by_x * r0 - x_by_x * p.u_clamped * r2;
  p.to_screen[1] = y_by_y * r1 - y_by_y * p.v_clamped * r2;
  return p;
}
