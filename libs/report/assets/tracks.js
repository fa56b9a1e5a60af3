// SPDX-License-Identifier: Apache-2.0
// A pixel over time, in place or along motion vectors, and slices through space and time [Manzi 2016, Fig. 10].

/**
 * Where the surface that is at `position` (pixels, centers at +0.5) in frame `from` is in the neighboring frame `to`:
 * by the vectors of `from` if it has some, else by those of `to`, solved for the point that leads here. Null where the
 * vectors do not tell, where the surface is hidden and where it leaves the picture.
 */
async function follow(store, position, from, to) {
  if (Math.abs(to - from) !== 1) return null;  // vectors lead to the next frame number
  const there = to > from ? "forward" : "backward", back = to > from ? "backward" : "forward";
  const [direct, inverse] = await Promise.all([store.motion(there, from), store.motion(back, to)]);
  if (direct) return followVectors(direct, inverse, position);
  if (!inverse) return null;
  const { width, height } = store.data;
  const inside = ([x, y]) => x >= 0 && y >= 0 && x < width && y < height;
  let next = position;
  for (let i = 0; i < 8; ++i) {
    const vector = inside(next) ? inverse.bilinear(next) : null;
    if (!vector) return null;
    const better = [position[0] - vector[0], position[1] - vector[1]];
    const moved = Math.hypot(better[0] - next[0], better[1] - next[1]);
    next = better;
    if (moved < 0.25) return inside(next) ? next : null;
  }
  return null;
}

/**
 * Position of a pixel in each frame of the report, null where it is not known; in place unless `tracked`, which
 * follows the motion from frame `origin` both ways.
 * DEVIATION [Manzi 2016, Fig. 10]: positions add up before they are rounded, as vectors below half a pixel would
 * otherwise never move the slice, and rounding errors accumulate.
 */
async function trackPixel(store, [x, y], origin, tracked) {
  const { frames } = store.data;
  const start = [x + 0.5, y + 0.5];
  if (!tracked) return frames.map(() => start);
  const positions = frames.map(() => null);
  const first = Math.max(0, frames.indexOf(origin));
  positions[first] = start;
  for (const step of [1, -1]) {
    for (let i = first; positions[i] && frames[i + step] !== undefined; i += step) {
      positions[i + step] = await follow(store, positions[i], frames[i], frames[i + step]);
    }
  }
  return positions;
}

const pixelOf = (position) => position && [Math.floor(position[0]), Math.floor(position[1])];

/**
 * The values around a track: for each frame `length` pixels of a column (or row) around the tracked one, or all of it
 * for length 0. `series` [frames] holds the [r, g, b] of the tracked pixel, null where there is none; `values`
 * [length, frames, 3] the slice, NaN where there is nothing. `advance(i)` is called after each frame.
 */
async function sliceAlong(store, side, positions, { length, axis }, isCurrent = () => true, advance = () => {}) {
  const { frames, width, height } = store.data;
  const extent = axis === "row" ? width : height;
  const size = length || extent;
  const values = new Float32Array(size * frames.length * 3).fill(NaN);
  const series = frames.map(() => null);
  for (let f = 0; f < frames.length; ++f) {
    const picture = positions[f] && (await store.picture(side, frames[f]));
    if (!isCurrent()) return null;
    if (!picture) continue;
    const [x, y] = pixelOf(positions[f]);
    series[f] = picture.rgb(y * width + x);
    const begin = length ? (axis === "row" ? x : y) - Math.floor(size / 2) : 0;
    for (let k = 0; k < size; ++k) {
      const at = begin + k;
      if (at < 0 || at >= extent) continue;
      const i = axis === "row" ? y * width + at : at * width + x;
      for (let c = 0; c < 3; ++c) values[(k * frames.length + f) * 3 + c] = picture.value(c, i);
    }
    advance(f);
  }
  return { size, series, values };
}
