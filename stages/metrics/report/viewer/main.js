// Starts what the page has; where WebGL 2 or inflating is missing the viewer stays hidden and the page is whole without it.
async function start() {
  enlargeable();
  const data = document.getElementById('viewer-scene'), root = document.getElementById('viewer');
  if (!data || !window.DecompressionStream || !window.WebGL2RenderingContext) return;
  root.hidden = false;
  const scene = JSON.parse(data.textContent), kind = scene.kind === 'rig' ? RigViewer : ModelViewer;
  const viewer = await kind.open(root, scene).catch(() => null);
  if (viewer) root.viewer = viewer;
  else root.hidden = true;
}
start();
