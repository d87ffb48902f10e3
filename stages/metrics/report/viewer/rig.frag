// A pixel of a light stage's camera under one distant light, from its fitted maps: pipeline/rig/lobes.py and map_rendering.py.
in vec2 v_screen;
uniform highp sampler2D u_normal_d, u_normal_s, u_tangent, u_view_of, u_albedo;  // + inside, sigma x, sigma y, -, specular albedo
uniform vec4 u_window;  // middle and half size of the screen, in shares of the picture
uniform vec3 u_direction, u_irradiance;
uniform float u_exposure;
uniform int u_shown;
out vec4 colour;
const float TURNS = 6.0;  // tangents over which a lobe without one of its own is averaged

float unmasked(vec3 d, vec2 sigma) {
  float s = length(d.xy * sigma) / max(d.z, LIGHT_FLOOR);
  if (LOBE == LOBE_GGX) return 2.0 / (1.0 + sqrt(1.0 + s * s));
  return s < 0.625 ? 1.0 : (3.535 * s + 2.181) / (s * s + 2.276 * s + 2.577);
}

float lobe(vec3 h, vec3 i, vec3 o, vec2 sigma) {  // in the frame of tangent, bitangent, normal
  float z = max(h.z, LIGHT_FLOOR), ni = max(i.z, LIGHT_FLOOR), no = max(o.z, VIEW_FLOOR);
  vec2 u = h.xy / sigma;
  float q = dot(u, u), size = 1.0 / (4.0 * PI * sigma.x * sigma.y * no);
  if (LOBE == LOBE_GGX) return size * unmasked(i, sigma) * unmasked(o, sigma) / ((q + z * z) * (q + z * z));
  if (LOBE == LOBE_BECKMANN) return size * unmasked(i, sigma) * unmasked(o, sigma) * exp(-q / (z * z)) / (z * z * z * z);
  float ward = size * exp(-2.0 * q / (1.0 + z));
  if (LOBE == LOBE_PRINTED) return ward * sqrt(no / ni);
  return LOBE == LOBE_PRINTED_COSINE ? ward * sqrt(no / ni) * ni : ward;
}

float mirrored(vec3 m, vec3 tangent, vec2 sigma, vec3 view) {
  if (dot(m, u_direction) <= 0.0) return 0.0;
  vec3 h = normalize(u_direction + view), axis = abs(m.x) < abs(m.y) ? vec3(1, 0, 0) : vec3(0, 1, 0);
  bool own = dot(tangent, tangent) > 0.25;
  vec3 t = own ? tangent : axis;
  t = normalize(t - dot(t, m) * m);
  vec3 b = cross(m, t);
  float turns = own || sigma.x == sigma.y ? 1.0 : TURNS, sum = 0.0;
  for (float k = 0.0; k < turns; k += 1.0) {
    float c = cos(k * PI / turns), s = sin(k * PI / turns);
    mat3 frame = mat3(c * t + s * b, c * b - s * t, m);
    sum += lobe(h * frame, u_direction * frame, view * frame, sigma) / turns;
  }
  return sum;
}

void main() {
  vec2 at = u_window.xy + u_window.zw * v_screen * vec2(1.0, -1.0);
  colour = vec4(0.0);
  if (at.x < 0.0 || at.x > 1.0 || at.y < 0.0 || at.y > 1.0) return;
  vec4 n = texture(u_normal_d, at), m = texture(u_normal_s, at), t = texture(u_tangent, at), a = texture(u_albedo, at);
  if (n.w < 0.5) return;
  vec2 sigma = vec2(m.w, t.w);
  vec3 diffuse = a.rgb * max(dot(n.xyz, u_direction), 0.0) * u_irradiance / PI, specular = vec3(0.0), shown;
  if (a.w > 0.0 && sigma.y > 0.0) specular = a.w * mirrored(m.xyz, t.xyz, sigma, texture(u_view_of, at).xyz) * u_irradiance;
  if (u_shown == DIFFUSE) shown = srgb(diffuse * u_exposure);
  else if (u_shown == SPECULAR) shown = srgb(specular * u_exposure);
  else if (u_shown == ALBEDO) shown = srgb(a.rgb);
  else if (u_shown == SPECULAR_ALBEDO) shown = on_scale(a.w, 0.0);
  else if (u_shown == DIFFUSE_NORMAL) shown = 0.5 * n.xyz + 0.5;
  else if (u_shown == SPECULAR_NORMAL) shown = 0.5 * m.xyz + 0.5;
  else if (u_shown == SIGMA_LARGER) shown = on_scale(sigma.x / SIGMA_SHOWN, 1.0);
  else if (u_shown == SIGMA_SMALLER) shown = on_scale(sigma.y / SIGMA_SHOWN, 1.0);
  else shown = srgb((diffuse + specular) * u_exposure);
  colour = vec4(shown, 1.0);
}
