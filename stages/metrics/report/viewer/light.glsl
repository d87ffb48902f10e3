// A prefiltered environment: layers of one octahedral map, made by prefilter.js. Layer k < LEVELS mirrors at LEVEL_ROUGHNESS[k],
// the last is the irradiance that enters a body (with transmission at the reference IoR).
uniform highp sampler2DArray u_light;
uniform float u_light_scale;
uniform vec2 u_light_turn;  // cosine and sine of its turn about y

vec3 light_layer(vec3 d, int layer) {
  d = vec3(u_light_turn.x * d.x - u_light_turn.y * d.z, d.y, u_light_turn.y * d.x + u_light_turn.x * d.z);
  vec2 uv = (0.5 * fold(d) + 0.5) * float(LIGHT_SIZE) + 1.0;  // one texel of border
  return texture(u_light, vec3(uv / float(LIGHT_SIZE + 2), float(layer))).rgb * u_light_scale;
}

vec3 mirrored(vec3 d, float roughness) {
  int k = 0;
  for (int i = 1; i < LEVELS - 1; i++) if (roughness >= LEVEL_ROUGHNESS[i]) k = i;
  float t = clamp((roughness - LEVEL_ROUGHNESS[k]) / (LEVEL_ROUGHNESS[k + 1] - LEVEL_ROUGHNESS[k]), 0.0, 1.0);
  return mix(light_layer(d, k), light_layer(d, k + 1), t);
}

vec3 entering(vec3 n) { return light_layer(n, LEVELS); }
