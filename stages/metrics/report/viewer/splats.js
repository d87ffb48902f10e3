// The lit Gaussians: sorted by distance and coloured for the camera on the processor, blended by the graphics card.
class Splats {
  static async open(model, entry) {
    const {gl, constants} = model, splats = new Splats();
    const [position, normal, sigma, opacity, colour] = await Promise.all(['position', 'normal', 'sigma', 'opacity', 'colour'].map(n => unpack(entry[n])));
    const count = opacity.length, extent = minus(entry.high, entry.low), centre = new Float32Array(3 * count), upright = new Float32Array(3 * count);
    for (let i = 0; i < count; i++) {
      const n = unfolded(normal[2 * i] / 65534 + 0.5, normal[2 * i + 1] / 65534 + 0.5), length = Math.hypot(...n);
      for (let k = 0; k < 3; k++) {
        centre[3 * i + k] = entry.low[k] + position[3 * i + k] / 65535 * extent[k];
        upright[3 * i + k] = n[k] / length;
      }
    }
    const array = gl.createVertexArray(), buffer = gl.createBuffer();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    let offset = 0;
    [3, 3, 2, 3].forEach((size, at) => {
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, gl.FLOAT, false, 44, offset);
      gl.vertexAttribDivisor(at, 1);
      offset += 4 * size;
    });
    gl.bindVertexArray(null);
    return Object.assign(splats, {
      gl, array, buffer, count, centre, upright, opacity, colour, sigma: Float32Array.from(sigma, floatOf), scale: entry.range.map(x => x / 127),
      keys: new Float32Array(count), rows: new Float32Array(11 * count), program: new Program(gl, constants, ['splats.vert'], ['splats.frag'])});
  }

  // The discs that face the eye, far ones first, with the colours that leave them towards it; how many.
  arranged(eye) {
    const {centre, upright, keys, rows, colour, scale} = this, order = [];
    for (let i = 0, j = 0; i < this.count; i++, j += 3) {
      const x = centre[j] - eye[0], y = centre[j + 1] - eye[1], z = centre[j + 2] - eye[2];
      keys[i] = x * x + y * y + z * z;
      if (x * upright[j] + y * upright[j + 1] + z * upright[j + 2] < -0.1 * Math.sqrt(keys[i])) order.push(i);
    }
    order.sort((a, b) => keys[b] - keys[a]);
    const h = new Float32Array(16);
    order.forEach((i, place) => {
      const at = 11 * place, j = 3 * i, away = Math.sqrt(keys[i]);
      harmonics((centre[j] - eye[0]) / away, (centre[j + 1] - eye[1]) / away, (centre[j + 2] - eye[2]) / away, h);
      for (let k = 0; k < 3; k++) {
        let sum = 0.5;
        for (let m = 0; m < 16; m++) sum += h[m] * scale[m] * colour[48 * i + 3 * m + k];
        rows[at + k] = centre[j + k];
        rows[at + 3 + k] = upright[j + k];
        rows[at + 8 + k] = Math.max(0, Math.min(1, sum));
      }
      rows[at + 6] = this.sigma[i];
      rows[at + 7] = this.opacity[i] / 255;
    });
    return order.length;
  }

  draw(values, eye) {
    const {gl} = this, shown = this.arranged(eye);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, this.rows.subarray(0, 11 * shown), gl.DYNAMIC_DRAW);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.program.use(values);
    gl.bindVertexArray(this.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, shown);
    gl.bindVertexArray(null);
    gl.disable(gl.BLEND);
  }
}

// pipeline/splats/harmonics.py, with the phase.
function harmonics(x, y, z, out) {
  const xx = x * x, yy = y * y, zz = z * z;
  out[0] = 0.28209479177387814;
  out[1] = -0.4886025119029199 * y; out[2] = 0.4886025119029199 * z; out[3] = -0.4886025119029199 * x;
  out[4] = 1.0925484305920792 * x * y; out[5] = -1.0925484305920792 * y * z; out[6] = 0.31539156525252005 * (3 * zz - 1);
  out[7] = -1.0925484305920792 * x * z; out[8] = 0.5462742152960396 * (xx - yy);
  out[9] = -0.5900435899266435 * y * (3 * xx - yy); out[10] = 2.890611442640554 * x * y * z;
  out[11] = -0.4570457994644658 * y * (5 * zz - 1); out[12] = 0.3731763325901154 * z * (5 * zz - 3);
  out[13] = -0.4570457994644658 * x * (5 * zz - 1); out[14] = 1.445305721320277 * z * (xx - yy); out[15] = -0.5900435899266435 * x * (xx - 3 * yy);
}
