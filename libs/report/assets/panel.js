// SPDX-License-Identifier: Apache-2.0
// The figures beside the pictures: metrics, plots over frames, a pixel over time with slices, and where sequences come
// from.

/** An element with properties (`dataset` and `style` are objects) and children, which are text or elements. */
function element(name, properties = {}, ...children) {
  const { dataset, style, ...rest } = properties;
  const made = Object.assign(document.createElement(name), rest);
  Object.assign(made.dataset, dataset);
  Object.assign(made.style, style);
  made.append(...children);
  return made;
}

const div = (className, ...children) => element("div", { className }, ...children);
const note = (text) => element("p", { className: "note", textContent: text });
const dot = (color) => element("i", { style: { background: color } });

/** A part of the panel that can be folded away. */
function section(parent, id, title, hint = "") {
  const summary = element("summary", {}, title, element("small", { textContent: hint }));
  const details = element("details", { id, open: true }, summary);
  parent.append(details);
  return details;
}

/** A select whose options are [[value, text], ...]. */
function choice(options, ariaLabel, onChange) {
  const select = element("select", { ariaLabel }, ...options.map(([value, text]) => new Option(text, value)));
  select.addEventListener("change", () => onChange(select.value));
  return select;
}

/** A check box: { label, input }. */
function checkbox(text, properties, onChange) {
  const input = element("input", { type: "checkbox", ...properties });
  input.addEventListener("change", () => onChange(input.checked));
  return { label: element("label", { title: properties.title ?? "" }, input, ` ${text}`), input };
}

const CHANNELS = {
  luminance: (rgb) => luminance(...rgb),
  red: (rgb) => rgb[0],
  green: (rgb) => rgb[1],
  blue: (rgb) => rgb[2],
};

/** What "better" means: an arrow, words, and a number that is smaller for better values. */
const DIRECTIONS = {
  lower: { arrow: "↓", words: "lower is better", badness: (v) => v },
  higher: { arrow: "↑", words: "higher is better", badness: (v) => -v },
  "near zero": { arrow: "→0", words: "closer to 0 is better", badness: Math.abs },
};

class Panel {
  constructor(app) {
    this.app = app;
    this.root = document.getElementById("panel");
    const { metrics, notes } = app.data;
    if (metrics.length) {
      this.addMetrics();
      this.addMetricPlot();
    }
    this.addPixel();
    this.addSequences();
    if (notes.length) {
      section(this.root, "notes", "Notes").append(...notes.map((text) => element("p", { textContent: text })));
    }
  }

  goTo(frame) {
    if (this.app.data.frames.includes(frame)) this.app.set({ frame });
  }

  // --- Metrics ------------------------------------------------------------------------------------------------------

  addMetrics() {
    const { app } = this, { data } = app;
    const tests = data.sides.filter((side) => side.series);
    const heading = (side) => {
      const color = app.colorOf(data.sides.indexOf(side));
      return element("th", { title: side.name, style: { color } }, side.label);
    };
    const body = element("tbody");
    this.metricRows = new Map();
    for (const metric of data.metrics) {
      const row = this.metricRow(metric, tests);
      row.addEventListener("click", () => app.set({ metric: metric.id }));
      this.metricRows.set(metric.id, row);
      body.append(row);
    }
    const addCounts = (name, title, counts) => {
      if (!counts.some((n) => n > 0)) return;
      const cells = counts.map((n) => element("td", { textContent: String(n) }));
      body.append(element("tr", { title }, element("th", { scope: "row", textContent: name }), ...cells));
    };
    addCounts("not finite", "pixels of all frames that are not finite",
      tests.map((side) => (side.nonFinite ?? []).reduce((a, b) => a + b, 0)));
    addCounts("frames missing", "frames that the reference has and the sequence lacks",
      tests.map((side) => (side.missing ?? []).length));

    const head = element("thead", {}, element("tr", {}, element("th"), ...tests.map(heading)));
    section(this.root, "metrics", "Metrics", "mean over frames; a row is drawn below")
      .append(div("scroll", element("table", { className: "figures" }, head, body)));
  }

  metricRow(metric, tests) {
    const direction = DIRECTIONS[metric.better];
    const arrow = element("span", { className: "direction", title: direction.words }, ` ${direction.arrow} `);
    const unit = element("small", { className: "direction", textContent: metric.unit });
    const name = element("button", { type: "button", textContent: metric.title });
    const row = element("tr", { title: [metric.help, metric.formula, metric.source].filter(Boolean).join("\n") },
      element("th", { scope: "row" }, name, arrow, unit));

    const means = tests.map((side) => side.series[metric.id]?.mean ?? null);
    const badness = means.map((v) => (v === null ? Infinity : direction.badness(v)));
    const best = Math.min(...badness);
    tests.forEach((side, i) => {
      const details = [], spread = side.series[metric.id]?.confidence95;
      if (spread) details.push(`± ${formatNumber(spread, 2)}`);
      if (metric.better === "lower" && i > 0 && means[0] > 0 && means[i] !== null) {
        details.push(`${formatNumber(means[i] / means[0], 3)}×`);
      }
      const cell = element("td", { textContent: formatNumber(means[i]) }, element("small", {
        textContent: details.join(" "),
        title: "half of the interval that holds the mean with 95 % confidence; ratio to the first sequence",
      }));
      if (tests.length > 1 && badness[i] === best && means[i] !== null) cell.className = "best";
      row.append(cell);
    });
    return row;
  }

  addMetricPlot() {
    const { app } = this;
    this.metricSelect = choice(app.data.metrics.map((m) => [m.id, m.title]), "Metric", (metric) => app.set({ metric }));
    this.log = checkbox("logarithmic", {}, (log) => app.set({ log }));
    this.metricNote = note("");
    const holder = div("");
    section(this.root, "frames", "Over frames")
      .append(div("controls", this.metricSelect, this.log.label), this.metricNote, holder);
    this.metricPlot = new Plot(holder, { onPick: (x) => this.goTo(x) });
  }

  /** Draws the chosen metric over frames, or over temporal frequency if that is what it has. */
  showMetric() {
    if (!this.metricPlot) return;
    const { app } = this, { data, state } = app;
    const metric = data.metrics.find((m) => m.id === state.metric);
    this.metricSelect.value = metric.id;
    this.log.input.checked = state.log;
    for (const [id, row] of this.metricRows) row.classList.toggle("chosen", id === metric.id);

    const lines = [], overFrequency = [];
    let frequencies = null;
    data.sides.forEach((side, index) => {
      const series = side.series?.[metric.id];
      if (!series) return;
      const line = { label: side.label, color: app.colorOf(index) };
      if (series.spectrum) {
        // Sequences of other lengths have other frequencies; the plot has those of the first.
        frequencies ??= series.spectrum.frequency;
        overFrequency.push({ ...line, values: frequencies.map((_, i) => series.spectrum.power[i] ?? null) });
      }
      const valueOf = (frame) => {
        const i = side.frames.indexOf(frame);
        return i < 0 ? null : series.values ? series.values[i] : series.mean;
      };
      lines.push({ ...line, values: data.frames.map(valueOf) });
    });
    if (frequencies) {
      this.metricNote.textContent = `${metric.help}; drawn is the power over temporal frequency`;
      this.metricPlot.show({ x: frequencies, xLabel: "cycles per frame", log: state.log, lines: overFrequency });
    } else {
      this.metricNote.textContent = metric.help;
      this.metricPlot.show({ x: data.frames, xLabel: "frame", log: state.log, cursor: state.frame, lines });
    }
  }

  // --- A pixel over time --------------------------------------------------------------------------------------------

  addPixel() {
    const { app } = this, { data } = app;
    const number = (axis, end) => {
      const input = element("input", { type: "number", min: 0, max: end - 1, ariaLabel: `Pixel ${axis}` });
      input.addEventListener("change", () => {
        const place = [...(app.state.pixel ?? [0, 0])];
        place[axis === "x" ? 0 : 1] = clamp(Math.round(Number(input.value) || 0), 0, end - 1);
        app.pick(...place);
      });
      return input;
    };
    this.pixelX = number("x", data.width);
    this.pixelY = number("y", data.height);
    this.channel = choice(Object.keys(CHANNELS).map((c) => [c, c]), "Channel", (channel) => app.set({ channel }));
    this.track = checkbox("follow motion", {
      disabled: !app.hasMotion,
      title: app.hasMotion ? "Follow the surface along motion vectors (M)"
        : "The files have no motion vectors; `--layers motion` renders them",
    }, (track) => app.set({ track }));
    this.axis = choice([["column", "column"], ["row", "row"]], "Slices along a", (axis) => app.set({ axis }));
    this.length = choice([["31", "31 pixels"], ["95", "95 pixels"], ["0", "all"]], "Length of the slices",
      (length) => app.set({ length: Number(length) }));

    this.pixelNote = note("");
    const holder = div("");
    this.slices = div("slices");
    this.pixelDrawings = div("", holder, div("controls", "Slices over time: ", this.axis, this.length), this.slices);
    const place = [element("label", {}, "x ", this.pixelX), element("label", {}, "y ", this.pixelY)];
    section(this.root, "pixel", "Pixel over time")
      .append(div("controls", ...place, this.channel, this.track.label), this.pixelNote, this.pixelDrawings);

    this.pixelPlot = new Plot(holder, { onPick: (x) => this.goTo(x) });
    this.slicesOf = data.sides.map(() => null);
    this.run = 0;
    this.pixelDone = true;  // whether what is drawn is that of the chosen pixel
  }

  /** Computes the series and slices of the chosen pixel. What an earlier call has not finished is abandoned. */
  async updatePixel() {
    const { app } = this, { state, store } = app;
    const run = ++this.run;
    const isCurrent = () => run === this.run;
    this.pixelDone = false;
    if (!state.pixel) {
      this.slicesOf.fill(null);
      app.positions = null;
    } else {
      const positions = await trackPixel(store, state.pixel, state.origin ?? state.frame, state.track);
      if (!isCurrent()) return;
      app.positions = positions;
      app.invalidate();
      let due = performance.now() + 200;
      for (let side = 0; side < app.data.sides.length; ++side) {
        const advance = () => {
          if (performance.now() < due) return;
          due = performance.now() + 200;
          this.pixelNote.textContent = `Reading ${app.data.sides[side].label} …`;
        };
        const slice = await sliceAlong(store, side, positions, state, isCurrent, advance);
        if (!slice) return;
        this.slicesOf[side] = slice;  // until then the earlier one stays, so that nothing flickers
      }
    }
    this.pixelDone = true;
    this.showPixel();
  }

  showPixel() {
    const { app } = this, { data, state } = app;
    this.pixelDrawings.hidden = !state.pixel;
    [this.pixelX.value, this.pixelY.value] = state.pixel ?? ["", ""];
    this.channel.value = state.channel;
    this.axis.value = state.axis;
    this.length.value = String(state.length);
    this.track.input.checked = state.track;
    this.pixelNote.textContent = this.aboutPixel();
    if (!state.pixel) return;
    const valueOf = (rgb) => rgb && CHANNELS[state.channel](rgb);
    this.pixelPlot.show({
      x: data.frames,
      xLabel: "frame",
      cursor: state.frame,
      lines: this.slicesOf.map((slice, side) => ({
        label: data.sides[side].label,
        color: app.colorOf(side),
        dashed: side === data.reference,
        values: slice ? slice.series.map(valueOf) : data.frames.map(() => null),
      })),
    });
    this.paintSlices();
  }

  aboutPixel() {
    const { app } = this, { data, state } = app;
    if (!state.pixel) return "Click a pixel of the picture, or type its place.";
    const lost = app.positions?.filter((p) => !p).length ?? 0;
    if (lost > 0) return `In ${lost} of ${data.frames.length} frames the surface is hidden, has left or has no vectors.`;
    if (data.sourceSize[0] === data.width) return "";
    const place = app.sourcePixel(...state.pixel).join(", ");
    return `Pictures are stored at ${data.width}x${data.height}; this is pixel ${place} of the frames.`;
  }

  paintSlices() {
    const { app } = this, { data } = app, { toneMap } = app.look;
    const columns = data.frames.length, boxes = [];
    this.slicesOf.forEach((slice, side) => {
      if (!slice) return;
      const height = `${Math.min(2 * slice.size, 380)}px`;
      const canvas = element("canvas", { width: columns, height: slice.size, style: { height } });
      const context = canvas.getContext("2d"), image = context.createImageData(columns, slice.size);
      for (let i = 0; i < columns * slice.size; ++i) {
        const [r, g, b] = slice.values.subarray(3 * i, 3 * i + 3);
        if (!Number.isNaN(r)) toneMap.put(r, g, b, image.data, 4 * i);
      }
      context.putImageData(image, 0, 0);
      canvas.addEventListener("click", (event) => {
        const place = canvas.getBoundingClientRect();
        const i = Math.floor(((event.clientX - place.left) / place.width) * columns);
        app.set({ frame: data.frames[clamp(i, 0, columns - 1)] });
      });
      const name = div("label name", dot(app.colorOf(side)), data.sides[side].label);
      const title = "frames from left to right; click to go to one";
      boxes.push(element("div", { className: "slice", title, dataset: { side } }, canvas, div("mark"), name));
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
    const hint = `${data.sourceSize.join("x")}, ${data.frames.length} frames, layer ${data.layer}`;
    const box = section(this.root, "sequences", "Sequences", hint);
    data.sides.forEach((side, index) => {
      const [fine, coarse] = side.relativeError.map((e) => `± ${(100 * e).toPrecision(2)} %`);
      const rows = [
        ["files", side.runs.join(", ")],
        ["frames", describeFrames(side.frames)],
        ...side.info,
        ["stored to", `${fine === coarse ? fine : `${fine} to ${coarse}`} of each value`],
      ];
      const list = element("dl", { className: "info" });
      for (const [name, text] of rows) {
        list.append(element("dt", { textContent: name }), element("dd", { textContent: text }));
      }
      box.append(element("h3", {}, dot(app.colorOf(index)), side.label), list);
    });
    box.append(note(`Made by ${data.generator}. The table holds exact figures; values under the pointer, plots of ` +
      "pixels and maps come from the stored pictures."));
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
