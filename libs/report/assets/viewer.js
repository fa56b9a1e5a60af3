// SPDX-License-Identifier: Apache-2.0
// The pictures on the screen: painted once for each frame and setting, drawn with one zoom and place for all.

/** Painted pictures and maps, made when they are needed and kept while there is room. */
class Surfaces {
  constructor(store, onReady, onError) {
    this.store = store;
    this.onReady = onReady;
    this.onError = onError;
    this.cache = new Cache(384 << 20);
    this.pending = new Map();
    this.latest = new Map();  // what was last ready in a place: shown until its successor is
  }

  static key(slot, frame, look) {
    const { map } = slot;
    if (!map) return `${slot.side}|${frame}|${look.exposure}|${look.tone}`;
    const { low, high } = slot.range;
    return `${map.id}|${slot.side}|${frame}|${low}|${high}|${map.base ? look.base : ""}`;
  }

  /** {canvas, values} if it is ready, null if there is nothing to show, undefined if it is being made. */
  get(slot, frame, look, urgent = true) {
    const key = Surfaces.key(slot, frame, look);
    const known = this.cache.get(key);
    if (known !== undefined) {
      if (urgent) this.latest.set(`${slot.side}|${slot.map?.id}`, known);
      return known;
    }
    if (!this.pending.has(key)) {
      const made = this.make(slot, frame, look, urgent).then((surface) => {
        this.cache.set(key, surface, surface ? 4 * surface.canvas.width * surface.canvas.height * 2 : 16);
      }).catch((error) => {
        this.cache.set(key, null, 16);
        this.onError(error);
      }).finally(() => {
        this.pending.delete(key);
        this.onReady();
      });
      this.pending.set(key, made);
    }
    return undefined;
  }

  stale(slot) {
    return this.latest.get(`${slot.side}|${slot.map?.id}`);
  }

  async make(slot, frame, look, urgent) {
    const { width, height } = this.store.data;
    let values = null, picture = null;
    if (slot.map) {
      values = await computeMap(this.store, slot.map, { side: slot.side, base: look.base, frame }, urgent);
    } else {
      picture = await this.store.picture(slot.side, frame, urgent);
    }
    if (!values && !picture) return null;
    const canvas = document.createElement("canvas");
    canvas.width = width;
    canvas.height = height;
    const context = canvas.getContext("2d");
    const image = context.createImageData(width, height);
    if (values) {
      paintMap(values, slot.range, image.data);
    } else {
      look.toneMap.paint(picture, image.data);
    }
    context.putImageData(image, 0, 0);
    return { canvas, values };
  }
}

const MIN_SCALE = 1 / 16, MAX_SCALE = 128;
const VALUES_SCALE = 56;  // CSS pixels: from here on numbers fit into a pixel of the picture

/** The canvas: cells with pictures, one view (place and zoom) for all. */
class Viewer {
  constructor(app) {
    this.app = app;
    this.section = document.getElementById("view");
    this.canvas = document.getElementById("canvas");
    this.divider = document.getElementById("divider");
    this.labels = document.getElementById("labels");
    this.tooltip = document.getElementById("tooltip");
    this.pointer = null;  // where the mouse is, in CSS pixels of the section
    new ResizeObserver(() => this.resize()).observe(this.section);
    this.listen();
    this.resize();
  }

  resize() {
    this.width = this.section.clientWidth;
    this.height = this.section.clientHeight;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(this.width * ratio));
    this.canvas.height = Math.max(1, Math.round(this.height * ratio));
    this.app.invalidate();
  }

  /** [{ x, y, width, height, slots }] in CSS pixels of the section. */
  cells() {
    const slots = this.app.slots();
    if (this.app.state.mode !== "grid") return [{ x: 0, y: 0, width: this.width, height: this.height, slots }];
    // As many columns as show the pictures largest.
    const { width, height } = this.app.data, n = slots.length;
    let best = { scale: 0, columns: 1 };
    for (let columns = 1; columns <= n; ++columns) {
      const scale = Math.min(this.width / columns / width, this.height / Math.ceil(n / columns) / height);
      if (scale > best.scale) best = { scale, columns };
    }
    const rows = Math.ceil(n / best.columns), gap = 2;
    const w = (this.width - gap * (best.columns - 1)) / best.columns, h = (this.height - gap * (rows - 1)) / rows;
    return slots.map((slot, i) => ({
      x: (i % best.columns) * (w + gap),
      y: Math.floor(i / best.columns) * (h + gap),
      width: w,
      height: h,
      slots: [slot],
    }));
  }

  /** CSS pixels for one of the picture. */
  scale() {
    const { zoom } = this.app.state;
    if (zoom > 0) return zoom / (window.devicePixelRatio || 1);
    const [cell] = this.cells(), { width, height } = this.app.data;
    return Math.max(Math.min(cell.width / width, cell.height / height), 1e-3);
  }

  /** What of the picture is in the middle of each cell. */
  center() {
    const { zoom, center } = this.app.state, { width, height } = this.app.data;
    return zoom > 0 && center ? center : [width / 2, height / 2];
  }

  cellAt(x, y) {
    return this.cells().find((c) => x >= c.x && y >= c.y && x < c.x + c.width && y < c.y + c.height);
  }

  /** From the section to the picture, in pixels of it. */
  toPicture(cell, x, y) {
    const scale = this.scale(), [cx, cy] = this.center();
    return [(x - cell.x - cell.width / 2) / scale + cx, (y - cell.y - cell.height / 2) / scale + cy];
  }

  /** Where the divider stands, in CSS pixels, or null if there is none. */
  dividerX() {
    return this.app.state.mode === "split" ? this.app.state.split * this.width : null;
  }

  draw() {
    const ratio = window.devicePixelRatio || 1, context = this.canvas.getContext("2d");
    const { app } = this, { frame } = app.state, scale = this.scale(), [cx, cy] = this.center();
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    const split = this.dividerX();
    this.divider.style.display = split === null ? "none" : "";
    if (split !== null) this.divider.style.left = `${split}px`;

    const labels = [];
    let complete = true;
    for (const cell of this.cells()) {
      const left = cell.x + cell.width / 2 - cx * scale, top = cell.y + cell.height / 2 - cy * scale;
      cell.slots.forEach((slot, i) => {
        // With a divider, the first slot is on its left and the second on its right.
        const from = i === 0 ? cell.x : split, to = cell.slots.length > 1 && i === 0 ? split : cell.x + cell.width;
        let surface = app.surfaces.get(slot, frame, app.look);
        const pending = surface === undefined;
        if (pending) {
          complete = false;
          surface = app.surfaces.stale(slot);
        }
        context.save();
        context.beginPath();
        context.rect(from, cell.y, Math.max(0, to - from), cell.height);
        context.clip();
        if (surface) {
          context.imageSmoothingEnabled = scale * ratio < 1;
          context.imageSmoothingQuality = "high";
          context.drawImage(surface.canvas, left, top, app.data.width * scale, app.data.height * scale);
        } else if (!pending) {
          context.strokeStyle = "#343b42";
          context.strokeRect(left + 0.5, top + 0.5, app.data.width * scale - 1, app.data.height * scale - 1);
        }
        if (surface && scale >= VALUES_SCALE) {
          this.drawValues(context, slot, surface, left, top, scale, [from, cell.y, to, cell.y + cell.height]);
        }
        this.drawMarks(context, left, top, scale);
        context.restore();
        labels.push(this.label(slot, i, from, to, cell, surface || pending));
      });
    }
    this.labels.replaceChildren(...labels.flat());
    this.complete = complete;
    this.showTooltip();
    return complete;
  }

  label(slot, i, from, to, cell, present) {
    const { app } = this, side = app.data.sides[slot.side];
    const label = document.createElement("div");
    label.className = "label";
    const dot = document.createElement("i");
    dot.style.background = app.colorOf(slot.side);
    const detail = document.createElement("small");
    const figure = app.figureOf(slot.side);
    detail.textContent = [slot.map?.title, figure].filter(Boolean).join(" · ");
    label.append(dot, side.label, detail);
    label.style.top = `${cell.y + 8}px`;
    const room = Math.max(0, to - from - 16);
    label.style.maxWidth = `${room}px`;
    if (room < 24) label.style.display = "none";
    if (i === 0) {
      label.style.left = `${from + 8}px`;
    } else {
      label.style.right = `${this.width - to + 8}px`;
    }
    if (present) return [label];
    const absent = document.createElement("div");
    absent.className = "label";
    absent.textContent = app.absence(slot);
    absent.style.top = `${cell.y + cell.height / 2}px`;
    absent.style.left = `${from + 8}px`;
    return [label, absent];
  }

  /** Writes the values of the pixels within [x0, y0, x1, y1] of the section into them. */
  drawValues(context, slot, surface, left, top, scale, [x0, y0, x1, y1]) {
    const { app } = this, { width, height } = app.data;
    const picture = surface.values ? null : app.store.peek(slot.side, app.state.frame);
    if (!surface.values && !picture) return;
    context.font = "11px ui-monospace, 'DejaVu Sans Mono', monospace";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineWidth = 2.5;
    context.lineJoin = "round";
    context.strokeStyle = "#000c";
    const first = (v, origin) => Math.max(0, Math.floor((v - origin) / scale));
    for (let y = first(y0, top); y < Math.min(height, Math.ceil((y1 - top) / scale)); ++y) {
      for (let x = first(x0, left); x < Math.min(width, Math.ceil((x1 - left) / scale)); ++x) {
        const i = y * width + x;
        const values = picture ? picture.rgb(i).slice(0, picture.channels) : [surface.values[i]];
        values.forEach((v, k) => {
          const place = [left + (x + 0.5) * scale, top + (y + 0.5) * scale + (k - (values.length - 1) / 2) * 14];
          const text = formatNumber(v, 3);
          context.strokeText(text, ...place);
          context.fillStyle = values.length === 3 ? ["#ff9a8f", "#8fe39a", "#8fc1ff"][k] : "#fff";
          context.fillText(text, ...place);
        });
      }
    }
  }

  /** The chosen pixel, and the way that it takes. */
  drawMarks(context, left, top, scale) {
    const { app } = this, positions = app.positions;
    if (!app.state.pixel || !positions) return;
    const here = positions[app.data.frames.indexOf(app.state.frame)];
    if (app.state.track) {
      context.beginPath();
      let pen = false;
      for (const p of positions) {
        if (p) context[pen ? "lineTo" : "moveTo"](left + p[0] * scale, top + p[1] * scale);
        pen = Boolean(p);
      }
      context.lineWidth = 3;
      context.strokeStyle = "#0008";
      context.stroke();
      context.lineWidth = 1.2;
      context.strokeStyle = "#ffd75e";
      context.stroke();
    }
    if (!here) return;
    const [x, y] = pixelOf(here), size = Math.max(scale, 7), half = (size - scale) / 2;
    for (const [width, style] of [[3, "#000a"], [1.2, "#ffd75e"]]) {
      context.lineWidth = width;
      context.strokeStyle = style;
      context.strokeRect(left + x * scale - half, top + y * scale - half, size, size);
    }
  }

  // --- Pointer -------------------------------------------------------------------------------------------------------

  listen() {
    const { canvas, divider, app } = this;
    const place = (event) => {
      const box = this.section.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    let drag = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button > 1) return;
      canvas.setPointerCapture(event.pointerId);
      drag = { at: place(event), center: this.center(), scale: this.scale(), moved: false };
    });
    canvas.addEventListener("pointermove", (event) => {
      const at = place(event);
      this.pointer = at;
      if (drag) {
        const dx = at[0] - drag.at[0], dy = at[1] - drag.at[1];
        if (drag.moved || Math.hypot(dx, dy) > 3) {
          drag.moved = true;
          this.look(drag.scale, [drag.center[0] - dx / drag.scale, drag.center[1] - dy / drag.scale]);
        }
      }
      this.showTooltip();
    });
    canvas.addEventListener("pointerup", (event) => {
      if (drag && !drag.moved && event.button === 0) {
        const at = place(event), cell = this.cellAt(...at);
        const [x, y] = cell ? this.toPicture(cell, ...at).map(Math.floor) : [-1, -1];
        if (x >= 0 && y >= 0 && x < app.data.width && y < app.data.height) app.pick(x, y);
      }
      drag = null;
    });
    canvas.addEventListener("pointercancel", () => (drag = null));
    canvas.addEventListener("pointerleave", () => {
      this.pointer = null;
      this.showTooltip();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : 1;
      this.zoomAt(place(event), Math.exp(-event.deltaY * lines * 0.0016));
    }, { passive: false });

    let dragging = false;
    divider.addEventListener("pointerdown", (event) => {
      divider.setPointerCapture(event.pointerId);
      dragging = true;
    });
    divider.addEventListener("pointermove", (event) => {
      if (dragging) app.set({ split: clamp(place(event)[0] / this.width, 0, 1) });
    });
    for (const end of ["pointerup", "pointercancel"]) divider.addEventListener(end, () => (dragging = false));
    divider.addEventListener("dblclick", () => app.set({ split: 0.5 }));
  }

  /** Sets scale (CSS pixels for one of the picture) and center. */
  look(scale, [x, y]) {
    const ratio = window.devicePixelRatio || 1, { width, height } = this.app.data;
    this.app.set({
      zoom: clamp(scale * ratio, MIN_SCALE, MAX_SCALE),
      center: [clamp(x, 0, width), clamp(y, 0, height)],
    });
  }

  /** Zooms so that what is at a place of the section stays there. */
  zoomAt([x, y], factor) {
    const cell = this.cellAt(x, y) ?? this.cells()[0], [px, py] = this.toPicture(cell, x, y);
    const ratio = window.devicePixelRatio || 1;
    const scale = clamp(this.scale() * factor * ratio, MIN_SCALE, MAX_SCALE) / ratio;
    this.look(scale, [
      px - (x - cell.x - cell.width / 2) / scale, py - (y - cell.y - cell.height / 2) / scale,
    ]);
  }

  zoomBy(factor) {
    const [cell] = this.cells();
    this.zoomAt(this.pointer ?? [cell.x + cell.width / 2, cell.y + cell.height / 2], factor);
  }

  // --- Values under the pointer --------------------------------------------------------------------------------------

  showTooltip() {
    const { app, tooltip } = this;
    const cell = this.pointer && this.cellAt(...this.pointer);
    const [x, y] = cell ? this.toPicture(cell, ...this.pointer).map(Math.floor) : [-1, -1];
    const { width, height, reference } = app.data;
    if (x < 0 || y < 0 || x >= width || y >= height) {
      tooltip.hidden = true;
      return;
    }
    const { frame } = app.state, i = y * width + x;
    const table = document.createElement("table");
    const row = (...cells) => {
      const line = table.insertRow();
      for (const text of cells) line.insertCell().textContent = text;
      return line;
    };
    row(`${app.sourcePixel(x, y).join(", ")}`, "R", "G", "B");
    const slots = app.slots();
    const sides = new Set(slots.map((s) => s.side));
    if (reference !== null) sides.add(reference);
    for (const side of sides) {
      const picture = app.store.peek(side, frame);
      const values = picture ? picture.rgb(i).map((v) => (Number.isNaN(v) ? "not finite" : formatNumber(v)))
        : [picture === null ? "no frame" : "…"];
      row(app.data.sides[side].label, ...values).cells[0].style.color = app.colorOf(side);
      for (const slot of slots) {
        if (slot.side !== side || !slot.map) continue;
        const surface = app.surfaces.get(slot, frame, app.look);
        if (surface?.values) row(`  ${slot.map.title}`, formatNumber(surface.values[i]));
      }
    }
    tooltip.replaceChildren(table);
    tooltip.hidden = false;
    const [px, py] = this.pointer, w = tooltip.offsetWidth, h = tooltip.offsetHeight;
    tooltip.style.left = `${px + 18 + w < this.width ? px + 18 : Math.max(0, px - 14 - w)}px`;
    tooltip.style.top = `${py + 18 + h < this.height ? py + 18 : Math.max(0, py - 14 - h)}px`;
  }
}
