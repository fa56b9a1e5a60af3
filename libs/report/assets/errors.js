// SPDX-License-Identifier: Apache-2.0
// Maps of errors. Most are computed here from the stored values, between any two sequences; metrics whose maps are more
// than a formula over a pixel (FLIP, SSIM) come with the page, against the reference alone.

/** Mean over channels of f(k). */
const meanOfChannels = (f) => (f(0) + f(1) + f(2)) / 3;

/**
 * What can be shown instead of the picture. Those with the id of a metric (docs/metrics.md) are its values per pixel.
 * `base`: compared with another sequence; `before`: looks at the frame before; `motion`: along motion vectors;
 * `measured`: offered only if the metric was measured; `of(c)`: makes the values, NaN where there is none, from
 *   c.test, c.base               pictures of the frame
 *   c.testBefore, c.baseBefore   those of the frame before
 *   c.source(i)                  [x, y] in the frame before of what pixel i shows, null where that is not known
 *   c.epsilon
 */
const FORMULA_MAPS = [
  {
    id: "relmse",
    title: "relMSE",
    help: "squared difference over squared base + epsilon, mean over channels",
    base: true,
    range: { low: 1e-4, high: 10, scale: "log" },
    of: (c) => eachPixel(c.test, (i) => meanOfChannels((k) => {
      const b = c.base.value(k, i);
      return difference(c.test, c.test.value(k, i), c.base, b) ** 2 / (b * b + c.epsilon);
    })),
  },
  {
    id: "relmse_gray",
    title: "relMSE, gray",
    help: "mean of squared differences over the squared mean of the base's channels + 0.001",
    base: true,
    measured: true,
    range: { low: 1e-4, high: 10, scale: "log" },
    of: (c) => eachPixel(c.test, (i) => {
      const gray = meanOfChannels((k) => c.base.value(k, i));
      const error = meanOfChannels((k) => difference(c.test, c.test.value(k, i), c.base, c.base.value(k, i)) ** 2);
      return error / (gray * gray + 1e-3);
    }),
  },
  {
    id: "mse",
    title: "MSE",
    help: "squared difference, mean over channels",
    base: true,
    range: { low: 1e-5, high: 1, scale: "log" },
    of: (c) => eachPixel(c.test, (i) =>
      meanOfChannels((k) => difference(c.test, c.test.value(k, i), c.base, c.base.value(k, i)) ** 2)),
  },
  {
    id: "signed",
    title: "brighter / darker",
    help: "difference of luminance relative to the base: orange where the picture is brighter, blue where it is darker",
    base: true,
    range: { low: -1, high: 1, scale: "signed" },
    of: (c) => {
      const floor = Math.sqrt(c.epsilon);
      return eachPixel(c.test, (i) => {
        const b = luminanceAt(c.base, i);
        return difference(c.test, luminanceAt(c.test, i), c.base, b) / (Math.abs(b) + floor);
      });
    },
  },
  ...[false, true].map((motion) => ({
    id: motion ? "temporal_compensated" : "temporal",
    title: motion ? "temporal error along motion" : "temporal error",
    help: `squared error of the change since the frame before${motion ? " along motion vectors" : ""}, over the ` +
      "mean of the squared bases + epsilon",
    base: true,
    before: true,
    motion,
    range: { low: 1e-4, high: 10, scale: "log" },
    of: (c) => eachPixel(c.test, (i) => {
      const p = c.source(i);
      if (!p) return NaN;
      return meanOfChannels((k) => {
        const b = c.base.value(k, i), before = bilinear(c.baseBefore, k, p);
        const test = difference(c.test, c.test.value(k, i), c.testBefore, bilinear(c.testBefore, k, p));
        const d = test - difference(c.base, b, c.baseBefore, before);
        return (d * d) / ((b * b + before * before) / 2 + c.epsilon);
      });
    }),
  })),
  {
    id: "warp_error",
    title: "warp error",
    help: "squared change along motion vectors, over the mean of the squared bases + epsilon",
    base: true,
    before: true,
    motion: true,
    measured: true,
    range: { low: 1e-4, high: 10, scale: "log" },
    of: (c) => eachPixel(c.test, (i) => {
      const p = c.source(i);
      if (!p) return NaN;
      return meanOfChannels((k) => {
        const b = c.base.value(k, i), before = bilinear(c.baseBefore, k, p);
        const d = difference(c.test, c.test.value(k, i), c.testBefore, bilinear(c.testBefore, k, p));
        return (d * d) / ((b * b + before * before) / 2 + c.epsilon);
      });
    }),
  },
  {
    id: "flicker_static",
    title: "change of luminance",
    help: "absolute difference of luminance to the frame before",
    before: true,
    measured: true,
    range: { low: 1e-4, high: 1, scale: "log" },
    of: (c) => eachPixel(c.test, (i) =>
      Math.abs(difference(c.test, luminanceAt(c.test, i), c.testBefore, luminanceAt(c.testBefore, i)))),
  },
  ...[false, true].map((motion) => ({
    id: motion ? "change_compensated" : "change",
    title: motion ? "change along motion" : "change since last frame",
    help: `relative change of luminance since the frame before${motion ? " along motion vectors" : ""}, of one ` +
      "sequence alone: flicker shows up here",
    before: true,
    motion,
    range: { low: -1, high: 1, scale: "signed" },
    of: (c) => {
      const floor = Math.sqrt(c.epsilon);
      return eachPixel(c.test, (i) => {
        const p = c.source(i);
        if (!p) return NaN;
        const now = luminanceAt(c.test, i), then = luminance(...[0, 1, 2].map((k) => bilinear(c.testBefore, k, p)));
        return difference(c.test, now, c.testBefore, then) / (0.5 * (Math.abs(now) + Math.abs(then)) + floor);
      });
    },
  })),
];

const luminanceAt = (picture, i) => luminance(picture.value(0, i), picture.value(1, i), picture.value(2, i));

/** Value of a channel at a position (pixels, centers at +0.5), between pixels; positions are clamped to the picture. */
function bilinear(picture, k, [px, py]) {
  const { width, height } = picture;
  const x = clamp(px - 0.5, 0, width - 1), y = clamp(py - 0.5, 0, height - 1);
  const x0 = Math.floor(x), y0 = Math.floor(y), fx = x - x0, fy = y - y0;
  const i = y0 * width + x0, right = fx > 0 ? 1 : 0, down = fy > 0 ? width : 0;
  if (!right && !down) return picture.value(k, i);
  const above = picture.value(k, i) * (1 - fx) + picture.value(k, i + right) * fx;
  return above * (1 - fy) + (picture.value(k, i + down) * (1 - fx) + picture.value(k, i + down + right) * fx) * fy;
}

/** a - b of two pictures' values; 0 where it is no more than what storing them can have caused. */
function difference(pictureA, a, pictureB, b) {
  const d = a - b;
  return Math.abs(d) <= pictureA.tolerance(a) + pictureB.tolerance(b) ? 0 : d;
}

function eachPixel(picture, value) {
  const out = new Float32Array(picture.width * picture.height);
  for (let i = 0; i < out.length; ++i) out[i] = value(i);
  return out;
}

/**
 * Where vectors lead from a position (pixels, centers at +0.5), as in the metrics (libs/stages/src/temporal.cpp): null
 * where one of the four vectors around it is missing, where they lead out of the picture, and where `back`, the vectors
 * of the other frame, does not lead back: what was there is hidden [Sundaram 2010].
 */
function followVectors(vectors, back, position) {
  const { width, height } = vectors;
  const v = vectors.bilinear(position);
  if (!v) return null;
  const to = [position[0] + v[0], position[1] + v[1]];
  if (!(to[0] >= 0 && to[1] >= 0 && to[0] < width && to[1] < height)) return null;
  if (!back) return to;
  const b = back.bilinear(to);
  if (!b) return null;
  const gap = (v[0] + b[0]) ** 2 + (v[1] + b[1]) ** 2;
  return gap <= 0.01 * (v[0] ** 2 + v[1] ** 2 + b[0] ** 2 + b[1] ** 2) + 0.5 ? to : null;
}

/** The smallest distance between two frames. */
const frameStep = (frames) => frames.slice(1).reduce((step, f, i) => Math.min(step, f - frames[i]), Infinity);

/** All maps of a report: the formulas that its sequences allow, then those that came with it. */
function mapsOf(data) {
  const metric = (id) => data.metrics.find((m) => m.id === id);
  const formulas = FORMULA_MAPS.filter((m) =>
    (!m.base || data.sides.length > 1) && (!m.before || data.frames.length > 1) &&
    (!m.motion || data.motion.backward.length > 0) && (!m.measured || metric(m.id)))
    .map((m) => ({ ...m, title: metric(m.id)?.title ?? m.title }));
  const stored = data.maps.map((m) => ({ ...m, stored: true, range: { low: m.low, high: m.high, scale: m.scale } }));
  return [...formulas, ...stored];
}

/** The values of a map as a Float32Array, or null if the pictures that it needs are not there. */
async function computeMap(store, map, { side, base, frame }, urgent = true) {
  const { data } = store;
  if (map.stored) {
    const picture = await store.map(map.id, side, frame, urgent);
    return picture && eachPixel(picture, (i) => picture.value(0, i));
  }
  // The frame before stands one step away; vectors lead to the frame numbered one less.
  const step = frameStep(data.frames), before = frame - step;
  if (map.before && (!data.frames.includes(before) || (map.motion && step !== 1))) return null;
  const none = Promise.resolve(null);
  const [test, basis, testBefore, baseBefore, backward, forward] = await Promise.all([
    store.picture(side, frame, urgent),
    map.base ? store.picture(base, frame, urgent) : none,
    map.before ? store.picture(side, before, urgent) : none,
    map.before && map.base ? store.picture(base, before, urgent) : none,
    map.motion ? store.motion("backward", frame, urgent) : none,
    map.motion ? store.motion("forward", before, urgent) : none,
  ]);
  if (!test || (map.base && !basis) || (map.before && !testBefore) || (map.before && map.base && !baseBefore) ||
    (map.motion && !backward)) return null;
  const { width } = data, center = (i) => [(i % width) + 0.5, Math.floor(i / width) + 0.5];
  const source = map.motion ? (i) => followVectors(backward, forward, center(i)) : center;
  return map.of({ test, base: basis, testBefore, baseBefore, source, epsilon: data.epsilon });
}
