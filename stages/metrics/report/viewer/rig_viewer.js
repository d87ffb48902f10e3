// The viewer of a light stage: one drags the light over the picture, as in viewers of reflectance transformation images.
class RigViewer {
  static async open(root, scene) {
    const canvas = root.querySelector('canvas'), rig = await Rig.open(canvas, scene);
    if (!rig) return null;
    const viewer = new RigViewer();
    Object.assign(viewer, {
      root, scene, canvas, rig, middle: [0.5, 0.5], zoom: 1, pointer: null,
      state: {shown: 'relit', camera: 0, exposure: 0, x: -0.4, y: 0.4}});
    viewer.controls();
    viewer.listen();
    await viewer.useCamera(0);
    viewer.ready = true;
    return viewer;
  }

  part(name) { return this.root.querySelector(`[data-part="${name}"]`); }

  controls() {
    RIG_SHOWN.forEach((name, k) => this.part('shown').add(new Option(`${RIG_NAMES[name]}  (${k + 1})`, name)));
    this.scene.cameras.forEach((c, k) => this.part('camera').add(new Option(c.name, k)));
    for (const input of this.root.querySelectorAll('[data-set]'))
      input.addEventListener('input', () => this.set({[input.dataset.set]: input.dataset.set === 'shown' ? input.value : +input.value}));
    const calls = {frame: () => this.frame(), full: () => { document.fullscreenElement ? document.exitFullscreen() : this.root.requestFullscreen?.().catch(() => {}); }};
    for (const button of this.root.querySelectorAll('[data-call]')) button.onclick = calls[button.dataset.call];
  }

  set(changes) {
    const {state} = this;
    Object.assign(state, changes);
    const length = Math.hypot(state.x, state.y);
    if (length > 0.999) { state.x *= 0.999 / length; state.y *= 0.999 / length; }
    if (changes.camera !== undefined) this.useCamera(changes.camera);
    this.request();
  }

  async useCamera(k) {
    const made = await this.rig.camera(this.scene.cameras[k]);
    if (made.entry.fits && !made.fits) made.fits = await FitCharts.open(made.entry.fits, this.scene);
    if (this.state.camera !== k) return;
    this.camera = made;
    this.chosen = null;
    this.part('fit').hidden = true;
    this.part('fit-note').hidden = !made.fits;
    this.request();
  }

  // The place of the picture (in its pixels) under a pointer.
  placeOf(event) {
    const box = this.canvas.getBoundingClientRect(), [u, v, across, down] = this.window(), [w, h] = this.camera.entry.size;
    return [w * (u + across * (2 * (event.clientX - box.left) / box.width - 1)), h * (v + down * (2 * (event.clientY - box.top) / box.height - 1))];
  }

  // Shows what was fitted to the kept pixel that is nearest.
  pick(event) {
    if (!this.camera?.fits) return;
    const {fits, entry} = this.camera, k = fits.nearest(...this.placeOf(event)), {charts, fitted} = fits.draw(k);
    const at = [fits.at[2 * k], fits.at[2 * k + 1]], [row, column] = [1, 0].map(c => Math.round(entry.corner[1 - c] + entry.step * at[c]));
    this.chosen = at;
    this.part('fit-charts').replaceChildren(...charts);
    this.part('fit-text').textContent = `${entry.name}, column ${column}, row ${row}: σ ${digits(fitted.slice(0, 2))}, specular albedo ${fitted[2].toFixed(3)}, diffuse albedo ${fitted[3].toFixed(3)}`;
    this.part('fit').hidden = false;
    this.request();
  }

  frame() { this.middle = [0.5, 0.5]; this.zoom = 1; this.request(); }

  // Middle and half size of the screen in shares of the picture.
  window() {
    const [w, h] = this.camera.entry.size, {width, height} = this.canvas, scale = Math.min(width / w, height / h) * this.zoom;
    return [...this.middle, width / (2 * scale * w), height / (2 * scale * h)];
  }

  direction() {
    const {x, y} = this.state, [right, up, back] = this.camera.entry.axes;
    return add(add(scaled(right, x), scaled(up, y)), scaled(back, Math.sqrt(Math.max(0, 1 - x * x - y * y))));
  }

  request() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }

  draw() {
    if (!this.camera) return;
    const {canvas, state} = this, ratio = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
    this.rig.draw({camera: this.camera, state, window: this.window(), direction: this.direction()});
    for (const input of this.root.querySelectorAll('[data-set]')) input.value = state[input.dataset.set];
    this.part('exposure-text').textContent = `${state.exposure >= 0 ? '+' : ''}${state.exposure.toFixed(1)} EV`;
    this.part('light-text').textContent = `${Math.round(Math.asin(Math.hypot(state.x, state.y)) * 180 / Math.PI)}° off the view`;
    const spot = this.part('spot'), size = Math.min(canvas.clientWidth, canvas.clientHeight) / 2;
    spot.style.left = `${canvas.clientWidth / 2 + state.x * size}px`;
    spot.style.top = `${canvas.clientHeight / 2 - state.y * size}px`;
    const mark = this.part('picked'), [u, v, across, down] = this.window();
    mark.hidden = !this.chosen;
    if (this.chosen) {
      const [w, h] = this.camera.entry.size, x = (this.chosen[0] + 0.5) / w, y = (this.chosen[1] + 0.5) / h;
      mark.style.left = `${canvas.clientWidth * ((x - u) / across + 1) / 2}px`;
      mark.style.top = `${canvas.clientHeight * ((y - v) / down + 1) / 2}px`;
    }
    if (this.pointer) this.readOut();
  }

  lightAt(event) {
    const box = this.canvas.getBoundingClientRect(), size = Math.min(box.width, box.height) / 2;
    this.set({x: (event.clientX - box.left - box.width / 2) / size, y: -(event.clientY - box.top - box.height / 2) / size});
  }

  // By shares of the screen's shorter side.
  pan(x, y) {
    const [, , across, down] = this.window(), {width, height} = this.canvas, size = Math.min(width, height);
    this.middle = [this.middle[0] - 2 * across * x * size / width, this.middle[1] - 2 * down * y * size / height];
    this.request();
  }

  listen() {
    const step = 0.05, {canvas} = this, zoom = factor => { this.zoom = Math.max(0.5, Math.min(40, this.zoom / factor)); this.request(); };
    listen(canvas, {
      drag: (x, y, event) => this.lightAt(event), pan: (x, y) => this.pan(x, y), zoom, frame: () => this.frame(), tap: event => this.pick(event),
      hover: event => { this.pointer = event; if (event && this.camera) this.readOut(); else this.part('values').replaceChildren(); }});
    const arrows = {ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step]}, {state} = this;
    const count = this.scene.cameras.length, keys = {
      '+': () => zoom(0.9), '=': () => zoom(0.9), '-': () => zoom(1 / 0.9), f: () => this.frame(),
      e: () => this.set({exposure: state.exposure + 0.25}), E: () => this.set({exposure: state.exposure - 0.25}),
      '.': () => this.set({camera: (state.camera + 1) % count}), ',': () => this.set({camera: (state.camera + count - 1) % count}),
      v: () => { this.pointer = this.centre(); this.readOut(); }, p: () => this.pick(this.centre())};
    canvas.addEventListener('keydown', event => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const number = '123456789'.indexOf(event.key), arrow = arrows[event.key];
      if (arrow && event.shiftKey) this.pan(arrow[0], -arrow[1]);
      else if (arrow) this.set({x: state.x + arrow[0], y: state.y + arrow[1]});
      else if (number >= 0) this.set({shown: RIG_SHOWN[number]});
      else if (keys[event.key]) keys[event.key]();
      else return;
      event.preventDefault();
    });
    new ResizeObserver(() => this.request()).observe(canvas);
  }

  // The middle of the screen, as a pointer there.
  centre() {
    const box = this.canvas.getBoundingClientRect();
    return {clientX: box.left + box.width / 2, clientY: box.top + box.height / 2};
  }

  readOut() {
    const {entry, images} = this.camera, [x, y] = this.placeOf(this.pointer), [w, h] = entry.size;
    const i = 4 * (Math.floor(y) * w + Math.floor(x)), there = x >= 0 && x < w && y >= 0 && y < h && images.normal_d[i + 3] > 0;
    this.part('values').replaceChildren(...(there ? rigValuesOf(images, i) : []));
  }
}
