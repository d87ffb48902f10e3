// Draws a light stage's camera from its maps under one light.
const RIG_SHOWN = ['relit', 'diffuse', 'specular', 'albedo', 'specular_albedo', 'diffuse_normal', 'specular_normal', 'sigma_larger', 'sigma_smaller'];

class Rig {
  static async open(canvas, scene) {
    const gl = canvas.getContext('webgl2', {antialias: false, premultipliedAlpha: true});
    if (!gl) return null;
    const rig = new Rig(), names = Object.keys(scene.constants).filter(name => name.startsWith('LOBE_'));
    [...RIG_SHOWN.map(n => n.toUpperCase()), ...names].forEach(name => { WHOLE[name] = 1; });
    const constants = {...scene.constants, ...Object.fromEntries(RIG_SHOWN.map((n, k) => [n.toUpperCase(), k]))};
    Object.assign(rig, {
      gl, canvas, cameras: new Map(), program: new Program(gl, constants, ['screen.vert'], ['display.glsl', 'rig.frag']),
      scene, scales: scaleTexture(gl, [scene.scales.inferno, scene.scales.viridis])});
    return rig;
  }

  // A camera's textures, and the numbers in them for the read-out.
  async camera(entry) {
    if (!this.cameras.has(entry.name)) {
      const {gl} = this, [width, height] = entry.size, inside = await unpack(entry.inside), images = {};
      const albedo = await unpack(entry.albedo), lobe = await unpack(entry.lobe);
      for (const name of ['normal_d', 'normal_s', 'tangent', 'view']) images[name] = this.spread(await unpack(entry[name]), inside);
      images.albedo = new Float32Array(4 * inside.length);
      for (let i = 0, p = 0; i < inside.length; i++) {
        if (!inside[i]) continue;
        for (let c = 0; c < 3; c++) images.albedo[4 * i + c] = floatOf(albedo[3 * p + c]);
        images.normal_d[4 * i + 3] = 1;
        [images.normal_s, images.tangent, images.albedo].forEach((image, c) => { image[4 * i + 3] = floatOf(lobe[3 * p + c]); });
        p++;
      }
      const textures = Object.fromEntries(Object.entries(images).map(([name, data], k) => [
        name === 'view' ? 'u_view_of' : `u_${name}`, [k, gl.TEXTURE_2D, texture(gl, gl.TEXTURE_2D, gl.NEAREST, () => gl.texImage2D(
          gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, data))]]));
      this.cameras.set(entry.name, {entry, images, textures});
    }
    return this.cameras.get(entry.name);
  }

  // Octahedral pairs of the pixels inside as an image of unit vectors, 0 where there is none.
  spread(pairs, inside) {
    const out = new Float32Array(4 * inside.length), {nothing} = this.scene;
    for (let i = 0, p = 0; i < inside.length; i++) {
      if (!inside[i]) continue;
      const x = pairs[2 * p], z = pairs[2 * p + 1];
      p++;
      if (x === nothing) continue;
      out.set(unit(unfolded((x / 32767 + 1) / 2, (z / 32767 + 1) / 2)), 4 * i);
    }
    return out;
  }

  draw({camera, state, window, direction}) {
    const {gl, canvas, program} = this;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    program.use({
      ...camera.textures, u_scales: [6, gl.TEXTURE_2D, this.scales], u_window: window, u_direction: direction,
      u_irradiance: [Math.PI, Math.PI, Math.PI], u_exposure: 2 ** state.exposure, u_shown: RIG_SHOWN.indexOf(state.shown)});
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
