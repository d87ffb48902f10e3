// Gestures, keys and files of the model's viewer.
ModelViewer.prototype.listen = function () {
  const {canvas} = this, step = 0.06, turn = 2 * Math.PI / 1.6;
  listen(canvas, {
    drag: (x, y) => this.move(o => o.turn(-x * turn, y * turn)), pan: (x, y) => this.move(o => o.pan(x, y)),
    zoom: factor => this.move(o => o.zoom(factor)), frame: () => this.frame(),
    hover: event => { this.pointer = event; if (event && this.view) this.readOut(); else this.part('values').replaceChildren(); }});
  const step_through = by => {
    const count = this.scene.cameras.length;
    if (count) this.set({camera: ((this.state.camera < 0 && by < 0 ? 0 : this.state.camera) + by + count) % count});
  };
  const {state} = this, keys = {
    ArrowLeft: () => this.move(o => o.turn(-step, 0)), ArrowRight: () => this.move(o => o.turn(step, 0)),
    ArrowUp: () => this.move(o => o.turn(0, step)), ArrowDown: () => this.move(o => o.turn(0, -step)),
    '+': () => this.move(o => o.zoom(0.9)), '=': () => this.move(o => o.zoom(0.9)), '-': () => this.move(o => o.zoom(1 / 0.9)),
    f: () => this.frame(), '[': () => this.set({turn: state.turn - 5}), ']': () => this.set({turn: state.turn + 5}),
    e: () => this.set({exposure: state.exposure + 0.25}), E: () => this.set({exposure: state.exposure - 0.25}),
    a: () => this.autoExposure(), l: () => this.set({light: (state.light + 1) % this.lights.length}),
    b: () => this.set({sky: !state.sky}), '.': () => step_through(1), ',': () => step_through(-1), Escape: () => this.set({camera: -1}),
    w: () => this.set({wipe: Math.min(1, state.wipe + 0.05)}), W: () => this.set({wipe: Math.max(0, state.wipe - 0.05)}),
    p: () => this.set({polariser: state.polariser === null ? 0 : null}),
    '>': () => this.set({polariser: ((state.polariser || 0) + 5) % 180}), '<': () => this.set({polariser: ((state.polariser || 0) + 175) % 180}),
    v: () => this.readMiddle()};
  const panned = {ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step]};
  canvas.addEventListener('keydown', event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const number = '123456789'.indexOf(event.key), pan = event.shiftKey && panned[event.key];
    if (pan) this.move(o => o.pan(...pan));
    else if (number >= 0) this.set({shown: SHOWN[number]});
    else if (event.key === '0' && this.model.splats) this.set({shown: LIT});
    else if (keys[event.key]) keys[event.key]();
    else return;
    event.preventDefault();
  });
  this.dragWipe();
  this.takeFiles();
  new ResizeObserver(() => this.request()).observe(canvas);
};

// The values at the middle of the picture, for who has no pointer; away with them if they are shown.
ModelViewer.prototype.readMiddle = function () {
  if (this.pointer) { this.pointer = null; this.part('values').replaceChildren(); return; }
  const box = this.canvas.getBoundingClientRect();
  this.pointer = {clientX: box.left + box.width / 2, clientY: box.top + box.height / 2};
  this.readOut();
};

ModelViewer.prototype.dragWipe = function () {
  const handle = this.part('wipe');
  handle.addEventListener('pointerdown', event => { handle.setPointerCapture(event.pointerId); event.preventDefault(); });
  handle.addEventListener('pointermove', event => {
    if (!handle.hasPointerCapture(event.pointerId)) return;
    const box = this.canvas.getBoundingClientRect();
    this.set({wipe: Math.max(0, Math.min(1, (event.clientX - box.left) / box.width))});
  });
};

ModelViewer.prototype.takeFiles = function () {
  const {root} = this;
  root.addEventListener('dragover', event => { event.preventDefault(); root.classList.add('dropping'); });
  root.addEventListener('dragleave', () => root.classList.remove('dropping'));
  root.addEventListener('drop', event => { event.preventDefault(); root.classList.remove('dropping'); this.drop(event.dataTransfer.files[0]); });
};
