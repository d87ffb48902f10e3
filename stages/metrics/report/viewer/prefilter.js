// A latitude-longitude map as the layers that light.glsl looks up: one per roughness, weights D(h) (n.l), and the irradiance
// that enters a body. As pipeline/shading/prefilter.py, on octahedral maps.

// Solid-angle means [3 n] of a map {width, height, data} in the texels of an octahedron of `size`.
function onOctahedron(map, size) {
  const sum = new Float64Array(3 * size * size), angle = new Float64Array(size * size);
  const sub = Math.max(1, Math.ceil(Math.sqrt(8 * size * size / (map.width * map.height))));
  for (let j = 0; j < map.height * sub; j++) {
    const theta = (j + 0.5) * Math.PI / (map.height * sub), y = Math.cos(theta), s = Math.sin(theta);
    for (let k = 0; k < map.width * sub; k++) {
      const phi = (k + 0.5) * 2 * Math.PI / (map.width * sub);
      const [u, v] = folded([s * Math.sin(phi), y, -s * Math.cos(phi)]);
      const texel = Math.min(size - 1, Math.floor(v * size)) * size + Math.min(size - 1, Math.floor(u * size));
      const pixel = 3 * (Math.floor(j / sub) * map.width + Math.floor(k / sub));
      for (let c = 0; c < 3; c++) sum[3 * texel + c] += s * map.data[pixel + c];
      angle[texel] += s;
    }
  }
  return Float32Array.from(sum, (x, i) => x / Math.max(angle[Math.floor(i / 3)], 1e-12));
}

function halved(map, size) {
  const out = new Float32Array(3 * size * size / 4), {angle} = octahedron(size), half = size / 2;
  for (let j = 0; j < half; j++) for (let k = 0; k < half; k++) {
    let total = 0;
    const at = 3 * (j * half + k);
    for (const i of [2 * j * size + 2 * k, 2 * j * size + 2 * k + 1, (2 * j + 1) * size + 2 * k, (2 * j + 1) * size + 2 * k + 1]) {
      for (let c = 0; c < 3; c++) out[at + c] += angle[i] * map[3 * i + c];
      total += angle[i];
    }
    for (let c = 0; c < 3; c++) out[at + c] /= total;
  }
  return out;
}

// Means of a map of `from` texels a side under weight(cosine), in `to` texels a side; weight is 0 below `least`.
function convolved(map, from, to, weight, least) {
  const source = octahedron(from), target = octahedron(to).direction, out = new Float32Array(3 * to * to);
  const {direction, angle} = source;
  for (let i = 0; i < to * to; i++) {
    const x = target[3 * i], y = target[3 * i + 1], z = target[3 * i + 2];
    let total = 0, r = 0, g = 0, b = 0;
    for (let k = 0, j = 0; k < from * from; k++, j += 3) {
      const cosine = x * direction[j] + y * direction[j + 1] + z * direction[j + 2];
      if (cosine <= least) continue;
      const w = weight(cosine) * angle[k];
      total += w; r += w * map[j]; g += w * map[j + 1]; b += w * map[j + 2];
    }
    if (total > 0) { out[3 * i] = r / total; out[3 * i + 1] = g / total; out[3 * i + 2] = b / total; }
    else between(map, from, ...folded([x, y, z])).forEach((value, c) => { out[3 * i + c] = value; });
  }
  return out;
}

function lobeWeight(alpha, lobe) {
  const square = alpha * alpha;
  return cosine => {
    const c2 = (1 + cosine) / 2, tangent = (1 - c2) / c2;  // of the half vector
    return cosine * (lobe === 'beckmann' ? Math.exp(-tangent / square) : 1 / (1 + tangent / square) ** 2) / (c2 * c2);
  };
}

function enteringWeight(ior) {
  return c => {
    const q = Math.sqrt((ior - 1) * (ior + 1) + c * c), e2 = ior * ior;
    return c * 2 * c * q * (1 / (c + q) ** 2 + e2 / (e2 * c + q) ** 2);
  };
}

// {size, layers, scale, data: Uint16Array of RGBA half floats, one border texel} and the map's mean radiance.
function prefiltered(map, lobe, constants) {
  const size = constants.LIGHT_SIZE, sharp = onOctahedron(map, size), levels = [];
  const pyramid = {[size]: sharp};
  for (let s = size; s > 32; s /= 2) pyramid[s / 2] = halved(pyramid[s], s);
  for (const r of constants.LEVEL_ROUGHNESS) {
    const alpha = r * r, narrow = alpha < 0.02;  // narrower than a texel: the map itself
    // Beckmann's lobe ends at tan^2 = 12 alpha^2, where it is e^-12 of its peak.
    const least = lobe === 'beckmann' ? Math.max(0, 2 / (1 + 12 * alpha * alpha) - 1) : 0;
    const from = r < 0.25 ? size : r < 0.4 ? size / 2 : 32, to = r < 0.4 ? size / 2 : 32;
    levels.push(narrow ? [sharp, size] : [convolved(pyramid[from], from, to, lobeWeight(alpha, lobe), least), to]);
  }
  const total = Math.PI * constants.REFERENCE_ENTERING;
  levels.push([convolved(pyramid[32], 32, 32, enteringWeight(constants.REFERENCE_IOR), 0).map(x => x * total), 32]);
  const peak = levels.reduce((most, [level]) => level.reduce((a, b) => Math.max(a, b), most), 0);
  const scale = peak > 60000 ? peak / 60000 : 1;  // half floats end at 65504
  const wide = size + 2, data = new Uint16Array(4 * wide * wide * levels.length);
  let at = 0;
  for (const [level, own] of levels) for (let j = -1; j <= size; j++) for (let k = -1; k <= size; k++, at += 4) {
    const value = between(level, own, ...folded(unfolded((k + 0.5) / size, (j + 0.5) / size)));
    for (let c = 0; c < 3; c++) data[at + c] = halfOf(value[c] / scale);
    data[at + 3] = 0x3c00;
  }
  return {size: wide, layers: levels.length, scale, data, entering: meanOf(levels[levels.length - 1][0])};
}

const meanOf = level => level.reduce((a, b) => a + b, 0) / level.length;
