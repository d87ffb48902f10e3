// Draws the model: mesh, environment behind it, photograph before it.
const SHOWN = ['relit', 'diffuse', 'specular', 'albedo', 'normal', 'roughness', 'ior', 'dolp', 'aolp'];

class Model {
  static async open(canvas, scene) {
    const gl = canvas.getContext('webgl2', {antialias: true, premultipliedAlpha: true});
    if (!gl) return null;
    const model = new Model();
    Object.assign(model, {gl, canvas, scene, constants: {...scene.constants, ...Object.fromEntries(SHOWN.map((n, k) => [n.toUpperCase(), k]))}});
    SHOWN.forEach(name => { WHOLE[name.toUpperCase()] = 1; });
    await model.load();
    return model;
  }

  async load() {
    const {gl, constants, scene} = this, {surface} = scene;
    const lit = ['octahedral.glsl', 'display.glsl', 'light.glsl'], shading = [...lit, 'material.glsl', 'polarised.glsl'];
    this.programs = {
      show: new Program(gl, constants, ['octahedral.glsl', 'surface.vert'], [...shading, 'show.frag']),
      sky: new Program(gl, constants, ['screen.vert'], [...lit, 'sky.frag']),
      photograph: new Program(gl, constants, ['screen.vert'], ['display.glsl', 'photograph.frag']),
    };
    this.probe = gl.getExtension('EXT_color_buffer_float') ? new Probe(this, [...shading, 'probe.frag']) : null;
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    const parts = [['position', 3, gl.UNSIGNED_SHORT], ['normal', 2, gl.SHORT], ['albedo', 3, gl.UNSIGNED_BYTE], ['material', 2, gl.UNSIGNED_BYTE]];
    for (const [at, [name, size, kind]] of parts.entries()) {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, await unpack(surface[name]), gl.STATIC_DRAW);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, kind, true, 0, 0);
    }
    const index = await unpack(surface.index);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, index, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    this.count = index.length;
    this.indexKind = index instanceof Uint16Array ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT;
    const [depth, height, width] = scene.mirror.shape, table = await unpack(scene.mirror);
    this.textures = {
      u_scales: [1, gl.TEXTURE_2D, scaleTexture(gl, [scene.scales.inferno, scene.scales.viridis])],
      u_mirror: [2, gl.TEXTURE_3D, texture(gl, gl.TEXTURE_3D, gl.LINEAR, () => gl.texImage3D(
        gl.TEXTURE_3D, 0, gl.RG16F, width, height, depth, 0, gl.RG, gl.HALF_FLOAT, table))],
    };
    this.lights = new Map();
    this.photographs = new Map();
  }

  // Filters a map on first use; entry: of the scene, or {name, map} of a dropped file.
  async light(entry) {
    if (!this.lights.has(entry.name)) {
      const [height, width] = entry.pixels ? entry.pixels.shape : [0, 0];
      const map = entry.map || {width, height, data: radianceOf(await unpack(entry.pixels))};
      const {scale, entering, ...layers} = prefiltered(map, this.scene.lobe, this.scene.constants);
      this.lights.set(entry.name, {scale, entering, texture: lightTexture(this.gl, layers)});
    }
    return this.lights.get(entry.name);
  }

  async photograph(camera) {
    const {gl} = this;
    if (!this.photographs.has(camera.name)) {
      const image = new Image();
      image.src = camera.picture;
      await image.decode();
      this.photographs.set(camera.name, texture(gl, gl.TEXTURE_2D, gl.LINEAR, () => {
        gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
      }));
    }
    return this.photographs.get(camera.name);
  }

  uniforms({place, state, light}) {
    const {scene} = this, {surface, scales} = scene, turn = state.turn * Math.PI / 180;
    const angle = state.polariser === null ? null : 2 * state.polariser * Math.PI / 180;
    return {
      ...this.textures, u_light: [0, this.gl.TEXTURE_2D_ARRAY, light.texture], u_light_scale: light.scale,
      u_light_turn: [Math.cos(turn), Math.sin(turn)], u_low: surface.low, u_extent: minus(surface.high, surface.low),
      u_view: place.view, u_projection: place.projection, u_eye: place.eye, u_up: place.up,
      u_world_from_clip: inverse(place.projection, place.view), u_ior_range: surface.ior_range,
      u_mirror_ior: scene.mirror_ior, u_shown: SHOWN.indexOf(state.shown), u_exposure: 2 ** state.exposure,
      u_dolp_full: scales.dolp, u_aolp_full: scales.aolp, u_ior_shown: scales.ior,
      u_analyser: angle === null ? [1, 0, 0] : [0.5, 0.5 * Math.cos(angle), 0.5 * Math.sin(angle)],
      u_world_from_view: scene.world_from_view.flatMap((_, c) => scene.world_from_view.map(row => row[c])),
    };
  }

  draw(view) {
    const {gl, canvas} = this, {state, photograph, place} = view, values = this.uniforms(view);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.drawMesh(this.programs.show, values);
    const triangle = (program, more) => { program.use({...values, ...more}); gl.drawArrays(gl.TRIANGLES, 0, 3); };
    gl.depthFunc(gl.LEQUAL);
    if (state.sky) triangle(this.programs.sky, {});
    if (photograph) {
      gl.disable(gl.DEPTH_TEST);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(0, 0, Math.round(state.wipe * canvas.width), canvas.height);
      triangle(this.programs.photograph, {
        u_photograph: [3, gl.TEXTURE_2D, photograph], u_box: place.box, u_exposure: 2 ** state.exposure / this.scene.gain});
      gl.disable(gl.SCISSOR_TEST);
    }
  }

  drawMesh(program, values) {
    const {gl} = this;
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    program.use(values);
    gl.bindVertexArray(this.array);
    gl.drawElements(gl.TRIANGLES, this.count, this.indexKind, 0);
    gl.bindVertexArray(null);
  }
}
