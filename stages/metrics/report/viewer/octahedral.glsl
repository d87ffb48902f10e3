// Directions on the unfolded octahedron, y its axis (Cigolle et al. 2014).
vec2 side(vec2 p) { return vec2(p.x < 0.0 ? -1.0 : 1.0, p.y < 0.0 ? -1.0 : 1.0); }

vec3 unfold(vec2 p) {
  vec3 d = vec3(p.x, 1.0 - abs(p.x) - abs(p.y), p.y);
  if (d.y < 0.0) d.xz = (1.0 - abs(d.zx)) * side(d.xz);
  return normalize(d);
}

vec2 fold(vec3 d) {
  d /= abs(d.x) + abs(d.y) + abs(d.z);
  return d.y < 0.0 ? (1.0 - abs(d.zx)) * side(d.xz) : d.xz;
}
