// SPDX-License-Identifier: Apache-2.0
// Line plots as SVG: axes, one line a sequence, a cursor at the current frame, values under the pointer.

const SVG = "http://www.w3.org/2000/svg";

function svg(name, attributes = {}, text = undefined) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/** Round numbers in [low, high], about `count` of them. */
function linearTicks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * ([1, 2, 5, 10].find((m) => m * power >= raw) ?? 10);
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; ++i) ticks.push(i * step);
  return ticks;
}

/** Powers of ten in [low, high], with 2 and 5 between them if they are few. */
function logTicks(low, high) {
  const ticks = [], decades = Math.log10(high / low);
  const factors = decades > 2.5 ? [1] : decades > 1 ? [1, 3] : [1, 2, 3, 5, 7];
  for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); ++e) {
    for (const f of factors) {
      const v = f * 10 ** e;
      if (v >= low * 0.999 && v <= high * 1.001) ticks.push(v);
    }
  }
  const stride = Math.ceil(ticks.length / 8);
  return ticks.filter((_, i) => i % stride === 0);
}

/** A number without the zeros at its end. */
const tickLabel = (v) => formatNumber(Number(v.toPrecision(6)), 3).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");

class Plot {
  /** `onPick(x)` is called with the nearest x of a click. */
  constructor(container, { height = 170, onPick = () => {} } = {}) {
    this.container = container;
    this.height = height;
    this.onPick = onPick;
    this.content = null;
    this.readout = document.createElement("div");
    this.readout.className = "plot-readout";
    this.svg = svg("svg", { class: "plot", height });
    container.append(this.svg, this.readout);
    new ResizeObserver(() => this.draw()).observe(container);
    this.svg.addEventListener("pointermove", (event) => this.hover(event));
    this.svg.addEventListener("pointerleave", () => this.showReadout(this.content?.cursor));
    this.svg.addEventListener("click", (event) => {
      const x = this.nearestX(event);
      if (x !== undefined) this.onPick(x);
    });
  }

  /**
   * content: { x: [numbers], lines: [{ label, color, dashed, values: [number|null] }], log, cursor, xLabel, yLabel }.
   * Values that are null break their line; with `log`, so do those that are not positive.
   */
  show(content) {
    this.content = content;
    this.draw();
  }

  moveCursor(x) {
    if (!this.content || this.content.cursor === x) return;
    this.content.cursor = x;
    this.placeCursor();
    this.showReadout(x);
  }

  draw() {
    const c = this.content, width = this.container.clientWidth;
    if (!c || !width) return;
    this.svg.replaceChildren();
    this.svg.setAttribute("width", width);
    const usable = (v) => v !== null && Number.isFinite(v) && (!c.log || v > 0);
    const all = c.lines.flatMap((l) => l.values.filter(usable));
    let low = Math.min(...all), high = Math.max(...all);
    if (!all.length) [low, high] = c.log ? [0.1, 1] : [0, 1];
    if (c.log) {
      const margin = Math.max((high / low) ** 0.06, high / low < 1.5 ? 1.3 : 1);
      [low, high] = [low / margin, high * margin];
    } else {
      if (low > 0 && low < 0.5 * high) low = 0;
      if (high - low < 1e-6 * Math.abs(high) || high === low) {
        const margin = 0.5 * Math.abs(high || 1);
        [low, high] = [low - margin, high + margin];
      }
      if (low !== 0) low -= 0.04 * (high - low);
    }
    const ticks = c.log ? logTicks(low, high) : linearTicks(low, high, 5);
    if (!c.log) [low, high] = [Math.min(low, ticks[0]), Math.max(high, ticks[ticks.length - 1])];
    const labels = ticks.map(tickLabel);
    const left = 14 + 7 * Math.max(...labels.map((l) => l.length)), right = width - 12;
    const top = 10, bottom = this.height - 32;
    const first = c.x[0], last = c.x[c.x.length - 1];
    const xOf = (x) => (last === first ? (left + right) / 2 : left + ((x - first) / (last - first)) * (right - left));
    const yOf = c.log
      ? (v) => bottom - (Math.log(v / low) / Math.log(high / low)) * (bottom - top)
      : (v) => bottom - ((v - low) / (high - low)) * (bottom - top);
    Object.assign(this, { xOf, top, bottom });

    ticks.forEach((t, i) => {
      const y = yOf(t);
      this.svg.append(svg("line", { x1: left, x2: right, y1: y, y2: y, class: "grid" }),
        svg("text", { x: left - 6, y: y + 4, class: "tick end" }, labels[i]));
    });
    const xTicks = c.x.length < 2 ? [first] : linearTicks(first, last, Math.max(2, Math.min(8, (right - left) / 60)))
      .filter((t) => c.xLabel !== "frame" || Number.isInteger(t));
    for (const t of xTicks) {
      this.svg.append(svg("line", { x1: xOf(t), x2: xOf(t), y1: bottom, y2: bottom + 4, class: "axis" }),
        svg("text", { x: xOf(t), y: bottom + 16, class: "tick" }, String(Number(t.toPrecision(6)))));
    }
    this.svg.append(svg("line", { x1: left, x2: right, y1: bottom, y2: bottom, class: "axis" }),
      svg("text", { x: (left + right) / 2, y: this.height - 3, class: "tick" }, c.xLabel));
    this.cursorLine = svg("line", { y1: top, y2: bottom, class: "cursor" });
    this.svg.append(this.cursorLine);
    for (const line of c.lines) {
      let path = "", pen = false;
      const points = [];
      line.values.forEach((v, i) => {
        if (!usable(v)) {
          pen = false;
          return;
        }
        const point = `${xOf(c.x[i]).toFixed(1)},${yOf(v).toFixed(1)}`;
        path += `${pen ? "L" : "M"}${point}`;
        // A value between two gaps would be a line without length.
        if (!pen && !usable(line.values[i + 1] ?? null)) points.push(point.split(","));
        pen = true;
      });
      const style = { stroke: line.color, class: line.dashed ? "line dashed" : "line" };
      this.svg.append(svg("path", { d: path, ...style }));
      for (const [x, y] of points) this.svg.append(svg("circle", { cx: x, cy: y, r: 3, fill: line.color }));
    }
    this.placeCursor();
    this.showReadout(c.cursor);
  }

  placeCursor() {
    const { cursor } = this.content;
    const shown = this.cursorLine && cursor !== undefined && this.content.x.includes(cursor);
    if (!this.cursorLine) return;
    this.cursorLine.style.display = shown ? "" : "none";
    if (!shown) return;
    this.cursorLine.setAttribute("x1", this.xOf(cursor));
    this.cursorLine.setAttribute("x2", this.xOf(cursor));
  }

  nearestX(event) {
    if (!this.content || !this.xOf) return undefined;
    const at = event.clientX - this.svg.getBoundingClientRect().left;
    return this.content.x.reduce((best, x) => (Math.abs(this.xOf(x) - at) < Math.abs(this.xOf(best) - at) ? x : best));
  }

  hover(event) {
    this.showReadout(this.nearestX(event));
  }

  /** The legend, with the values at `x`. */
  showReadout(x) {
    const c = this.content;
    if (!c) return;
    const i = c.x.indexOf(x);
    const items = c.lines.map((line) => {
      const item = document.createElement("span");
      item.className = "key";
      const swatch = document.createElement("i");
      swatch.className = line.dashed ? "swatch dashed" : "swatch";
      swatch.style.color = line.color;
      const value = document.createElement("b");
      value.textContent = i < 0 ? "" : formatNumber(line.values[i]);
      item.append(swatch, line.label, " ", value);
      return item;
    });
    const place = document.createElement("span");
    place.className = "key place";
    place.textContent = i < 0 ? "" : `${c.xLabel} ${Number(c.x[i].toPrecision(6))}`;
    this.readout.replaceChildren(place, ...items);
  }
}
