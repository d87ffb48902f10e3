// Shaders and textures.
// The text of a shader: constants as GLSL, then the parts by name (SHADERS is written into the page by page.py).
function source(constants, parts) {
  const number = x => Number.isInteger(x) ? `${x}.0` : `${x}`;
  const lines = Object.entries(constants).map(([name, x]) => Array.isArray(x)
    ? `const float ${name}[${x.length}] = float[${x.length}](${x.map(number).join(', ')});`
    : name in WHOLE ? `const int ${name} = ${x};` : `const float ${name} = ${number(x)};`);
  return ['#version 300 es', 'precision highp float; precision highp int;', ...lines, ...parts.map(p => SHADERS[p])].join('\n');
}
const WHOLE = {LEVELS: 1, LIGHT_SIZE: 1, HEMISPHERE_TERMS: 1, TURNS: 1, LOBE: 1};

class Program {
  constructor(gl, constants, vertex, fragment) {
    this.gl = gl;
    this.program = gl.createProgram();
    for (const [kind, parts] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source(constants, parts));
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(`${parts}: ${gl.getShaderInfoLog(shader)}`);
    }
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.program));
    this.uniforms = {};
    for (let k = 0; k < gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS); k++) {
      const {name, type} = gl.getActiveUniform(this.program, k);
      this.uniforms[name] = {type, at: gl.getUniformLocation(this.program, name)};
    }
  }

  // Sets the uniforms by name, of those that this program has; textures as [unit, target, texture].
  use(values) {
    const gl = this.gl;
    gl.useProgram(this.program);
    for (const [name, value] of Object.entries(values)) {
      const uniform = this.uniforms[name];
      if (!uniform) continue;
      const {type, at} = uniform;
      if (type === gl.FLOAT) gl.uniform1f(at, value);
      else if (type === gl.INT) gl.uniform1i(at, value);
      else if (type === gl.FLOAT_VEC2) gl.uniform2fv(at, value);
      else if (type === gl.FLOAT_VEC3) gl.uniform3fv(at, value);
      else if (type === gl.FLOAT_VEC4) gl.uniform4fv(at, value);
      else if (type === gl.FLOAT_MAT3) gl.uniformMatrix3fv(at, false, value);
      else if (type === gl.FLOAT_MAT4) gl.uniformMatrix4fv(at, false, value);
      else { gl.activeTexture(gl.TEXTURE0 + value[0]); gl.bindTexture(value[1], value[2]); gl.uniform1i(at, value[0]); }
    }
  }
}

// A texture of `target`; fill(gl) sends its texels.
function texture(gl, target, filter, fill) {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE7);
  gl.bindTexture(target, made);
  for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(target, side, gl.CLAMP_TO_EDGE);
  for (const kind of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, kind, filter);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  fill();
  return made;
}

function lightTexture(gl, light) {
  return texture(gl, gl.TEXTURE_2D_ARRAY, gl.LINEAR, () => gl.texImage3D(
    gl.TEXTURE_2D_ARRAY, 0, gl.RGBA16F, light.size, light.size, light.layers, 0, gl.RGBA, gl.HALF_FLOAT, light.data));
}

// A colour scale's anchors, one row a scale, filled up evenly.
function scaleTexture(gl, scales) {
  const count = scales[0].length, bytes = new Uint8Array(scales.flatMap(s => s.flatMap(c => [...c, 255])));
  return texture(gl, gl.TEXTURE_2D, gl.LINEAR, () => gl.texImage2D(
    gl.TEXTURE_2D, 0, gl.RGBA8, count, scales.length, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes));
}
