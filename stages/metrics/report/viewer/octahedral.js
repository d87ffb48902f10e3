// Maps over all directions on the unfolded octahedron, y its axis: size x size texels, row by row.
function unfolded(u, v) {  // u, v in 0..1, a little outside too: across the border the map is turned about its middle
  if (u < 0 || u > 1) { u = u < 0 ? -u : 2 - u; v = 1 - v; }
  if (v < 0 || v > 1) { v = v < 0 ? -v : 2 - v; u = 1 - u; }
  let x = 2 * u - 1, z = 2 * v - 1;
  const y = 1 - Math.abs(x) - Math.abs(z);
  if (y < 0) [x, z] = [(1 - Math.abs(z)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (z < 0 ? -1 : 1)];
  return [x, y, z];  // on the octahedron, not on the sphere
}

function folded(d) {
  const s = Math.abs(d[0]) + Math.abs(d[1]) + Math.abs(d[2]), x = d[0] / s, z = d[2] / s;
  if (d[1] >= 0) return [(x + 1) / 2, (z + 1) / 2];
  return [((1 - Math.abs(z)) * (x < 0 ? -1 : 1) + 1) / 2, ((1 - Math.abs(x)) * (z < 0 ? -1 : 1) + 1) / 2];
}

// Unit directions [3 n] and solid angles [n] of the texels.
function octahedron(size) {
  const direction = new Float32Array(3 * size * size), angle = new Float32Array(size * size);
  for (let j = 0, i = 0; j < size; j++) for (let k = 0; k < size; k++, i++) {
    const p = unfolded((k + 0.5) / size, (j + 0.5) / size), length = Math.hypot(...p);
    for (let c = 0; c < 3; c++) direction[3 * i + c] = p[c] / length;
    angle[i] = 4 / (size * size * length ** 3);
  }
  return {direction, angle};
}

// A map of `size` sampled between its texels at (u, v), [3].
function between(map, size, u, v) {
  const x = u * size - 0.5, y = v * size - 0.5, i = Math.floor(x), j = Math.floor(y), out = [0, 0, 0];
  for (let dj = 0; dj < 2; dj++) for (let di = 0; di < 2; di++) {
    const weight = (di ? x - i : 1 - x + i) * (dj ? y - j : 1 - y + j);
    let [a, b] = [i + di, j + dj];
    if (a < 0 || a >= size) { a = Math.min(Math.max(a, 0), size - 1); b = size - 1 - b; }
    if (b < 0 || b >= size) { b = Math.min(Math.max(b, 0), size - 1); a = size - 1 - a; }
    for (let c = 0; c < 3; c++) out[c] += weight * map[3 * (b * size + a) + c];
  }
  return out;
}
