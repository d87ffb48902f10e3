// One of the views of the model.
uniform int u_shown;
uniform float u_exposure, u_dolp_full, u_aolp_full;
uniform vec3 u_analyser;  // what a polariser passes of (s0, s1, s2); (1, 0, 0) without one
uniform vec2 u_ior_shown;
uniform mat3 u_world_from_view;
out vec4 colour;

void main() {
  Material m = material();
  vec3 shown;
  if (u_shown == ALBEDO) shown = srgb(m.albedo);
  else if (u_shown == NORMAL) shown = 0.5 * (u_world_from_view * m.normal) + 0.5;
  else if (u_shown == ROUGHNESS) shown = on_scale(m.roughness, 1.0);
  else if (u_shown == IOR) shown = on_scale((m.ior - u_ior_shown.x) / (u_ior_shown.y - u_ior_shown.x), 1.0);
  else {
    Shaded s = shade(m, v_position);
    vec2 polarised = dolp_aolp(s);
    if (u_shown == DOLP) shown = on_scale(polarised.x / u_dolp_full, 0.0);
    else if (u_shown == AOLP) shown = hue(polarised.y, polarised.x / u_aolp_full);
    else if (u_shown == DIFFUSE) shown = srgb(s.diffuse * u_exposure);
    else if (u_shown == SPECULAR) shown = srgb(s.specular * u_exposure);
    else shown = srgb((u_analyser.x * (s.diffuse + s.specular) + u_analyser.y * s.s1 + u_analyser.z * s.s2) * u_exposure);
  }
  colour = vec4(shown, 1.0);
}
