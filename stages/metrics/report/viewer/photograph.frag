// A photograph in its camera's place on the screen, at the exposure of the model beside it.
in vec2 v_screen;
uniform sampler2D u_photograph;
uniform vec4 u_box;  // middle and half size on the screen
uniform float u_exposure;
out vec4 colour;

void main() {
  vec2 at = (v_screen - u_box.xy) / u_box.zw;
  if (max(abs(at.x), abs(at.y)) > 1.0) discard;
  colour = vec4(srgb(linear_of(texture(u_photograph, vec2(0.5 + 0.5 * at.x, 0.5 - 0.5 * at.y)).rgb) * u_exposure), 1.0);
}
