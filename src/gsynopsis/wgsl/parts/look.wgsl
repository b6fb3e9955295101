// A splat's look at some time: the viewer's eight words of it, and while it changes the eight before.
//
// Covariance xx xy xz yy yz zz, then halves: red, green, blue and opacity. The kernel has `words`, `before` and, for
// each page of 1,024 splats, `times`; its parameters have `limit`, `changing`, `time` and `fade`.
const PAGE = 1024u;

struct Look { one: vec4<u32>, two: vec4<u32> }

// Two looks, `share` of the second; a splat that one of them does not draw keeps its form.
fn mixed(before: Look, after: Look, share: f32) -> Look {
  var a = before;
  var b = after;
  let was = unpack2x16float(a.two.w).y;
  let now = unpack2x16float(b.two.w).y;
  if (now == 0.0) { b = a; }
  if (was == 0.0) { a = b; }
  let covariance = mix(bitcast<vec2<f32>>(a.two.xy), bitcast<vec2<f32>>(b.two.xy), share);
  let red_green = mix(unpack2x16float(a.two.z), unpack2x16float(b.two.z), share);
  let blue = mix(unpack2x16float(a.two.w).x, unpack2x16float(b.two.w).x, share);
  let opacity = mix(was, now, share);
  return Look(
    bitcast<vec4<u32>>(mix(bitcast<vec4<f32>>(a.one), bitcast<vec4<f32>>(b.one), share)),
    vec4<u32>(bitcast<vec2<u32>>(covariance), pack2x16float(red_green), pack2x16float(vec2<f32>(blue, opacity))));
}

// What it is at the time of the parameters; nothing is drawn from `limit` on.
fn look_of(splat: u32) -> Look {
  var now = Look(words[2u * splat], words[2u * splat + 1u]);
  if (splat >= params.limit) { now.two.w &= 0xffffu; }
  if (params.changing == 0u) { return now; }
  let share = clamp((params.time - times[splat / PAGE]) / params.fade, 0.0, 1.0);
  if (share == 1.0) { return now; }
  return mixed(Look(before[2u * splat], before[2u * splat + 1u]), now, share);
}
