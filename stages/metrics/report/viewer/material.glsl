// What the surface is made of at a fragment: the one place that knows where albedo, roughness, IoR and normal come from.
// Today they stand at the vertices; with textures they are looked up here.
in vec3 v_position, v_normal, v_albedo;
in vec2 v_material;
uniform vec2 u_ior_range;

struct Material {
  vec3 normal, albedo;
  float roughness, ior;
};

Material material() {
  return Material(normalize(v_normal), linear_of(v_albedo), v_material.x, mix(u_ior_range.x, u_ior_range.y, v_material.y));
}
