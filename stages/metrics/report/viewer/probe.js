// The numbers under the pointer, rendered by the shaders of the picture into one pixel of floats.
class Probe {
  constructor(model, fragment) {
    const {gl} = model;
    this.model = model;
    this.program = new Program(gl, model.constants, ['octahedral.glsl', 'surface.vert'], fragment);
    this.target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    const buffer = (at, kind) => {
      const made = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, made);
      gl.renderbufferStorage(gl.RENDERBUFFER, kind, 1, 1);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, at, gl.RENDERBUFFER, made);
    };
    this.outputs = [0, 1, 2, 3].map(k => gl.COLOR_ATTACHMENT0 + k);
    this.outputs.forEach(at => buffer(at, gl.RGBA32F));
    buffer(gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24);
    gl.drawBuffers(this.outputs);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  // At x, y in pixels of the canvas from its lower left: {position, normal, albedo, roughness, ior, s0, dolp, aolp}, or null.
  at(view, x, y) {
    const {gl, canvas} = this.model;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(-Math.floor(x), -Math.floor(y), canvas.width, canvas.height);
    this.outputs.forEach((_, k) => gl.clearBufferfv(gl.COLOR, k, [0, 0, 0, 0]));
    gl.clearBufferfv(gl.DEPTH, 0, [1]);
    this.model.drawMesh(this.program, this.model.uniforms(view));
    const [place, surface, reflectance, light] = this.outputs.map(at => {
      const four = new Float32Array(4);
      gl.readBuffer(at);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, four);
      return [...four];
    });
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    if (!surface[3]) return null;
    return {
      position: place.slice(0, 3), roughness: place[3], normal: surface.slice(0, 3), ior: surface[3],
      albedo: reflectance.slice(0, 3), dolp: reflectance[3], s0: light.slice(0, 3), aolp: light[3] * 180 / Math.PI};
  }
}
