// SPDX-License-Identifier: Apache-2.0
// From values to pixels on the screen: the display transform of `tempera video` (libs/frames/src/display.cpp), and
// false colors for error maps.

const clamp = (v, low, high) => (v < low ? low : v > high ? high : v);
const luminance = (r, g, b) => 0.2127 * r + 0.7152 * g + 0.0722 * b;

const linearToSrgb = (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);
const srgbToLinear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);

/** Linear [0,1] to an sRGB byte by table; entries are even in the square root, which follows the curve closely. */
const srgbTable = (() => {
  const table = new Uint8Array(16385);
  for (let i = 0; i <= 16384; ++i) table[i] = Math.floor(linearToSrgb((i / 16384) ** 2) * 255 + 0.5);
  return (v) => (v > 0 ? table[v < 1 ? (Math.sqrt(v) * 16384 + 0.5) | 0 : 16384] : 0);
})();

/** S. Hill's fit of the ACES transforms, scaled so that 18 % gray keeps its place; see display.cpp. */
function filmic(r, g, b, out) {
  const scene = (v) => 1.458 * (v > 0 ? Math.min(v, 1e6) : 0);
  const curve = (v) => (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.432951) + 0.238081);
  const sr = scene(r), sg = scene(g), sb = scene(b);
  const x = curve(0.59719 * sr + 0.35458 * sg + 0.04823 * sb);
  const y = curve(0.076 * sr + 0.90834 * sg + 0.01566 * sb);
  const z = curve(0.0284 * sr + 0.13383 * sg + 0.83777 * sb);
  out[0] = 1.60475 * x - 0.53108 * y - 0.07367 * z;
  out[1] = -0.10208 * x + 1.10813 * y - 0.00605 * z;
  out[2] = -0.00327 * x - 0.07276 * y + 1.07602 * z;
}

/** A display transform: exposure in stops and "srgb", "filmic" or "none". */
class ToneMap {
  constructor(exposure, kind) {
    this.exposure = exposure;
    this.kind = kind;
    this.scale = 2 ** exposure;
    this.tables = new Map();
    this.scratch = [0, 0, 0];
  }

  /** Byte of one channel; of "srgb" and "none" alone, whose channels do not mix. */
  byte(value) {
    const v = value * this.scale;
    return this.kind === "srgb" ? srgbTable(v) : v > 0 ? Math.floor(Math.min(v, 1) * 255 + 0.5) : 0;
  }

  /** Byte of each code of pictures with this value table. */
  bytesOf(table) {
    let bytes = this.tables.get(table);
    if (!bytes) {
      bytes = new Uint8Array(65536);
      for (let i = 0; i < 65536; ++i) bytes[i] = this.byte(table[i]);
      this.tables.set(table, bytes);
    }
    return bytes;
  }

  /** Writes RGBA of a color at out[at...]. */
  put(r, g, b, out, at) {
    if (this.kind === "filmic") {
      const s = this.scratch;
      filmic(r * this.scale, g * this.scale, b * this.scale, s);
      out[at] = srgbTable(s[0]);
      out[at + 1] = srgbTable(s[1]);
      out[at + 2] = srgbTable(s[2]);
    } else {
      out[at] = this.byte(r);
      out[at + 1] = this.byte(g);
      out[at + 2] = this.byte(b);
    }
    out[at + 3] = 255;
  }

  /** Fills RGBA bytes with a whole picture. */
  paint(picture, out) {
    const { codes, table, channels } = picture;
    const pixels = picture.width * picture.height;
    const gOffset = channels === 3 ? pixels : 0, bOffset = channels === 3 ? 2 * pixels : 0;
    if (this.kind === "filmic") {
      for (let i = 0; i < pixels; ++i) {
        this.put(table[codes[i] & 0xffff], table[codes[gOffset + i] & 0xffff], table[codes[bOffset + i] & 0xffff], out,
          4 * i);
      }
      return;
    }
    const bytes = this.bytesOf(table);
    for (let i = 0, at = 0; i < pixels; ++i, at += 4) {
      out[at] = bytes[codes[i] & 0xffff];
      out[at + 1] = bytes[codes[gOffset + i] & 0xffff];
      out[at + 2] = bytes[codes[bOffset + i] & 0xffff];
      out[at + 3] = 255;
    }
  }
}

// --- False colors ----------------------------------------------------------------------------------------------------

/** Oklab (B. Ottosson 2020) to sRGB bytes; steps that are even in it look even. */
function oklabToSrgb([lightness, a, b]) {
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ].map((v) => Math.round(255 * linearToSrgb(clamp(v, 0, 1))));
}

/** 256 RGB entries through the given [lightness, chroma, hue in degrees], evenly spaced. */
function colorRamp(stops) {
  const lab = stops.map(([l, c, h]) => [l, c * Math.cos((h * Math.PI) / 180), c * Math.sin((h * Math.PI) / 180)]);
  const table = new Uint8Array(256 * 3);
  for (let i = 0; i < 256; ++i) {
    const at = (i / 255) * (lab.length - 1), k = Math.min(Math.floor(at), lab.length - 2), f = at - k;
    table.set(oklabToSrgb(lab[k].map((v, c) => v + f * (lab[k + 1][c] - v))), 3 * i);
  }
  return table;
}

/** From black over blue, magenta and orange to a light yellow: lightness grows evenly with the value. */
const sequentialRamp = colorRamp([
  [0.1, 0.02, 285], [0.27, 0.13, 292], [0.43, 0.18, 328], [0.59, 0.2, 20], [0.76, 0.16, 62], [0.96, 0.09, 100],
]);
/** Blue below 0, almost black at 0, orange above. */
const divergingRamp = colorRamp([
  [0.93, 0.05, 210], [0.68, 0.14, 245], [0.42, 0.13, 262], [0.16, 0.0, 0], [0.45, 0.13, 35], [0.7, 0.16, 55],
  [0.95, 0.08, 95],
]);
/** What has no value, and what is not finite, in a map. */
const NO_VALUE_COLOR = [38, 42, 46];

/** How values of a map become places on a ramp: {low, high, scale: "log" | "linear" | "signed"}. */
function rampPosition(range) {
  if (range.scale === "log") {
    const low = Math.log(range.low), factor = 255 / (Math.log(range.high) - low);
    return (v) => clamp((Math.log(v) - low) * factor, 0, 255);
  }
  const low = range.scale === "signed" ? -range.high : range.low;
  const factor = 255 / (range.high - low);
  return (v) => clamp((v - low) * factor, 0, 255);
}

const rampOf = (range) => (range.scale === "signed" ? divergingRamp : sequentialRamp);

/** Fills RGBA bytes with the false colors of `values`. */
function paintMap(values, range, out) {
  const position = rampPosition(range), ramp = rampOf(range);
  for (let i = 0, at = 0; i < values.length; ++i, at += 4) {
    const v = values[i];
    if (v === v) {
      const k = 3 * Math.round(position(v));
      out[at] = ramp[k];
      out[at + 1] = ramp[k + 1];
      out[at + 2] = ramp[k + 2];
    } else {
      out[at] = NO_VALUE_COLOR[0];
      out[at + 1] = NO_VALUE_COLOR[1];
      out[at + 2] = NO_VALUE_COLOR[2];
    }
    out[at + 3] = 255;
  }
}

/** CSS gradient of a ramp, for legends. */
function rampGradient(range) {
  const ramp = rampOf(range), stops = [];
  for (let i = 0; i <= 16; ++i) {
    const k = 3 * Math.round((i * 255) / 16);
    stops.push(`rgb(${ramp[k]},${ramp[k + 1]},${ramp[k + 2]})`);
  }
  return `linear-gradient(to right, ${stops.join(", ")})`;
}

/** A number for people: four significant digits, exponents where they are shorter. */
function formatNumber(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  if (value === 0) return "0";
  const magnitude = Math.abs(value);
  const text = magnitude < 1e-3 || magnitude >= 1e5 ? value.toExponential(digits - 1) : value.toPrecision(digits);
  return text.replaceAll("-", "−").replace("e+", "e");
}
