// Vectors [3], and matrices [16] by columns as WebGL takes them.
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const minus = (a, b) => add(a, scaled(b, -1));
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => scaled(a, 1 / Math.hypot(...a));

function multiplied(a, b) {
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++)
    for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
  return out;
}

// World to camera (looking along -z) of rows right, up, back [3] each and the camera's centre.
function viewMatrix(right, up, back, eye) {
  return new Float32Array([
    right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
}

// focal: [x, y] in half screens at distance 1; middle: the axis' place on the screen, -1..1.
function projectionMatrix(focal, middle, near, far) {
  return new Float32Array([
    focal[0], 0, 0, 0, 0, focal[1], 0, 0, -middle[0], -middle[1], (far + near) / (near - far), -1,
    0, 0, 2 * far * near / (near - far), 0]);
}

// Clip space to the world, of a projection by projectionMatrix and a view by viewMatrix.
function inverse(projection, view) {
  const p = projection, inverseP = new Float32Array([
    1 / p[0], 0, 0, 0, 0, 1 / p[5], 0, 0, 0, 0, 0, 1 / p[14], p[8] / p[0], p[9] / p[5], -1, p[10] / p[14]]);
  const v = view, rows = [[v[0], v[4], v[8]], [v[1], v[5], v[9]], [v[2], v[6], v[10]]];
  const eye = [0, 1, 2].map(k => -(v[4 * k] * v[12] + v[4 * k + 1] * v[13] + v[4 * k + 2] * v[14]));
  return multiplied(new Float32Array([...rows[0], 0, ...rows[1], 0, ...rows[2], 0, ...eye, 1]), inverseP);
}
