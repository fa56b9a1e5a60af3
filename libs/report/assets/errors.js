// SPDX-License-Identifier: Apache-2.0
// Maps of errors. Most are computed here from the stored values, between any two sequences; metrics whose maps are more
// than a formula over a pixel (FLIP, SSIM) come with the page, against the reference alone.

/**
 * What can be shown instead of the picture. `base`: compared with another sequence; `before`: looks at the frame
 * before; `of(c)`: makes the values, NaN where there is none, from
 *   c.test, c.base               pictures of the frame
 *   c.testBefore, c.baseBefore   those of the frame before
 *   c.backward                   vectors to the frame before, or null: differences in time are then taken in place
 *   c.epsilon
 */
const FORMULA_MAPS = [
  {
    id: "relmse",
    title: "relMSE",
    help: "squared difference over squared base + epsilon, mean over channels",
    base: true,
    range: { low: 1e-4, high: 10, scale: "log" },
    of: (c) => eachPixel(c.test, (i) => {
      let sum = 0;
      for (let k = 0; k < 3; ++k) {
        const b = c.base.value(k, i), d = difference(c.test, c.test.value(k, i), c.base, b);
        sum += (d * d) / (b * b + c.epsilon);
      }
      return sum / 3;
    }),
  },
  {
    id: "mse",
    title: "MSE",
    help: "squared difference, mean over channels",
    base: true,
    range: { low: 1e-5, high: 1, scale: "log" },
    of: (c) => eachPixel(c.test, (i) => {
      let sum = 0;
      for (let k = 0; k < 3; ++k) sum += difference(c.test, c.test.value(k, i), c.base, c.base.value(k, i)) ** 2;
      return sum / 3;
    }),
  },
  {
    id: "signed",
    title: "brighter / darker",
    help: "difference of luminance relative to the base: orange where the picture is brighter, blue where it is darker",
    base: true,
    range: { low: 0, high: 1, scale: "signed" },
    of: (c) => {
      const floor = Math.sqrt(c.epsilon);
      return eachPixel(c.test, (i) => {
        const b = luminanceAt(c.base, i);
        return difference(c.test, luminanceAt(c.test, i), c.base, b) / (Math.abs(b) + floor);
      });
    },
  },
  {
    id: "temporal",
    title: "temporal error",
    help: "squared error of the change since the frame before, over squared base + epsilon, mean over channels",
    base: true,
    before: true,
    range: { low: 1e-4, high: 10, scale: "log" },
    of: (c) => {
      const source = sourceBefore(c);
      return eachPixel(c.test, (i) => {
        const j = source(i);
        if (j < 0) return NaN;
        let sum = 0;
        for (let k = 0; k < 3; ++k) {
          const b = c.base.value(k, i);
          const d = difference(c.test, c.test.value(k, i), c.testBefore, c.testBefore.value(k, j)) -
            difference(c.base, b, c.baseBefore, c.baseBefore.value(k, j));
          sum += (d * d) / (b * b + c.epsilon);
        }
        return sum / 3;
      });
    },
  },
  {
    id: "change",
    title: "change since last frame",
    help: "relative change of luminance since the frame before, of one sequence alone: what flickers shows up here",
    before: true,
    range: { low: 0, high: 1, scale: "signed" },
    of: (c) => {
      const source = sourceBefore(c), floor = Math.sqrt(c.epsilon);
      return eachPixel(c.test, (i) => {
        const j = source(i);
        if (j < 0) return NaN;
        const now = luminanceAt(c.test, i), then = luminanceAt(c.testBefore, j);
        return difference(c.test, now, c.testBefore, then) / (0.5 * (Math.abs(now) + Math.abs(then)) + floor);
      });
    },
  },
];

const luminanceAt = (picture, i) => luminance(picture.value(0, i), picture.value(1, i), picture.value(2, i));

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

/** From a pixel to where the frame before shows what it shows, by index; -1 where that is not known. */
function sourceBefore(c) {
  if (!c.backward) return (i) => i;
  const { width, height } = c.test;
  return (i) => {
    const vector = c.backward.at(i);
    if (!vector) return -1;
    const x = Math.floor((i % width) + 0.5 + vector[0]), y = Math.floor(Math.floor(i / width) + 0.5 + vector[1]);
    return x >= 0 && y >= 0 && x < width && y < height ? y * width + x : -1;
  };
}

/** All maps of a report: the formulas that its sequences allow, then those that came with it. */
function mapsOf(data) {
  const maps = FORMULA_MAPS.filter((m) => (!m.base || data.sides.length > 1) && (!m.before || data.frames.length > 1));
  const stored = data.maps.map((m) => ({ ...m, stored: true, range: { low: m.low, high: m.high, scale: m.scale } }));
  return [...maps, ...stored];
}

/** The values of a map as a Float32Array, or null if the pictures that it needs are not there. */
async function computeMap(store, map, { side, base, frame, compensate }, urgent = true) {
  const { data } = store;
  if (map.stored) {
    const picture = await store.map(map.id, side, frame, urgent);
    return picture && eachPixel(picture, (i) => picture.value(0, i));
  }
  const before = data.frames[data.frames.indexOf(frame) - 1];
  if (map.before && before === undefined) return null;
  const none = Promise.resolve(null);
  const [test, basis, testBefore, baseBefore, backward] = await Promise.all([
    store.picture(side, frame, urgent),
    map.base ? store.picture(base, frame, urgent) : none,
    map.before ? store.picture(side, before, urgent) : none,
    map.before && map.base ? store.picture(base, before, urgent) : none,
    // Vectors lead to the frame numbered one less, which is not the one before in every sequence.
    map.before && compensate && before === frame - 1 ? store.motion("backward", frame, urgent) : none,
  ]);
  if (!test || (map.base && !basis) || (map.before && !testBefore) || (map.before && map.base && !baseBefore)) return null;
  return map.of({ test, base: basis, testBefore, baseBefore, backward, epsilon: data.epsilon });
}
