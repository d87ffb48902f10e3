// The environment behind the object, through the sharpest layer.
in vec2 v_screen;
uniform mat4 u_world_from_clip;
uniform vec3 u_eye;
uniform float u_exposure;
out vec4 colour;

void main() {
  vec4 far = u_world_from_clip * vec4(v_screen, 1.0, 1.0);
  colour = vec4(srgb(light_layer(normalize(far.xyz / far.w - u_eye), 0) * u_exposure), 1.0);
}
