// The viewer of a model: state, controls, gestures, keys.
class ModelViewer {
  static async open(root, scene) {
    const canvas = root.querySelector('canvas'), model = await Model.open(canvas, scene);
    if (!model) return null;
    const viewer = new ModelViewer();
    const low = scene.surface.low, high = scene.surface.high;
    Object.assign(viewer, {
      root, scene, canvas, model, orbit: new Orbit(low, high), lights: [...scene.lights], pace: new Pace(), moving: false, pointer: null,
      state: {shown: 'relit', light: 0, turn: 0, exposure: Math.log2(scene.gain), sky: false, polariser: null, wipe: 0.5, camera: -1}});
    viewer.controls();
    viewer.listen();
    await viewer.useLight(0);
    return viewer;
  }

  part(name) { return this.root.querySelector(`[data-part="${name}"]`); }

  controls() {
    const shown = this.part('shown'), camera = this.part('camera');
    SHOWN.forEach((name, k) => shown.add(new Option(`${NAMES[name]}  (${k + 1})`, name)));
    if (this.scene.splats) shown.add(new Option(`${NAMES[LIT]}  (0)`, LIT));
    camera.add(new Option('free', -1));
    const strip = this.part('strip');
    this.scene.cameras.forEach((c, k) => {
      camera.add(new Option(c.test ? `${c.name} (test view)` : c.name, k));
      const button = document.createElement('button'), image = new Image();
      Object.assign(image, {src: c.picture, alt: '', loading: 'lazy'});
      Object.assign(button, {type: 'button', title: `photograph ${c.name}`, onclick: () => this.set({camera: k})});
      button.append(image);
      strip.append(button);
    });
    this.listLights();
    for (const input of this.root.querySelectorAll('[data-set]')) input.addEventListener('input', () => this.set({[input.dataset.set]: this.valueOf(input)}));
    const calls = {frame: () => this.frame(), auto: () => this.autoExposure(), full: () => this.fullScreen(), file: () => this.part('hdr').click()};
    for (const button of this.root.querySelectorAll('[data-call]')) button.onclick = calls[button.dataset.call];
    this.part('hdr').onchange = event => this.drop(event.target.files[0]);
  }

  valueOf(input) {
    if (input.type === 'checkbox') return input.dataset.set === 'polariser' ? (input.checked ? 0 : null) : input.checked;
    return input.dataset.set === 'shown' ? input.value : +input.value;
  }

  listLights() {
    const list = this.part('light');
    list.replaceChildren(...this.lights.map((l, k) => new Option(l.title, k)));
    list.value = this.state.light;
  }

  // Changes some of the state, the controls with it, and draws.
  set(changes) {
    const {state} = this, before = state.camera, lit = changes.light;
    if (changes.turn !== undefined) changes.turn = ((changes.turn + 180) % 360 + 360) % 360 - 180;
    Object.assign(state, changes);
    if (before >= 0 && state.camera < 0) this.orbit.standAt(this.scene.cameras[before]);
    if (state.camera >= 0 && state.camera !== before) this.useCamera();
    if (lit !== undefined) this.useLight(lit);
    this.show();
    this.request();
  }

  // The state on the controls.
  show() {
    const {state} = this;
    for (const input of this.root.querySelectorAll('[data-set]')) {
      const value = state[input.dataset.set];
      if (input.type === 'checkbox') input.checked = input.dataset.set === 'polariser' ? value !== null : value;
      else if (value !== null) input.value = value;
      if (input.dataset.set === 'polariser' && input.type === 'range') input.disabled = value === null;
    }
    const say = (name, text) => { this.part(name).textContent = text; };
    say('turn-text', `${Math.round(state.turn)}°`);
    say('exposure-text', `${state.exposure >= 0 ? '+' : ''}${state.exposure.toFixed(1)} EV`);
    say('polariser-text', state.polariser === null ? 'out' : `${Math.round(state.polariser)}°`);
    this.part('wipe-row').hidden = this.part('wipe').hidden = state.camera < 0;
    this.part('wipe').style.left = `${100 * state.wipe}%`;
    [...this.part('strip').children].forEach((b, k) => b.setAttribute('aria-pressed', k === state.camera));
    this.part('legend').replaceChildren(...legendOf(state.shown, this.scene.scales));
  }

  async useLight(k) {
    const light = this.lights[k];
    this.status(this.model.lights.has(light.name) ? '' : 'preparing the light …');
    await new Promise(done => setTimeout(done, 30));  // the words are drawn first
    const made = await this.model.light(light);
    if (this.state.light !== k) return;
    this.light = made;
    this.status('');
    this.show();
    this.request();
  }

  async useCamera() {
    const k = this.state.camera, camera = this.scene.cameras[k];
    this.photograph = null;
    this.state.polariser = camera.angle;
    const made = await this.model.photograph(camera);
    if (this.state.camera === k) { this.photograph = made; this.show(); this.request(); }
  }

  place() {
    const {canvas, state, orbit} = this;
    return state.camera < 0 ? orbit.matrices(canvas.width, canvas.height)
      : capturedMatrices(this.scene.cameras[state.camera], orbit, canvas.width, canvas.height);
  }

  // Draws soon: when the frame before is through.
  request() {
    this.wanted = true;
    if (!this.busy) { this.busy = true; requestAnimationFrame(() => this.draw()); }
  }

  draw() {
    this.wanted = false;
    if (!this.light) { this.busy = false; return; }
    const {canvas, model, moving, state} = this, {gl} = model, {scale, coarse} = moving ? this.pace.moving() : this.pace.resting();
    const ratio = (window.devicePixelRatio || 1) > 1.5 && scale > 1 ? devicePixelRatio : (window.devicePixelRatio || 1) * scale;
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
    this.view = {place: this.place(), state, light: this.light, photograph: state.camera >= 0 ? this.photograph : null, coarse};
    model.draw(this.view);
    if (this.pointer && !moving) this.readOut();
    const began = performance.now(), fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const wait = () => {
      if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED && performance.now() - began < 3000) { requestAnimationFrame(wait); return; }
      gl.deleteSync(fence);
      if (moving) this.pace.took(performance.now() - began);
      this.busy = false;
      if (this.wanted) this.request();
    };
    requestAnimationFrame(wait);
  }

  // Something is being dragged: as finely as frames keep coming, and finely when it stops.
  move(change) {
    this.moving = true;
    clearTimeout(this.rest);
    this.rest = setTimeout(() => { this.moving = false; this.request(); }, 250);
    if (this.state.camera >= 0) this.set({camera: -1});
    change(this.orbit);
    this.request();
  }

  frame() { this.move(orbit => orbit.frame()); }

  // The surface of mean albedo under the mean of this light is mid grey.
  autoExposure() { this.set({exposure: Math.log2(0.2 * Math.PI / Math.max(this.light.entering * this.scene.surface.mean_albedo, 1e-9))}); }

  fullScreen() { document.fullscreenElement ? document.exitFullscreen() : this.root.requestFullscreen?.().catch(() => {}); }

  async drop(file) {
    if (!file) return;
    try {
      const map = readHdr(new Uint8Array(await file.arrayBuffer()));
      this.lights.push({name: `dropped ${this.lights.length}`, title: file.name, map});
    } catch (error) { this.status(`${file.name}: ${error.message}`); return; }
    this.listLights();
    this.set({light: this.lights.length - 1, sky: true});
    this.autoExposure();
  }

  status(text) { this.part('status').textContent = text; }

  readOut() {
    const box = this.canvas.getBoundingClientRect(), {canvas, model} = this;
    const x = (this.pointer.clientX - box.left) / box.width * canvas.width, y = (box.bottom - this.pointer.clientY) / box.height * canvas.height;
    const found = model.probe && model.probe.at(this.view, x, y);
    this.part('values').replaceChildren(...(found ? valuesOf(found, this.scene.world_from_view) : []));
  }
}
