// What the number of splats in the picture, found on the device, makes of the kernels that follow: their parameters,
// their workgroups, and the vertices that are drawn.
//
// `plan` holds parameters every PLAN_STRIDE words, for the sort's digits and then for the levels of its prefix sums;
// from PLAN_GROUPS on workgroups, three words each: of blocks, then of each level's sums and additions; from PLAN_DRAW
// on those of an indirect draw.
struct Params { count: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> places: array<u32>;
@group(0) @binding(2) var<storage, read_write> plan: array<u32>;

const BLOCK = 1024u;
const LANES = 256u;
const DIGITS = 3u;
const LEVELS = 3u;
const PLAN_STRIDE = 64u;
const PLAN_GROUPS = 384u;
const PLAN_DRAW = 408u;
const PLAN_WORDS = 448u;

fn groups_at(place: u32, count: u32) {
  plan[place] = count;
  plan[place + 1u] = 1u;
  plan[place + 2u] = 1u;
}

@compute @workgroup_size(1)
fn main() {
  let total = places[params.count];
  let blocks = (total + BLOCK - 1u) / BLOCK;
  for (var digit = 0u; digit < DIGITS; digit++) {
    plan[digit * PLAN_STRIDE] = total;
    plan[digit * PLAN_STRIDE + 1u] = 8u * digit;
    plan[digit * PLAN_STRIDE + 2u] = blocks;
  }
  groups_at(PLAN_GROUPS, blocks);
  var sums = 256u * blocks;
  for (var level = 0u; level < LEVELS; level++) {
    plan[(DIGITS + level) * PLAN_STRIDE] = sums;
    groups_at(PLAN_GROUPS + 3u + 6u * level, (sums + BLOCK - 1u) / BLOCK);
    groups_at(PLAN_GROUPS + 6u + 6u * level, (sums + LANES - 1u) / LANES);
    sums = (sums + BLOCK - 1u) / BLOCK;
  }
  plan[PLAN_DRAW] = 3u * total;
  plan[PLAN_DRAW + 1u] = 1u;
  plan[PLAN_DRAW + 2u] = 0u;
  plan[PLAN_DRAW + 3u] = 0u;
}
