// Mouse, touch and pen on a canvas: one finger or the left button drags, two fingers or the right button pan, pinch and wheel zoom,
// two taps frame. Calls drag(dx, dy, event), pan(dx, dy), zoom(factor), frame(), hover(event | null) and, where it is there, tap(event);
// lengths in shares of the shorter side.
function listen(canvas, calls) {
  const down = new Map();
  let tapped = 0, moved = 0;
  const size = () => Math.min(canvas.clientWidth, canvas.clientHeight);
  const spread = () => { const [a, b] = [...down.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };

  canvas.addEventListener('pointerdown', event => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, {x: event.clientX, y: event.clientY});
    moved = down.size > 1 ? 100 : 0;
  });
  canvas.addEventListener('pointermove', event => {
    const last = down.get(event.pointerId);
    if (!last) { calls.hover(event); return; }
    const dx = (event.clientX - last.x) / size(), dy = (event.clientY - last.y) / size(), before = down.size === 2 ? spread() : 0;
    Object.assign(last, {x: event.clientX, y: event.clientY});
    moved += (Math.abs(dx) + Math.abs(dy)) * size();
    if (down.size === 2) {
      calls.zoom(before / Math.max(spread(), 1));
      calls.pan(dx / 2, dy / 2);
    } else if (event.buttons & 6 || event.shiftKey) calls.pan(dx, dy);
    else calls.drag(dx, dy, event);
  });
  const up = event => {
    if (!down.delete(event.pointerId) || moved > 8 || event.type === 'pointercancel') return;
    calls.hover(event);
    calls.tap?.(event);
    if (event.timeStamp - tapped < 350) { calls.frame(); tapped = 0; } else tapped = event.timeStamp;
  };
  canvas.addEventListener('pointerup', up);
  canvas.addEventListener('pointercancel', up);
  canvas.addEventListener('pointerleave', () => { if (!down.size) calls.hover(null); });
  canvas.addEventListener('contextmenu', event => event.preventDefault());
  canvas.addEventListener('wheel', event => {
    event.preventDefault();
    calls.zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaMode ? 16 * event.deltaY : event.deltaY)) * 0.0025));
  }, {passive: false});
}
