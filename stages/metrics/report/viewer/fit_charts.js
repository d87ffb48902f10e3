// What one pixel measured under every light and what was fitted to it, as two charts: mirrored light against the angle of the half
// vector to the lobe's normal, and body light against the cosine to the diffuse normal.
const CHART = {width: 420, height: 230, left: 50, right: 12, top: 12, bottom: 38};
const FAINT = 0.02;  // of a lobe's peak: where its chart ends, with as much again beside it

class FitCharts {
  static async open(entry, scene) {
    const made = new FitCharts(), {nothing} = scene, pairs = async packed => {
      const raw = await unpack(packed);
      return k => raw[2 * k] === nothing ? [0, 0, 0] : unit(unfolded((raw[2 * k] / 32767 + 1) / 2, (raw[2 * k + 1] / 32767 + 1) / 2));
    };
    const halves = async packed => { const raw = await unpack(packed); return i => floatOf(raw[i]); };
    Object.assign(made, {
      at: await unpack(entry.at), count: entry.at.shape[0], lights: scene.lights.shape[0], angles: scene.angles, light: await pairs(scene.lights),
      normalD: await pairs(entry.diffuse_normal), normalS: await pairs(entry.specular_normal), tangent: await pairs(entry.tangent), view: await pairs(entry.view),
      fit: await halves(entry.fit), body: await halves(entry.body), mirrored: entry.mirrored && await halves(entry.mirrored),
      curves: entry.curves && await halves(entry.curves)});
    return made;
  }

  // The pixel nearest to a place of the picture (in its pixels).
  nearest(x, y) {
    let best = 0, least = Infinity;
    for (let k = 0; k < this.count; k++) {
      const far = Math.hypot(this.at[2 * k] + 0.5 - x, this.at[2 * k + 1] + 0.5 - y);
      if (far < least) { least = far; best = k; }
    }
    return best;
  }

  draw(k) {
    const fitted = [0, 1, 2, 3].map(c => this.fit(4 * k + c)), out = [this.bodyChart(k, fitted[3])];
    if (this.mirrored) out.unshift(this.lobeChart(k));
    return {charts: out, fitted};
  }

  lobeChart(k) {
    const n = this.normalS(k), t = this.tangent(k), o = this.view(k), count = this.angles.length, dots = [];
    const anisotropic = dot(t, t) > 0.5, curve = row => this.angles.map((a, j) => [a, this.curves((2 * k + row) * count + j)]);
    const curves = [curve(0), ...(this.fit(4 * k) > 1.02 * this.fit(4 * k + 1) ? [curve(1)] : [])], peak = Math.max(...curves.flat().map(p => p[1]), 1e-6);
    const reach = Math.max(...curves.flat().filter(p => p[1] > FAINT * peak).map(p => p[0]), 3), last = Math.min(90, 1.6 * reach);
    for (let i = 0; i < this.lights; i++) {
      const h = unit(add(this.light(i), o)), angle = Math.acos(Math.min(1, Math.max(-1, dot(h, n)))) * 180 / Math.PI;
      const along = anisotropic ? (dot(h, t) / Math.max(Math.hypot(...minus(h, scaled(n, dot(h, n)))), 1e-6)) ** 2 : 1;
      if (dot(this.light(i), n) > 0) dots.push([angle, this.mirrored(k * this.lights + i), along > 0.5 ? 'var(--a)' : 'var(--b)']);
    }
    return chart(dots, curves, [0, last], 'angle of the half vector to the normal (degrees)', 'mirrored / irradiance (1/sr)');
  }

  bodyChart(k, albedo) {
    const n = this.normalD(k), dots = [];
    for (let i = 0; i < this.lights; i++) {
      const cosine = dot(n, this.light(i));
      if (cosine > -0.2) dots.push([cosine, this.body(k * this.lights + i), 'var(--a)']);
    }
    return chart(dots, [[[-0.2, 0], [0, 0], [1, albedo]]], [-0.2, 1], 'cosine between the diffuse normal and the light', 'body light / white surface’s');
  }
}

function element(name, attributes, text) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

// Round numbers that cover low to high.
function ticks(low, high) {
  const raw = (high - low) / 5, base = 10 ** Math.floor(Math.log10(raw)), step = base * [1, 2, 2.5, 5, 10].find(m => m * base >= raw), out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(+(k * step).toPrecision(6));
  return out;
}

// dots [x, y, colour]; curves of points [x, y], the second dashed; x from and to.
function chart(dots, curves, [from, to], across, up) {
  const {width, height, left, right, top, bottom} = CHART, shown = dots.filter(d => d[0] >= from && d[0] <= to);
  const values = [...shown.map(d => d[1]), ...curves.flat().filter(p => p[0] <= to).map(p => p[1])], high = 1.06 * Math.max(...values, 1e-6), low = Math.min(0, ...values);
  const px = x => left + (x - from) / (to - from) * (width - left - right), py = y => height - bottom - (y - low) / (high - low) * (height - top - bottom);
  const svg = element('svg', {viewBox: `0 0 ${width} ${height}`, class: 'chart', role: 'img', 'aria-label': `${up} against ${across}`});
  for (const x of ticks(from, to)) svg.append(element('text', {x: px(x), y: height - bottom + 15, 'text-anchor': 'middle'}, x));
  for (const y of ticks(low, high)) svg.append(
    element('line', {x1: left, x2: width - right, y1: py(y), y2: py(y), class: 'grid'}), element('text', {x: left - 6, y: py(y) + 4, 'text-anchor': 'end'}, y));
  svg.append(element('text', {x: (left + width - right) / 2, y: height - 6, 'text-anchor': 'middle'}, across));
  svg.append(element('text', {x: -(top + height - bottom) / 2, y: 11, transform: 'rotate(-90)', 'text-anchor': 'middle'}, up));
  for (const [x, y, colour] of shown) svg.append(element('circle', {cx: px(x).toFixed(1), cy: py(y).toFixed(1), r: 2, fill: colour, 'fill-opacity': 0.65}));
  curves.forEach((points, k) => svg.append(element('polyline', {
    points: points.filter(p => p[0] <= to).map(([x, y]) => `${px(x).toFixed(1)},${py(y).toFixed(1)}`).join(' '), fill: 'none',
    stroke: k ? 'var(--b)' : 'var(--ink)', 'stroke-width': 1.6, ...(k ? {'stroke-dasharray': '5 3'} : {})})));
  return svg;
}
