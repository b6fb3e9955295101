// The number of an invocation in a one-dimensional job that is dispatched as rows of workgroups.
fn place_of(at: vec3<u32>, groups: vec3<u32>) -> u32 {
  return at.y * groups.x * 256u + at.x;
}
fn group_of(group: vec3<u32>, groups: vec3<u32>) -> u32 {
  return group.y * groups.x + group.x;
}
