// Radiance .hdr files, run-length coded or flat, as {width, height, data: linear RGB}; and rgbe pixels of the page.
function radianceOf(pixels) {
  const out = new Float32Array(pixels.length / 4 * 3);
  for (let i = 0, j = 0; i < pixels.length; i += 4, j += 3) {
    const scale = pixels[i + 3] ? 2 ** (pixels[i + 3] - 136) : 0;
    for (let c = 0; c < 3; c++) out[j + c] = (pixels[i + c] + 0.5) * scale;
  }
  return out;
}

function readHdr(bytes) {
  let at = 0;
  const line = () => { let text = ''; while (at < bytes.length && bytes[at] !== 10) text += String.fromCharCode(bytes[at++]); at++; return text.trim(); };
  if (!line().startsWith('#?')) throw new Error('this is no Radiance .hdr file');
  for (let text = line(); text; text = line()) if (text.startsWith('FORMAT=') && !text.includes('rgbe')) throw new Error('its colours are not RGBE: save it as RGB');
  const size = /^-Y (\d+) \+X (\d+)$/.exec(line());
  if (!size) throw new Error('its rows do not run from the top left: save it again');
  const height = +size[1], width = +size[2];
  if (width !== 2 * height) throw new Error(`it is ${width} × ${height}: a latitude-longitude map is twice as wide as high`);
  const pixels = new Uint8Array(4 * width * height);
  for (let row = 0; row < height; row++) {
    const coded = bytes[at] === 2 && bytes[at + 1] === 2 && ((bytes[at + 2] << 8) | bytes[at + 3]) === width && width >= 8 && width < 32768;
    if (!coded) { pixels.set(bytes.subarray(at, at + 4 * width), 4 * row * width); at += 4 * width; continue; }
    at += 4;
    for (let c = 0; c < 4; c++) for (let k = 0; k < width;) {
      let count = bytes[at++];
      const same = count > 128;
      if (same) count -= 128;
      if (!count || k + count > width) throw new Error('the file is damaged');
      for (const end = k + count; k < end; k++) pixels[4 * (row * width + k) + c] = bytes[same ? at : at++];
      if (same) at++;
    }
    if (at > bytes.length) throw new Error('the file ends too early');
  }
  if (at > bytes.length) throw new Error('the file ends too early');
  return {width, height, data: radianceOf(pixels)};
}
