// A Gaussian disc as a square of three sigmas about its centre, in the plane that its normal stands on.
layout(location = 0) in vec3 a_centre;
layout(location = 1) in vec3 a_upright;
layout(location = 2) in vec2 a_shape;   // sigma, opacity
layout(location = 3) in vec3 a_colour;  // sRGB
uniform mat4 u_view, u_projection;
out vec2 v_sigmas;
out vec4 v_shown;

void main() {
  vec3 helper = abs(a_upright.y) < 0.7 ? vec3(0.0, 1.0, 0.0) : vec3(1.0, 0.0, 0.0);
  vec3 along = normalize(cross(helper, a_upright)), across = cross(a_upright, along);
  v_sigmas = 3.0 * vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 3.0;
  v_shown = vec4(a_colour, a_shape.y);
  vec3 place = a_centre + a_shape.x * (v_sigmas.x * along + v_sigmas.y * across);
  gl_Position = u_projection * u_view * vec4(place, 1.0);
}
