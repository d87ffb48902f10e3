// Linear light and numbers as colours of a display; the scales are the report's.
uniform sampler2D u_scales;  // two rows: inferno, viridis

vec3 srgb(vec3 x) {
  x = clamp(x, 0.0, 1.0);
  return mix(12.92 * x, 1.055 * pow(x, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
}

vec3 linear_of(vec3 x) { return mix(x / 12.92, pow((x + 0.055) / 1.055, vec3(2.4)), step(0.04045, x)); }

vec3 on_scale(float share, float row) {
  float count = float(textureSize(u_scales, 0).x);
  return texture(u_scales, vec2((clamp(share, 0.0, 1.0) * (count - 1.0) + 0.5) / count, (row + 0.5) / 2.0)).rgb;
}

vec3 hue(float angle, float strength) {
  vec3 phase = 2.0 * angle + vec3(0.0, 2.0943951, 4.1887902);
  return (0.55 + 0.45 * cos(phase)) * clamp(strength, 0.0, 1.0);
}
