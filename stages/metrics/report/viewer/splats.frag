// A disc's colour over what lies behind it; colours are blended as they are shown, as viewers of Gaussians do.
in vec2 v_sigmas;
in vec4 v_shown;
out vec4 colour;

void main() {
  float alpha = v_shown.a * exp(-0.5 * dot(v_sigmas, v_sigmas));
  if (alpha < 1.0 / 255.0) discard;
  colour = vec4(v_shown.rgb * alpha, alpha);
}
