// SPDX-License-Identifier: Apache-2.0
// Unpacks the images that the page carries. libs/report/src/picture_code.cpp packs them; docs/report.md states the
// format.

/** Code of a value that was not finite, and of a vector that is not valid. */
const NOT_FINITE = -32768;

function bytesOfBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; ++i) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/**
 * Undoes the prediction of one channel: `low` and `high` are the bytes of its residuals, `out` receives its codes.
 * The arithmetic is modulo 2^16, which storing into an Int16Array does.
 */
function restorePlane(low, high, out, width, height, gradient) {
  for (let y = 0, i = 0; y < height; ++y) {
    for (let x = 0; x < width; ++x, ++i) {
      let prediction = 0;
      if (y === 0) {
        if (x > 0) prediction = out[i - 1];
      } else if (x === 0) {
        prediction = out[i - width];
      } else {
        const w = out[i - 1], n = out[i - width], nw = out[i - width - 1];
        if (gradient) {
          const least = w < n ? w : n, most = w < n ? n : w;
          prediction = nw >= most ? least : nw <= least ? most : w + n - nw;
        } else {
          const ne = x + 1 < width ? out[i - width + 1] : n;
          prediction = (w + n + nw + ne + 2) >> 2;
        }
      }
      out[i] = (low[i] | (high[i] << 8)) - 0x8080 + prediction;
    }
  }
}

const valueTables = new Map();

/** The value of each code, at index `code & 0xffff`. */
function valueTable(steps, toe) {
  const key = `${steps}/${toe}`;
  let table = valueTables.get(key);
  if (!table) {
    table = new Float32Array(65536);
    for (let code = 1; code < 32768; ++code) {
      const value = Math.min(toe * (2 ** (code / steps) - 1), 3.4028234e38);  // the largest float
      table[code] = value;
      table[65536 - code] = -value;
    }
    table[NOT_FINITE & 0xffff] = NaN;
    valueTables.set(key, table);
  }
  return table;
}

/** An image as codes, one channel after another, and the table of their values. */
class Picture {
  constructor(width, height, channels, codes, steps, toe) {
    this.width = width;
    this.height = height;
    this.channels = channels;
    this.codes = codes;
    this.table = valueTable(steps, toe);
    this.toe = toe;
    this.relativeError = 2 ** (0.5 / steps) - 1;
  }

  /** How far a value can be from the one that was stored: half a step of the code. */
  tolerance(value) {
    return this.relativeError * (Math.abs(value) + this.toe);
  }

  get bytes() {
    return this.codes.byteLength;
  }

  /** Value of channel `c` at pixel index `i`; gray images have one value for all channels. */
  value(c, i) {
    return this.table[this.codes[(c < this.channels ? c : 0) * this.width * this.height + i] & 0xffff];
  }

  rgb(i) {
    return [this.value(0, i), this.value(1, i), this.value(2, i)];
  }
}

/** Motion vectors in pixels. */
class Vectors {
  constructor(width, height, codes, step) {
    this.width = width;
    this.height = height;
    this.codes = codes;
    this.step = step;
  }

  get bytes() {
    return this.codes.byteLength;
  }

  /** [x, y] at pixel index `i`, or null where there is no vector. */
  at(i) {
    const x = this.codes[i], y = this.codes[this.width * this.height + i];
    return x === NOT_FINITE || y === NOT_FINITE ? null : [x * this.step, y * this.step];
  }

  /** [x, y] at a position (pixels, centers at +0.5), between pixels; null where one of those around it has none. */
  bilinear([px, py]) {
    const { width, height } = this;
    const x = Math.min(Math.max(px - 0.5, 0), width - 1), y = Math.min(Math.max(py - 0.5, 0), height - 1);
    const x0 = Math.floor(x), y0 = Math.floor(y), fx = x - x0, fy = y - y0;
    const i = y0 * width + x0, right = fx > 0 ? 1 : 0, down = fy > 0 ? width : 0;
    const corners = [this.at(i), this.at(i + right), this.at(i + down), this.at(i + down + right)];
    if (corners.includes(null)) return null;
    const [a, b, c, d] = corners;
    return [0, 1].map((k) => (a[k] * (1 - fx) + b[k] * fx) * (1 - fy) + (c[k] * (1 - fx) + d[k] * fx) * fy);
  }
}

/** Decodes a block element of the page. */
async function decodeBlock(element, width, height) {
  const { channels, gradient, steps, toe, step } = element.dataset;
  const planes = Number(channels), pixels = width * height;
  const bytes = await inflate(bytesOfBase64(element.textContent));
  if (bytes.length !== pixels * planes * 2) throw new Error(`${element.id} does not hold ${width}x${height} pixels`);
  const codes = new Int16Array(pixels * planes);
  const plane = (c) => codes.subarray(c * pixels, (c + 1) * pixels);
  for (let c = 0; c < planes; ++c) {
    const low = bytes.subarray(c * 2 * pixels, (c * 2 + 1) * pixels);
    const high = bytes.subarray((c * 2 + 1) * pixels, (c * 2 + 2) * pixels);
    restorePlane(low, high, plane(c), width, height, gradient === "1");
  }
  if (step) return new Vectors(width, height, codes, Number(step));
  if (planes === 3) {
    const r = plane(0), g = plane(1), b = plane(2);
    for (let i = 0; i < pixels; ++i) {
      r[i] += g[i];
      b[i] += g[i];
    }
  }
  return new Picture(width, height, planes, codes, Number(steps), Number(toe));
}
