// Stokes vectors of a rough dielectric under the prefiltered light: docs/physics.md, Fresnel terms and Shading (split sum).
uniform highp sampler3D u_mirror;  // (rho, across) over [sqrt cosine, roughness, IoR]
uniform vec3 u_eye, u_up;          // camera centre, and its upward axis
uniform vec2 u_mirror_ior;         // range of the table

struct Shaded {
  vec3 diffuse, specular, s1, s2;
};

float hemispherical(float eta) {  // fresnel.py, hemispherical_transmittance
  float excess = clamp(eta, HEMISPHERE_FROM, HEMISPHERE_TO) - 1.0, x = sqrt(max(excess, 1e-12)) * HEMISPHERE_STEP - 1.0, value = 0.0;
  for (int i = HEMISPHERE_TERMS - 1; i >= 0; i--) value = value * x + HEMISPHERE[i];
  return 1.0 - excess * value;
}

Shaded shade(Material m, vec3 position) {
  vec3 ray = normalize(position - u_eye), x = normalize(cross(ray, u_up)), y = cross(x, ray);
  float facing = -dot(m.normal, ray), c = clamp(facing, MIN_COSINE, 1.0), eta = max(m.ior, 1.0);
  float r = clamp(m.roughness, MIN_ROUGHNESS, 1.0);
  float k = (eta - 1.0) * (eta + 1.0), q = sqrt(k + c * c), e2 = eta * eta;
  float rs = k / ((c + q) * (c + q)), rp = k * ((e2 + 1.0) * c * c - 1.0) / ((e2 * c + q) * (e2 * c + q));
  float reflected = 0.5 * (rs * rs + rp * rp);
  float transmitted = 2.0 * c * q * (1.0 / ((c + q) * (c + q)) + e2 / ((e2 * c + q) * (e2 * c + q)));
  float a = k / eta, b = eta + 1.0 / eta, beta_d = a * a / (b * b * c * c + a * b + 4.0 * c * q);
  vec3 size = vec3(textureSize(u_mirror, 0)), at = vec3(sqrt(c), r, (eta - u_mirror_ior.x) / (u_mirror_ior.y - u_mirror_ior.x));
  vec2 table = texture(u_mirror, (clamp(at, 0.0, 1.0) * (size - 1.0) + 0.5) / size).rg;
  Shaded s;
  // In a hollow that hides 1 - sky, the walls send back what they receive, again and again.
  float enters = hemispherical(eta);
  vec3 received = entering(m.normal) * m.sky / (1.0 - m.albedo * enters * (1.0 - m.sky));
  s.diffuse = transmitted * enters / hemispherical(REFERENCE_IOR) / PI * m.albedo * received;
  // Lagarde and de Rousiers (2014, 4.10.2): how much of the lobe the hollow leaves free; the walls are as bright as the body.
  float free = clamp(pow(c + m.sky, exp2(-16.0 * r - 1.0)) - 1.0 + m.sky, 0.0, 1.0);
  s.specular = reflected * table.x * mix(s.diffuse, mirrored(2.0 * facing * m.normal + ray, r), free);
  vec2 n = vec2(dot(m.normal, x), dot(m.normal, y));
  vec3 body = beta_d * s.diffuse - table.y * s.specular;
  s.s1 = (n.x - n.y) * (n.x + n.y) * body;
  s.s2 = 2.0 * n.x * n.y * body;
  return s;
}

float grey(vec3 x) { return (x.r + x.g + x.b) / 3.0; }
vec2 dolp_aolp(Shaded s) {  // of the colour mean, as the report shows it
  float s0 = grey(s.diffuse + s.specular), s1 = grey(s.s1), s2 = grey(s.s2);
  return s0 > 1e-6 ? vec2(length(vec2(s1, s2)) / s0, 0.5 * atan(s2, s1)) : vec2(0.0);
}
