// Packed arrays of the page (packing.py) as typed arrays; half floats.
const KINDS = {int8: Int8Array, uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array, int16: Int16Array, float32: Float32Array};

async function unpack(entry) {
  const raw = Uint8Array.from(atob(entry.data), c => c.charCodeAt(0));
  const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new KINDS[entry.kind](await new Response(stream).arrayBuffer());
}

const oneFloat = new Float32Array(1), itsBits = new Uint32Array(oneFloat.buffer);

// The nearest half float of a number from 0 to 65504, as its bits.
function halfOf(x) {
  oneFloat[0] = Math.min(x, 65504);
  const bits = itsBits[0], exponent = (bits >>> 23) - 112;
  if (exponent <= 0) return Math.round(oneFloat[0] * 16777216);  // below 2^-14: steps of 2^-24
  return Math.min(((exponent << 10) | ((bits >>> 13) & 1023)) + ((bits >>> 12) & 1), 31743);
}

function floatOf(half) {
  const exponent = (half >>> 10) & 31, mantissa = half & 1023, sign = half & 32768 ? -1 : 1;
  return sign * (exponent ? (1 + mantissa / 1024) * 2 ** (exponent - 15) : mantissa * 2 ** -24);
}
