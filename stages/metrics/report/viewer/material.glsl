// What the surface is made of at a fragment: the one place that knows where albedo, roughness, IoR and normal come from:
// from textures where the mesh has them, else from its vertices.
in vec3 v_position, v_normal, v_albedo, v_material;
in vec4 v_tangent;
in vec2 v_uv;
uniform vec2 u_ior_range;
uniform int u_textured;
uniform sampler2D u_albedo, u_surface;  // sRGB; normal x y about a half in the tangent frame, roughness

struct Material {
  vec3 normal, albedo;
  float roughness, ior, sky;  // sky: share of it that is not hidden by the object
};

Material material() {
  vec3 n = normalize(v_normal);
  float ior = mix(u_ior_range.x, u_ior_range.y, v_material.y);
  if (u_textured == 0) return Material(n, linear_of(v_albedo), v_material.x, ior, v_material.z);
  vec3 t = normalize(v_tangent.xyz - dot(v_tangent.xyz, n) * n), found = texture(u_surface, v_uv).rgb;
  vec2 slope = 2.0 * found.rg - 1.0;
  vec3 local = vec3(slope, sqrt(max(1.0 - dot(slope, slope), 0.0)));
  n = normalize(local.x * t + local.y * v_tangent.w * cross(n, t) + local.z * n);
  return Material(n, linear_of(texture(u_albedo, v_uv).rgb), found.b, ior, v_material.z);
}
