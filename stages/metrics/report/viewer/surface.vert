// The mesh: position and attributes at its vertices, quantised as surface_data.py packs them.
layout(location = 0) in vec3 a_position;  // 0..1 of the box
layout(location = 1) in vec2 a_normal;    // octahedral
layout(location = 2) in vec3 a_albedo;    // sRGB
layout(location = 3) in vec3 a_material;  // roughness, IoR over its range, share of the sky seen
layout(location = 4) in vec2 a_uv;
layout(location = 5) in vec3 a_tangent;   // octahedral, and the sign of the third axis
uniform vec3 u_low, u_extent;
uniform mat4 u_view, u_projection;
out vec3 v_position, v_normal, v_albedo, v_material;
out vec4 v_tangent;
out vec2 v_uv;

void main() {
  v_position = u_low + a_position * u_extent;
  v_normal = unfold(a_normal);
  v_albedo = a_albedo;
  v_material = a_material;
  v_uv = a_uv;
  v_tangent = vec4(unfold(a_tangent.xy), a_tangent.z < 0.0 ? -1.0 : 1.0);
  gl_Position = u_projection * u_view * vec4(v_position, 1.0);
}
