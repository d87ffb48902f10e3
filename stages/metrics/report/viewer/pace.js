// How finely to draw while something moves, so that frames keep coming: screen pixels a side per pixel of the page, and whether
// the coarse triangles do. Fast machines go up the list, software renderers down.
const PACES = [{scale: 2, coarse: false}, {scale: 1.5, coarse: false}, {scale: 1, coarse: false}, {scale: 1, coarse: true}, {scale: 0.75, coarse: true}, {scale: 0.5, coarse: true}];
const SLOW_MS = 36, FAST_MS = 20;

class Pace {
  constructor() { this.at = 2; this.quick = 0; }
  moving() { return PACES[this.at]; }
  resting() { return PACES[this.at <= 2 ? 0 : 1]; }

  took(ms) {
    this.quick = ms < FAST_MS ? this.quick + 1 : 0;
    if (ms > SLOW_MS) this.at = Math.min(PACES.length - 1, this.at + (ms > 3 * SLOW_MS ? 2 : 1));
    else if (this.quick > 8) { this.at = Math.max(0, this.at - 1); this.quick = 0; }
  }
}

// Triangles [3 n] whose corners are moved to one vertex in each cell of a grid of `cells` along the box (vertex clustering,
// Rossignac and Borrel 1993); position: uint16 of the box, extent: its sides.
function coarseTriangles(position, index, extent, cells) {
  const longest = Math.max(...extent), sides = extent.map(x => x / longest * cells / 65536), first = new Map(), seen = new Set();
  const of = new Uint32Array(position.length / 3).map((_, v) => {
    const [a, b, c] = sides.map((side, k) => Math.floor(position[3 * v + k] * side)), cell = (a * 1024 + b) * 1024 + c;
    if (!first.has(cell)) first.set(cell, v);
    return first.get(cell);
  });
  const out = [];
  for (let i = 0; i < index.length; i += 3) {
    const [a, b, c] = [of[index[i]], of[index[i + 1]], of[index[i + 2]]];
    const key = [a, b, c].sort((x, y) => x - y).join();
    if (a === b || b === c || a === c || seen.has(key)) continue;
    seen.add(key);
    out.push(a, b, c);
  }
  return new index.constructor(out);
}
