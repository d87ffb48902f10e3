// A camera that turns about a target, y up, and a captured camera in the same terms.
class Orbit {
  constructor(low, high) {
    this.middle = scaled(add(low, high), 0.5);
    this.radius = Math.hypot(...minus(high, low)) / 2 || 1;
    this.field = 35 * Math.PI / 180;  // across the screen's shorter side
    this.yaw = 0.6; this.pitch = 0.3;
    this.frame();
  }

  frame() { this.target = this.middle; this.distance = this.radius / Math.sin(this.field / 2); }
  turn(yaw, pitch) { this.yaw += yaw; this.pitch = Math.max(-1.55, Math.min(1.55, this.pitch + pitch)); }
  zoom(factor) { this.distance = Math.max(0.05 * this.radius, Math.min(40 * this.radius, this.distance * factor)); }

  axes() {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const back = [cp * sy, sp, cp * cy], right = [cy, 0, -sy];
    return {right, up: cross(back, right), back};
  }

  // Moves the target across the screen by shares of its shorter side.
  pan(x, y) {
    const {right, up} = this.axes(), size = 2 * this.distance * Math.tan(this.field / 2);
    this.target = add(this.target, add(scaled(right, -x * size), scaled(up, y * size)));
  }

  // {view, projection, eye, up} for a screen of width x height.
  matrices(width, height) {
    const {right, up, back} = this.axes(), eye = add(this.target, scaled(back, this.distance));
    const focal = 1 / Math.tan(this.field / 2), shorter = Math.min(width, height);
    return {
      eye, up, view: viewMatrix(right, up, back, eye),
      projection: projectionMatrix([focal * shorter / width, focal * shorter / height], [0, 0], ...this.depths(eye))};
  }

  depths(eye) {
    const away = Math.hypot(...minus(eye, this.middle));
    return [Math.max(away - 2 * this.radius, 0.005 * this.radius), away + 2 * this.radius];
  }

  // Takes the place of a captured camera: the same centre and direction, its roll left out.
  standAt(camera) {
    const {eye, back} = poseOf(camera), ahead = Math.max(dot(minus(eye, this.middle), back), 0.2 * this.radius);
    this.target = add(eye, scaled(back, -ahead));
    this.distance = ahead;
    this.yaw = Math.atan2(back[0], back[2]);
    this.pitch = Math.max(-1.55, Math.min(1.55, Math.asin(back[1])));
  }
}

function poseOf({rotation, translation}) {
  const [right, down, ahead] = rotation;
  const eye = [0, 1, 2].map(k => -(right[k] * translation[0] + down[k] * translation[1] + ahead[k] * translation[2]));
  return {right, up: scaled(down, -1), back: scaled(ahead, -1), eye};
}

// A captured camera on a screen of width x height: its whole image in the middle. `box`: the image's middle and half size there.
function capturedMatrices(camera, orbit, width, height) {
  const {right, up, back, eye} = poseOf(camera), [w, h] = camera.size, s = Math.min(width / w, height / h);
  const middle = [2 * s * (camera.middle[0] - w / 2) / width, -2 * s * (camera.middle[1] - h / 2) / height];
  const focal = [2 * s * camera.focal[0] / width, 2 * s * camera.focal[1] / height];
  return {
    eye, up, view: viewMatrix(right, up, back, eye), box: [0, 0, s * w / width, s * h / height],
    projection: projectionMatrix(focal, middle, ...orbit.depths(eye))};
}
