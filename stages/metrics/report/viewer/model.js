// Draws the model: mesh, environment behind it, photograph before it.
const COARSE_CELLS = 48;  // along the box: about seven thousand triangles
const SHOWN = ['relit', 'diffuse', 'specular', 'albedo', 'normal', 'roughness', 'ior', 'dolp', 'aolp'];
const LIT = 'splats';  // beside the views of the mesh: the Gaussians under the captured light

class Model {
  static async open(canvas, scene) {
    const gl = canvas.getContext('webgl2', {antialias: false, premultipliedAlpha: true});
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
    await this.geometry(surface);
    this.splats = scene.splats ? await Splats.open(this, scene.splats) : null;
    const pictures = surface.pictures || {};
    const [albedo, properties] = await Promise.all(['albedo', 'surface'].map(name => this.picture(pictures[name])));
    const [depth, height, width] = scene.mirror.shape, table = await unpack(scene.mirror);
    this.textures = {
      u_scales: [1, gl.TEXTURE_2D, scaleTexture(gl, [scene.scales.inferno, scene.scales.viridis])],
      u_mirror: [2, gl.TEXTURE_3D, texture(gl, gl.TEXTURE_3D, gl.LINEAR, () => gl.texImage3D(
        gl.TEXTURE_3D, 0, gl.RG16F, width, height, depth, 0, gl.RG, gl.HALF_FLOAT, table))],
      u_albedo: [4, gl.TEXTURE_2D, albedo], u_surface: [5, gl.TEXTURE_2D, properties],
    };
    this.lights = new Map();
    this.photographs = new Map();
  }

  // The mesh's buffers, and two lists of triangles over them: all, and few for slow machines while something moves.
  async geometry(surface) {
    const {gl} = this, parts = [
      ['position', 3, gl.UNSIGNED_SHORT], ['normal', 2, gl.SHORT], ['albedo', 3, gl.UNSIGNED_BYTE], ['material', 3, gl.UNSIGNED_BYTE],
      ...surface.pictures ? [['uv', 2, gl.UNSIGNED_SHORT], ['tangent', 3, gl.SHORT]] : []];
    const arrays = await Promise.all(parts.map(([name]) => unpack(surface[name]))), index = await unpack(surface.index);
    const buffers = arrays.map(data => this.buffer(gl.ARRAY_BUFFER, data));
    this.triangles = [index, coarseTriangles(arrays[0], index, minus(surface.high, surface.low), COARSE_CELLS)].map(list => {
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      parts.forEach(([, size, kind], at) => {
        gl.bindBuffer(gl.ARRAY_BUFFER, buffers[at]);
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, size, kind, true, 0, 0);
      });
      this.buffer(gl.ELEMENT_ARRAY_BUFFER, list);
      gl.bindVertexArray(null);
      return {array, count: list.length, kind: list instanceof Uint16Array ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT};
    });
  }

  buffer(target, data) {
    const {gl} = this, made = gl.createBuffer();
    gl.bindBuffer(target, made);
    gl.bufferData(target, data, gl.STATIC_DRAW);
    return made;
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

  // A texture of the surface from a data: URI; one texel where there is none. Charts lie four texels apart: two levels are clean.
  async picture(uri) {
    const {gl} = this, image = uri && new Image();
    if (image) { image.src = uri; await image.decode(); }
    return texture(gl, gl.TEXTURE_2D, gl.LINEAR, () => {
      gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
      if (!image) { gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); return; }
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAX_LEVEL, 2);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      gl.generateMipmap(gl.TEXTURE_2D);
    });
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
    const {gl, canvas} = this, {state, photograph, place, coarse} = view, values = this.uniforms(view);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (state.shown === LIT) this.splats.draw(values, place.eye);
    else this.drawMesh(this.programs.show, values, coarse);
    const triangle = (program, more) => { program.use({...values, ...more}); gl.drawArrays(gl.TRIANGLES, 0, 3); };
    gl.depthFunc(gl.LEQUAL);
    if (state.sky && state.shown !== LIT) triangle(this.programs.sky, {});
    if (photograph) {
      gl.disable(gl.DEPTH_TEST);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(0, 0, Math.round(state.wipe * canvas.width), canvas.height);
      triangle(this.programs.photograph, {
        u_photograph: [3, gl.TEXTURE_2D, photograph], u_box: place.box, u_exposure: 2 ** state.exposure / this.scene.gain});
      gl.disable(gl.SCISSOR_TEST);
    }
  }

  // coarse: few triangles, and none that face away; they reach over the seams of textures, so their vertices' colours do.
  drawMesh(program, values, coarse = false) {
    const {gl} = this, {array, count, kind} = this.triangles[coarse ? 1 : 0];
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    if (coarse) gl.enable(gl.CULL_FACE); else gl.disable(gl.CULL_FACE);
    program.use({...values, u_textured: this.scene.surface.pictures && !coarse ? 1 : 0});
    gl.bindVertexArray(array);
    gl.drawElements(gl.TRIANGLES, count, kind, 0);
    gl.bindVertexArray(null);
    gl.disable(gl.CULL_FACE);
  }
}
