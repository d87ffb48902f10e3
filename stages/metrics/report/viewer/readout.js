// Words: names of the views, the values under the pointer with their units, and what a colour means.
const NAMES = {
  relit: 'relit', diffuse: 'body (diffuse)', specular: 'mirrored (specular)', albedo: 'albedo', normal: 'normals',
  roughness: 'roughness', ior: 'index of refraction', splats: 'splats under the captured light', dolp: 'degree of polarisation', aolp: 'angle of polarisation'};

const digits = (values, count = 3) => values.map(x => x.toFixed(count)).join('  ');
const figures = values => values.map(x => x.toPrecision(3)).join('  ');

function line(term, text) {
  const dt = document.createElement('dt'), dd = document.createElement('dd');
  dt.textContent = term;
  dd.textContent = text;
  return [dt, dd];
}

function valuesOf(v, world) {
  const turned = p => world.map(row => dot(row, p));
  return [
    ...line('radiance R G B', figures(v.s0)),
    ...line('DoLP, AoLP', `${(100 * v.dolp).toFixed(1)} %, ${((v.aolp + 180) % 180).toFixed(0)}°`),
    ...line('albedo R G B', digits(v.albedo)), ...line('roughness, α', digits([v.roughness, v.roughness ** 2])),
    ...line('IoR', v.ior.toFixed(3)), ...line('normal x y z', digits(turned(v.normal), 2)),
    ...line('position x y z', figures(turned(v.position)))];
}

function legendOf(shown, scales) {
  const stops = anchors => `linear-gradient(90deg, ${anchors.map(c => `rgb(${c})`).join(', ')})`;
  const bar = (from, to, gradient, note) => {
    const out = document.createElement('i');
    out.style.background = gradient;
    return [from, out, note ? `${to} ${note}` : to];
  };
  const hues = [0, 30, 60, 90, 120, 150, 180].map(a => [0, 2, 4].map(k => Math.round(255 * (0.55 + 0.45 * Math.cos(2 * a * Math.PI / 180 + k * Math.PI / 3)))));
  return {
    dolp: bar('0', `${100 * scales.dolp} %`, stops(scales.inferno)), aolp: bar('0°', '180°', stops(hues), 'from the picture’s x axis'),
    roughness: bar('0', '1', stops(scales.viridis)), ior: bar(scales.ior[0], scales.ior[1], stops(scales.viridis)),
    normal: ['(n + 1) / 2 in the world’s axes'], albedo: ['diffuse reflectance, sRGB']}[shown] || [];
}

const RIG_NAMES = {
  relit: 'relit by the light', diffuse: 'body (diffuse)', specular: 'mirrored (specular)', albedo: 'diffuse albedo', specular_albedo: 'specular albedo, 0 to 1',
  diffuse_normal: 'diffuse normals', specular_normal: 'specular normals', sigma_larger: 'larger σ, 0 to 0.6', sigma_smaller: 'smaller σ, 0 to 0.6'};

function rigValuesOf(images, i) {
  const three = name => [...images[name].subarray(i, i + 3)], fourth = name => images[name][i + 3];
  return [
    ...line('diffuse albedo R G B', digits(three('albedo'))), ...line('specular albedo', fourth('albedo').toFixed(3)),
    ...line('σ larger, smaller', digits([fourth('normal_s'), fourth('tangent')])),
    ...line('diffuse normal', digits(three('normal_d'), 2)), ...line('specular normal', digits(three('normal_s'), 2)),
    ...line('tangent', digits(three('tangent'), 2))];
}
