// The numbers behind one pixel, one group of four at a time.
layout(location = 0) out vec4 place;       // position, roughness
layout(location = 1) out vec4 surface;     // normal, IoR
layout(location = 2) out vec4 reflectance; // albedo, DoLP
layout(location = 3) out vec4 light;       // s0, AoLP

void main() {
  Material m = material();
  Shaded s = shade(m, v_position);
  vec2 polarised = dolp_aolp(s);
  place = vec4(v_position, m.roughness);
  surface = vec4(m.normal, m.ior);
  reflectance = vec4(m.albedo, polarised.x);
  light = vec4(s.diffuse + s.specular, polarised.y);
}
