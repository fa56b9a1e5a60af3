// SPDX-License-Identifier: Apache-2.0
// The figures beside the pictures: metrics, plots over frames, a pixel over time with slices, where sequences come from.

function element(name, properties = {}, ...children) {
  const { dataset, style, ...rest } = properties;
  const made = Object.assign(document.createElement(name), rest);
  Object.assign(made.dataset, dataset);
  Object.assign(made.style, style);
  made.append(...children);
  return made;
}

function section(parent, id, title, hint = "") {
  const details = element("details", { id, open: true }, element("summary", {}, title, element("small", { textContent: hint })));
  parent.append(details);
  return details;
}

/** A select whose options are [[value, text], ...]. */
function choice(options, properties, onChange) {
  const select = element("select", properties, ...options.map(([value, text]) => new Option(text, value)));
  select.addEventListener("change", () => onChange(select.value));
  return select;
}

function checkbox(text, properties, onChange) {
  const input = element("input", { type: "checkbox", ...properties });
  input.addEventListener("change", () => onChange(input.checked));
  return [element("label", { title: properties.title ?? "" }, input, ` ${text}`), input];
}

const CHANNELS = {
  luminance: (rgb) => luminance(...rgb),
  red: (rgb) => rgb[0],
  green: (rgb) => rgb[1],
  blue: (rgb) => rgb[2],
};

class Panel {
  constructor(app) {
    this.app = app;
    this.root = document.getElementById("panel");
    const { data } = app;
    if (data.metrics.length) this.addMetrics();
    this.addPixel();
    this.addSequences();
    if (data.notes.length) {
      section(this.root, "notes", "Notes").append(...data.notes.map((text) => element("p", { textContent: text })));
    }
  }

  // --- Metrics ------------------------------------------------------------------------------------------------------

  addMetrics() {
    const { app } = this, { data } = app;
    const box = section(this.root, "metrics", "Metrics", "mean over frames; a row is drawn below");
    const tests = data.sides.filter((s) => s.series);
    const head = element("tr", {}, element("th", {}), ...tests.map((side) =>
      element("th", { title: side.name, style: { color: app.colorOf(data.sides.indexOf(side)) } }, side.label)));
    const body = element("tbody");
    this.metricRows = new Map();
    for (const metric of data.metrics) {
      const means = tests.map((side) => side.series[metric.id]?.mean ?? null);
      const score = means.map((v) => (v === null ? NaN : metric.better === "lower" ? v : metric.better === "higher" ? -v : Math.abs(v)));
      const best = Math.min(...score.filter((v) => !Number.isNaN(v)));
      const arrow = { lower: "↓", higher: "↑", zero: "→0" }[metric.better];
      const pick = element("button", { type: "button", textContent: metric.title });
      const row = element("tr", { title: `${metric.help}\n${metric.formula}\n${metric.source}`.trim() },
        element("th", { scope: "row" }, pick, " ", element("span", { className: "direction", textContent: arrow, title: { lower: "lower is better", higher: "higher is better", zero: "closer to 0 is better" }[metric.better] }), metric.unit ? element("small", { className: "direction", textContent: ` ${metric.unit}` }) : ""));
      tests.forEach((side, i) => {
        const error = side.series[metric.id]?.confidence95;
        const ratio = means[0] && i > 0 && means[i] !== null ? means[i] / means[0] : null;
        const details = [error ? `± ${formatNumber(error, 2)}` : "", ratio > 0 ? `${formatNumber(ratio, 3)}×` : ""].filter(Boolean);
        const cell = element("td", { textContent: formatNumber(means[i]) }, element("small", {
          textContent: details.join("  "), title: "half of the interval that holds the mean with 95 % confidence; ratio to the first sequence",
        }));
        if (tests.length > 1 && score[i] === best) cell.className = "best";
        row.append(cell);
      });
      row.addEventListener("click", () => app.set({ metric: metric.id }));
      this.metricRows.set(metric.id, row);
      body.append(row);
    }
    const broken = tests.map((side) => (side.nonFinite ?? []).reduce((a, b) => a + b, 0));
    if (broken.some((n) => n > 0)) {
      body.append(element("tr", { title: "pixels of all frames that are not finite" }, element("th", { scope: "row", textContent: "not finite" }),
        ...broken.map((n) => element("td", { textContent: String(n) }))));
    }
    const missing = tests.map((side) => (side.missing ?? []).length);
    if (missing.some((n) => n > 0)) {
      body.append(element("tr", { title: "frames that the reference has and the sequence lacks" }, element("th", { scope: "row", textContent: "frames missing" }),
        ...missing.map((n) => element("td", { textContent: String(n) }))));
    }
    box.append(element("div", { className: "scroll" }, element("table", { className: "figures" }, element("thead", {}, head), body)));

    const plots = section(this.root, "frames", "Over frames");
    this.metricSelect = choice(data.metrics.map((m) => [m.id, m.title]), { ariaLabel: "Metric" }, (metric) => app.set({ metric }));
    const [log, logInput] = checkbox("logarithmic", {}, (on) => app.set({ log: on }));
    this.logInput = logInput;
    this.metricNote = element("p", { className: "note" });
    plots.append(element("div", { className: "controls" }, this.metricSelect, log), this.metricNote);
    const holder = element("div");
    plots.append(holder);
    this.metricPlot = new Plot(holder, { onPick: (x) => { if (data.frames.includes(x)) app.set({ frame: x }); } });
  }

  showMetric() {
    const { app } = this, { data, state } = app;
    if (!this.metricPlot) return;
    const metric = data.metrics.find((m) => m.id === state.metric);
    this.metricSelect.value = metric.id;
    this.logInput.checked = state.log;
    for (const [id, row] of this.metricRows) row.classList.toggle("chosen", id === metric.id);
    const tests = data.sides.map((side, index) => ({ side, index, series: side.series?.[metric.id] })).filter((t) => t.series);
    const line = (t, values) => ({ label: t.side.label, color: app.colorOf(t.index), values });
    this.metricNote.textContent = metric.help;
    const spectra = tests.filter((t) => t.series.spectrum);
    if (tests.some((t) => t.series.values)) {
      this.metricPlot.show({
        x: data.frames,
        xLabel: "frame",
        log: state.log,
        cursor: state.frame,
        lines: tests.filter((t) => t.series.values).map((t) => line(t, data.frames.map((f) => {
          const i = t.side.frames.indexOf(f);
          return i < 0 ? null : t.series.values[i];
        }))),
      });
    } else if (spectra.length) {
      this.metricNote.textContent = `${metric.help}; drawn: the power of the residual over temporal frequency`;
      this.metricPlot.show({
        x: spectra[0].series.spectrum.frequency,
        xLabel: "cycles per frame",
        log: state.log,
        lines: spectra.map((t) => line(t, t.series.spectrum.power)),
      });
    } else {
      this.metricNote.textContent = `${metric.help}; it has one value for the sequence`;
      this.metricPlot.show({ x: data.frames, xLabel: "frame", log: state.log, cursor: state.frame,
        lines: tests.map((t) => line(t, data.frames.map(() => t.series.mean))) });
    }
  }

  // --- A pixel over time --------------------------------------------------------------------------------------------

  addPixel() {
    const { app } = this, { data } = app;
    const box = section(this.root, "pixel", "Pixel over time");
    const number = (axis, max) => {
      const input = element("input", { type: "number", min: 0, max: max - 1, style: { width: "5.5em" }, ariaLabel: `Pixel ${axis}` });
      input.addEventListener("change", () => {
        const [x, y] = app.state.pixel ?? [0, 0], v = clamp(Math.round(Number(input.value) || 0), 0, max - 1);
        app.pick(axis === "x" ? v : x, axis === "y" ? v : y);
      });
      return input;
    };
    this.pixelX = number("x", data.width);
    this.pixelY = number("y", data.height);
    this.channel = choice(Object.keys(CHANNELS).map((c) => [c, c]), { ariaLabel: "Channel" }, (channel) => app.set({ channel }));
    this.axis = choice([["column", "column"], ["row", "row"]], { ariaLabel: "Slices along a" }, (axis) => app.set({ axis }));
    this.length = choice([["31", "31 pixels"], ["95", "95 pixels"], ["0", "all"]], { ariaLabel: "Length of the slices" },
      (length) => app.set({ length: Number(length) }));
    const moves = app.hasMotion;
    const [track, trackInput] = checkbox("follow motion", {
      disabled: !moves,
      title: moves ? "Follow the surface along motion vectors (M)" : "the files have no motion vectors: render them with --layers motion",
    }, (on) => app.set({ track: on }));
    this.trackInput = trackInput;
    this.pixelNote = element("p", { className: "note" });
    const holder = element("div");
    this.slices = element("div", { className: "slices" });
    this.pixelDrawings = element("div", { hidden: true }, holder,
      element("div", { className: "controls" }, element("span", {}, "Slices over time: "), this.axis, this.length), this.slices);
    box.append(
      element("div", { className: "controls" }, element("label", {}, "x ", this.pixelX), element("label", {}, "y ", this.pixelY), this.channel, track),
      this.pixelNote, this.pixelDrawings);
    this.pixelPlot = new Plot(holder, { onPick: (x) => { if (data.frames.includes(x)) app.set({ frame: x }); } });
    this.slicesOf = data.sides.map(() => null);
    this.run = 0;
    this.pixelDone = true;  // whether what is drawn is that of the chosen pixel
  }

  /** Computes the series and slices of the chosen pixel. What an earlier call has not finished is abandoned. */
  async updatePixel() {
    const { app } = this, { state, store } = app;
    const run = ++this.run;
    const current = () => run === this.run;
    this.pixelDone = false;
    if (!state.pixel) {
      this.slicesOf.fill(null);
      app.positions = null;
    } else {
      const positions = await trackPixel(store, state.pixel, state.origin ?? state.frame, state.track);
      if (!current()) return;
      app.positions = positions;
      app.invalidate();
      let due = performance.now() + 200;
      for (let side = 0; side < app.data.sides.length; ++side) {
        const result = await sliceAlong(store, side, positions, state, current, () => {
          if (performance.now() < due) return;
          due = performance.now() + 200;
          this.pixelNote.textContent = `Reading ${app.data.sides[side].label} …`;
        });
        if (!result) return;
        this.slicesOf[side] = result;  // until then the earlier one stays, so that nothing flickers
      }
    }
    this.pixelDone = true;
    this.showPixel();
  }

  showPixel() {
    const { app } = this, { data, state } = app;
    const has = Boolean(state.pixel);
    this.pixelDrawings.hidden = !has;
    [this.pixelX.value, this.pixelY.value] = state.pixel ?? ["", ""];
    this.channel.value = state.channel;
    this.axis.value = state.axis;
    this.length.value = String(state.length);
    this.trackInput.checked = state.track;
    const lost = has && app.positions ? app.positions.filter((p) => !p).length : 0;
    this.pixelNote.textContent = !has ? "Click a pixel of the picture, or type its place."
      : lost > 0 ? `The motion vectors lose the surface in ${lost} of ${data.frames.length} frames.`
      : data.sourceSize[0] !== data.width ? `Pictures are stored at ${data.width}x${data.height}; this is pixel ${app.sourcePixel(...state.pixel).join(", ")} of the frames.` : "";
    this.pixelPlot.show({
      x: data.frames,
      xLabel: "frame",
      log: false,
      cursor: state.frame,
      lines: !has ? [] : this.slicesOf.map((s, side) => ({
        label: data.sides[side].label,
        color: app.colorOf(side),
        dashed: side === data.reference,
        values: s ? s.series.map((rgb) => rgb && CHANNELS[state.channel](rgb)) : data.frames.map(() => null),
      })),
    });
    this.paintSlices();
  }

  paintSlices() {
    const { app } = this, { data } = app, { toneMap } = app.look;
    const boxes = [];
    this.slicesOf.forEach((slice, side) => {
      if (!slice) return;
      const columns = data.frames.length;
      const canvas = element("canvas", { width: columns, height: slice.size, style: { height: `${Math.min(2 * slice.size, 380)}px` } });
      const context = canvas.getContext("2d"), image = context.createImageData(columns, slice.size);
      for (let i = 0; i < columns * slice.size; ++i) {
        const r = slice.values[3 * i];
        if (!Number.isNaN(r)) toneMap.put(r, slice.values[3 * i + 1], slice.values[3 * i + 2], image.data, 4 * i);
      }
      context.putImageData(image, 0, 0);
      const dot = element("i", { style: { background: app.colorOf(side) } });
      const box = element("div", { className: "slice", title: "frames from left to right; click to go to one", dataset: { side } },
        canvas, element("div", { className: "mark" }), element("div", { className: "label name" }, dot, data.sides[side].label));
      canvas.addEventListener("click", (event) => {
        const place = canvas.getBoundingClientRect();
        const i = clamp(Math.floor(((event.clientX - place.left) / place.width) * columns), 0, columns - 1);
        app.set({ frame: data.frames[i] });
      });
      boxes.push(box);
    });
    this.slices.replaceChildren(...boxes);
    this.moveCursor();
  }

  moveCursor() {
    const { data, state } = this.app;
    const i = data.frames.indexOf(state.frame), n = data.frames.length;
    for (const mark of this.slices.querySelectorAll(".mark")) {
      mark.style.left = `${(100 * i) / n}%`;
      mark.style.width = `${100 / n}%`;
    }
    this.pixelPlot.moveCursor(state.frame);
    this.metricPlot?.moveCursor(state.frame);
  }

  // --- Where the sequences come from ---------------------------------------------------------------------------------

  addSequences() {
    const { app } = this, { data } = app;
    const box = section(this.root, "sequences", "Sequences", `${data.sourceSize.join("x")}, ${data.frames.length} frames, layer ${data.layer}`);
    data.sides.forEach((side, index) => {
      const dot = element("i", { style: { background: app.colorOf(index) } });
      const list = element("dl", { className: "info" });
      const row = (name, text) => list.append(element("dt", { textContent: name }), element("dd", { textContent: text }));
      row("files", side.runs.join(", "));
      row("frames", describeFrames(side.frames));
      for (const [name, text] of side.info) row(name, text);
      const [fine, coarse] = side.relativeError.map((e) => `${(100 * e).toPrecision(2)} %`);
      row("stored to", fine === coarse ? `± ${fine} of each value` : `± ${fine} to ± ${coarse} of each value`);
      box.append(element("h3", {}, dot, side.label), list);
    });
    box.append(element("p", { className: "note", textContent: `Made by ${data.generator}. The table holds exact figures; values under the pointer, plots of pixels and maps come from the stored pictures.` }));
  }
}

/** "1-24, 30": runs of consecutive numbers. */
function describeFrames(frames) {
  const runs = [];
  for (const f of frames) {
    const last = runs[runs.length - 1];
    if (last && last[1] === f - 1) last[1] = f;
    else runs.push([f, f]);
  }
  return runs.map(([a, b]) => (a === b ? `${a}` : `${a}-${b}`)).join(", ");
}
