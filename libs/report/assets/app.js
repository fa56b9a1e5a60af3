// SPDX-License-Identifier: Apache-2.0
// The page's state, its controls, keys and address. Everything that is shown follows from the state.

const SIDE_COLORS = ["#5aa9e6", "#f2a541", "#6cc08b", "#e37fb0", "#b69cf0", "#e0655a", "#4fc4c4", "#c9c46a"];
const REFERENCE_COLOR = "#e8ecef";

const KEYS = [
  ["Space", "play or stop"],
  ["← →", "frame before, next frame; Home and End: first and last"],
  ["S F G", "split, flip, grid"],
  ["F", "again: exchange the one that is shown for the other"],
  ["B", "flip on its own, twice a second"],
  ["X", "exchange A and B"],
  ["1 – 9, 0", "sequence for A; 0 is the reference; with Shift for B"],
  ["E", "next error map, for A and B; Shift+E the one before"],
  ["[ ] \\", "exposure down, up, back"],
  ["T", "next tone curve"],
  ["+ − Z O", "zoom in, out, fit, one to one"],
  ["Shift + arrows", "move the picture"],
  ["M", "follow the chosen pixel along motion vectors"],
  ["P", "show or hide the figures"],
  ["L", "copy the address of what is shown"],
  ["?", "this list; Escape closes it"],
];

class App {
  constructor(data) {
    this.data = data;
    this.errors = [];
    this.store = new Store(data);
    this.maps = mapsOf(data);
    this.ranges = new Map();  // map id -> { low, high } where the reader has changed them
    this.surfaces = new Surfaces(this.store, () => this.invalidate(), (error) => this.fail(error));
    this.positions = null;
    this.defaults = {
      frame: data.frames[0],
      mode: data.sides.length > 1 ? "split" : "flip",
      flipped: false,
      a: 0,
      b: data.reference ?? Math.min(1, data.sides.length - 1),
      showA: "picture",
      showB: "picture",
      base: data.reference ?? 0,
      exposure: data.display.exposure,
      tone: data.display.toneMap,
      split: 0.5,
      zoom: 0,
      center: null,
      pixel: null,
      origin: null,
      track: false,
      axis: "column",
      length: 95,
      channel: "luminance",
      metric: data.metrics[0]?.id ?? null,
      log: true,
      panel: true,
    };
    this.state = { ...this.defaults };
    this.playing = false;
    this.blinking = false;
    this.ready = new Promise((resolve) => (this.markReady = resolve));
  }

  /** Whether there are two things to compare. */
  get hasChoice() {
    return this.data.sides.length > 1 || this.maps.length > 0;
  }

  get hasMotion() {
    const { forward, backward } = this.data.motion;
    return forward.length > 0 || backward.length > 0;
  }

  start() {
    this.updateLook();
    this.viewer = new Viewer(this);
    this.panel = new Panel(this);
    this.connect();
    this.set(this.parse(location.hash), { force: true });
    window.addEventListener("hashchange", () => {
      if (location.hash === this.address()) return;
      this.ranges.clear();
      this.set({ ...this.defaults, ...this.parse(location.hash) });
    });
    this.prefetchSoon();
  }

  fail(error) {
    this.errors.push(error);
    console.error(error);
  }

  colorOf(side) {
    return side === this.data.reference ? REFERENCE_COLOR : SIDE_COLORS[side % SIDE_COLORS.length];
  }

  /** A pixel of the stored pictures in the pixels of the frames. */
  sourcePixel(x, y) {
    const { width, height, sourceSize } = this.data;
    return [Math.floor(((x + 0.5) * sourceSize[0]) / width), Math.floor(((y + 0.5) * sourceSize[1]) / height)];
  }

  mapOf(show) {
    return this.maps.find((m) => m.id === show) ?? null;
  }

  rangeOf(map) {
    return { ...map.range, ...this.ranges.get(map.id) };
  }

  /** What is shown: [{ side, map, range }], in split mode A and B. */
  slots() {
    const { mode, a, b, showA, showB, flipped } = this.state;
    const slot = (side, show) => {
      const map = this.mapOf(show);
      return { side, map, range: map && this.rangeOf(map) };
    };
    if (mode === "grid") return this.data.sides.map((_, side) => slot(side, showA));
    if (mode === "split") return [slot(a, showA), slot(b, showB)];
    return [flipped ? slot(b, showB) : slot(a, showA)];
  }

  /** The chosen metric of a side in the current frame, as text. */
  figureOf(side) {
    const { metric, frame } = this.state, { series, frames } = this.data.sides[side];
    const value = series?.[metric]?.values?.[frames.indexOf(frame)];
    if (value === undefined || value === null) return "";
    return `${this.data.metrics.find((m) => m.id === metric).title} ${formatNumber(value)}`;
  }

  /** Why there is nothing to show. */
  absence(slot) {
    const { sides, frames, reference } = this.data, { frame, base } = this.state, { label } = sides[slot.side];
    if (!sides[slot.side].frames.includes(frame)) return `${label} has no frame ${frame}`;
    if (slot.map?.stored && slot.side === reference) return `${slot.map.title} compares with this sequence`;
    if (slot.map?.before && frame === frames[0]) return "there is no frame before the first";
    if (slot.map?.motion && !this.data.motion.backward.includes(frame)) return `frame ${frame} has no motion vectors`;
    if (slot.map?.base && !sides[base].frames.includes(frame)) return `${sides[base].label} has no frame ${frame}`;
    return slot.map?.before ? "the frame before is missing" : "there is no map of this frame";
  }

  // --- State --------------------------------------------------------------------------------------------------------

  set(changes, { force = false } = {}) {
    const before = this.state;
    this.state = { ...before, ...changes };
    const changed = (...keys) => force || keys.some((k) => String(before[k]) !== String(this.state[k]));
    if (changed("exposure", "tone", "base")) this.updateLook();
    if (changed("pixel", "track", "axis", "length") || (this.state.track && changed("origin"))) {
      this.panel.updatePixel().catch((error) => this.fail(error));
    }
    if (changed("exposure", "tone", "channel")) this.panel.showPixel();
    if (changed("metric", "log")) this.panel.showMetric();
    if (changed("frame")) this.panel.moveCursor();
    if (changed("panel")) document.body.classList.toggle("no-panel", !this.state.panel);
    this.updateControls();
    this.invalidate();
    this.saveSoon();
  }

  updateLook() {
    const { exposure, tone, base } = this.state;
    if (this.look?.exposure !== exposure || this.look?.tone !== tone) this.toneMap = new ToneMap(exposure, tone);
    this.look = { exposure, tone, base, toneMap: this.toneMap };
  }

  invalidate() {
    if (this.scheduled) return;
    this.scheduled = true;
    requestAnimationFrame(() => {
      this.scheduled = false;
      if (!this.viewer || !this.panel) return;
      if (this.viewer.draw() && !this.isReady) {
        this.isReady = true;
        performance.mark("first-picture");
        document.getElementById("loading").remove();
        this.markReady();
      }
    });
  }

  pick(x, y) {
    this.set({ pixel: [x, y], origin: this.state.frame });
  }

  get index() {
    return this.data.frames.indexOf(this.state.frame);
  }

  goTo(index) {
    const { frames } = this.data;
    this.set({ frame: frames[clamp(index, 0, frames.length - 1)] });
  }

  // --- Address ------------------------------------------------------------------------------------------------------

  /** What differs from the defaults, as the part of the address after '#'. */
  address() {
    const out = new URLSearchParams();
    for (const [key, value] of Object.entries(this.state)) {
      if (String(value) === String(this.defaults[key])) continue;
      const round = (v) => (typeof v === "number" ? Number(v.toFixed(4)) : v);
      out.set(key, Array.isArray(value) ? value.map(round).join(",") : String(round(value)));
    }
    for (const [id, { low, high }] of this.ranges) out.set(`range.${id}`, `${low},${high}`);
    const text = out.toString().replaceAll("%2C", ",");
    return text ? `#${text}` : "";
  }

  /** The state that an address asks for; what makes no sense is left out. */
  parse(hash) {
    const { data } = this, out = {};
    const wanted = new URLSearchParams(hash.replace(/^#/, ""));
    const oneOf = (key, values) => {
      const found = values.find((v) => String(v) === wanted.get(key));
      if (found !== undefined) out[key] = found;
    };
    const number = (key, low, high) => {
      const v = Number(wanted.get(key));
      if (wanted.has(key) && v >= low && v <= high) out[key] = v;
    };
    const pair = (key, high, whole) => {
      const v = (wanted.get(key) ?? "").split(",").map(Number);
      if (v.length === 2 && v.every((n, i) => n >= 0 && n < high[i] && (!whole || Number.isInteger(n)))) out[key] = v;
    };
    const sides = data.sides.map((_, i) => i), shows = ["picture", ...this.maps.map((m) => m.id)];
    oneOf("frame", data.frames);
    oneOf("origin", data.frames);
    oneOf("mode", ["split", "flip", "grid"]);
    for (const key of ["a", "b", "base"]) oneOf(key, sides);
    for (const key of ["showA", "showB"]) oneOf(key, shows);
    oneOf("tone", ["srgb", "filmic", "none"]);
    oneOf("axis", ["column", "row"]);
    oneOf("length", [31, 95, 0]);
    oneOf("channel", Object.keys(CHANNELS));
    oneOf("metric", data.metrics.map((m) => m.id));
    for (const key of ["flipped", "log", "panel"]) oneOf(key, [true, false]);
    if (this.hasMotion) oneOf("track", [true, false]);
    number("exposure", -30, 30);
    number("split", 0, 1);
    number("zoom", MIN_SCALE, MAX_SCALE);
    pair("pixel", [data.width, data.height], true);
    pair("center", [data.width + 1, data.height + 1], false);
    for (const map of this.maps) {
      const [low, high] = (wanted.get(`range.${map.id}`) ?? "").split(",").map(Number);
      if (isRange(map.range.scale, low, high)) this.ranges.set(map.id, { low, high });
    }
    return out;
  }

  saveSoon() {
    clearTimeout(this.saving);
    this.saving = setTimeout(() => {
      try {
        history.replaceState(null, "", this.address() || location.pathname + location.search);
      } catch {
        // Some browsers do not let pages from disk change their address. The button "Copy link" works without.
      }
    }, 250);
  }

  // --- Playing ------------------------------------------------------------------------------------------------------

  get fps() {
    return clamp(Number(document.getElementById("fps").value) || this.data.fps, 0.1, 120);
  }

  play(on) {
    const { frames } = this.data;
    this.playing = on && frames.length > 1;
    this.updateControls();
    if (!this.playing) return;
    let due = performance.now() + 1000 / this.fps;
    const tick = (now) => {
      if (!this.playing) return;
      const next = (this.index + 1) % frames.length;
      // Frames are shown when they are ready: slower the first time, but none is left out.
      for (let ahead = 2; ahead <= 4; ++ahead) this.isPainted(frames[(this.index + ahead) % frames.length]);
      if (this.isPainted(frames[next]) && now >= due - 2) {
        due = Math.max(due + 1000 / this.fps, now);
        this.goTo(next);
      }
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  isPainted(frame) {
    return this.slots().map((slot) => this.surfaces.get(slot, frame, this.look, false)).every((s) => s !== undefined);
  }

  /** Decodes all pictures while nothing else is to do, as long as they fit into memory. */
  async prefetchSoon() {
    const idle = () => new Promise((resolve) => {
      if (window.requestIdleCallback) requestIdleCallback(resolve, { timeout: 500 });
      else setTimeout(resolve, 30);
    });
    await this.ready;
    const { frames, sides } = this.data;
    for (let step = 0; step < frames.length; ++step) {
      const frame = frames[(this.index + step) % frames.length];
      for (let side = 0; side < sides.length; ++side) {
        await idle();
        if (this.store.cache.full) return;
        try {
          await this.store.picture(side, frame, false);
        } catch (error) {
          this.fail(error);
          return;
        }
      }
    }
  }

  blink(on) {
    this.blinking = on;
    clearInterval(this.blinkTimer);
    if (!on) return;
    this.set({ mode: "flip" });
    this.blinkTimer = setInterval(() => this.set({ flipped: !this.state.flipped }), 500);
  }

  flip() {
    if (this.state.mode === "flip") this.set({ flipped: !this.state.flipped });
    else this.set({ mode: "flip" });
  }

  // --- Controls -----------------------------------------------------------------------------------------------------

  connect() {
    const { data } = this, on = (id, event, action) => document.getElementById(id).addEventListener(event, action);
    document.getElementById("title").textContent = data.title;
    document.getElementById("title").title = data.title;
    const sideOptions = () => data.sides.map((s, i) => new Option(s.label, i));
    const fill = (id, options) => document.getElementById(id).replaceChildren(...options);
    for (const id of ["side-a", "side-b", "base"]) fill(id, sideOptions());
    for (const id of ["show-a", "show-b"]) {
      fill(id, [new Option("picture", "picture"), ...this.maps.map((m) => new Option(m.title, m.id))]);
    }
    for (const id of ["slot-b", "swap"]) document.getElementById(id).hidden = !this.hasChoice;
    const select = (id, key, convert = String) => on(id, "change", (e) => this.set({ [key]: convert(e.target.value) }));
    select("side-a", "a", Number);
    select("side-b", "b", Number);
    select("show-a", "showA");
    select("show-b", "showB");
    select("base", "base", Number);
    select("tone", "tone");
    for (const button of document.querySelectorAll("#modes button")) {
      button.addEventListener("click", () => {
        this.blink(false);
        if (button.dataset.mode === "flip") this.flip();
        else this.set({ mode: button.dataset.mode });
      });
    }
    on("swap", "click", () => this.swap());
    on("exposure", "input", (e) => this.set({ exposure: Number(e.target.value) }));
    on("fit", "click", () => this.set({ zoom: 0 }));
    on("actual", "click", () => this.set({ zoom: 1, center: this.viewer.center() }));
    on("link", "click", () => this.copyLink());
    on("toggle-panel", "click", () => this.set({ panel: !this.state.panel }));
    on("help-button", "click", () => this.help());
    for (const id of ["range-low", "range-high"]) on(id, "change", () => this.readRange());
    on("first", "click", () => this.goTo(0));
    on("previous", "click", () => this.goTo(this.index - 1));
    on("play", "click", () => this.play(!this.playing));
    on("next", "click", () => this.goTo(this.index + 1));
    on("last", "click", () => this.goTo(data.frames.length - 1));
    const scrubber = document.getElementById("scrubber");
    scrubber.max = data.frames.length - 1;
    scrubber.addEventListener("input", () => {
      const index = Number(scrubber.value);  // before the controls are brought in line with the state
      this.play(false);
      this.goTo(index);
    });
    document.getElementById("fps").value = Number(data.fps.toFixed(3));
    document.getElementById("transport").hidden = data.frames.length < 2;
    document.addEventListener("keydown", (event) => this.key(event));
    // After the mouse has used a control, the keys belong to the pictures again.
    document.addEventListener("click", (event) => {
      if (event.detail > 0) event.target.closest("button, summary, input[type=checkbox]")?.blur();
    });
    document.addEventListener("change", (event) => {
      if (event.target.matches("select, input[type=range]")) event.target.blur();
    });
    const edge = document.getElementById("edge"), panel = document.getElementById("panel");
    edge.addEventListener("pointerdown", (event) => edge.setPointerCapture(event.pointerId));
    edge.addEventListener("pointermove", (event) => {
      if (!edge.hasPointerCapture(event.pointerId)) return;
      panel.style.width = `${clamp(innerWidth - event.clientX, 300, innerWidth - 300)}px`;
    });
    const dialog = document.getElementById("help");
    const table = element("table");
    for (const [keys, text] of KEYS) {
      const row = table.insertRow();
      row.insertCell().append(element("kbd", { textContent: keys }));
      row.insertCell().textContent = text;
    }
    dialog.append(element("h2", { textContent: "Keys" }), table, element("p", {
      className: "note",
      textContent: "Drag to move, wheel to zoom, click to choose a pixel. Drag the line to move the split, " +
        "double-click it to center it.",
    }));
    dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());
  }

  swap() {
    const { a, b, showA, showB } = this.state;
    this.set({ a: b, b: a, showA: showB, showB: showA });
  }

  help() {
    document.getElementById("help").showModal();
  }

  async copyLink() {
    const link = location.href.replace(/#.*$/, "") + this.address(), button = document.getElementById("link");
    try {
      await navigator.clipboard.writeText(link);
      button.textContent = "Copied";
      setTimeout(() => (button.textContent = "Copy link"), 1200);
    } catch {
      prompt("The address of what is shown:", link);
    }
  }

  readRange() {
    const map = this.legendMap();
    const [low, high] = ["range-low", "range-high"].map((id) => Number(document.getElementById(id).value));
    if (map && isRange(map.range.scale, low, high)) this.ranges.set(map.id, { low, high });
    this.set({});
  }

  /** The map whose colors the legend explains. */
  legendMap() {
    return this.slots().find((slot) => slot.map)?.map ?? null;
  }

  updateControls() {
    const { data, state } = this, by = (id) => document.getElementById(id);
    for (const button of document.querySelectorAll("#modes button")) {
      const chosen = button.dataset.mode === state.mode;
      button.classList.toggle("on", chosen);
      button.setAttribute("aria-pressed", chosen);
      if (button.dataset.mode !== "grid") button.disabled = !this.hasChoice;
    }
    by("slot-a").classList.toggle("on", state.mode === "flip" && !state.flipped);
    by("slot-b").classList.toggle("on", state.mode === "flip" && state.flipped);
    by("side-a").disabled = state.mode === "grid";
    by("side-b").disabled = by("show-b").disabled = state.mode === "grid";
    const values = {
      "side-a": state.a, "side-b": state.b, "show-a": state.showA, "show-b": state.showB, base: state.base,
      tone: state.tone, exposure: state.exposure, scrubber: this.index,
    };
    for (const [id, value] of Object.entries(values)) by(id).value = value;
    by("exposure-value").textContent = `${state.exposure > 0 ? "+" : ""}${formatNumber(state.exposure, 3)}`;
    by("zoom-value").textContent = `${Math.round(100 * this.viewer.scale() * (window.devicePixelRatio || 1))} %`;
    by("frame-value").textContent = `frame ${state.frame}  (${this.index + 1} of ${data.frames.length})`;
    by("play").textContent = this.playing ? "❚❚ Stop" : "▶ Play";
    by("toggle-panel").setAttribute("aria-pressed", state.panel);

    const map = this.legendMap();
    by("legend").hidden = !map;
    if (!map) return;
    const range = this.rangeOf(map);
    by("map-title").textContent = map.title;
    by("map-help").textContent = map.help;
    by("map-against").hidden = !map.base && !map.stored;
    by("base").disabled = Boolean(map.stored);
    if (map.stored) by("base").value = data.reference;
    by("range-low").disabled = range.scale === "signed";
    by("range-low").value = range.scale === "signed" ? -range.high : range.low;
    by("range-high").value = range.high;
    by("ramp").style.background = rampGradient(range);
  }

  // --- Keys ---------------------------------------------------------------------------------------------------------

  key(event) {
    const typing = event.target.matches?.("input:not([type=range]):not([type=checkbox]), select");
    if (typing || event.ctrlKey || event.metaKey || event.altKey || document.getElementById("help").open) return;
    const { data, state } = this;
    const digit = /^Digit([0-9])$/.exec(event.code);
    if (digit) {
      const n = Number(digit[1]), side = n === 0 ? data.reference : n - 1;
      if (side !== null && side < data.sides.length) this.set({ [event.shiftKey ? "b" : "a"]: side });
      event.preventDefault();
      return;
    }
    const cycle = (values, now, step = 1) => values[(values.indexOf(now) + step + values.length) % values.length];
    const pan = (dx, dy) => {
      const scale = this.viewer.scale(), [x, y] = this.viewer.center();
      this.viewer.look(scale, [x + (dx * 80) / scale, y + (dy * 80) / scale]);
    };
    const actions = {
      " ": () => this.play(!this.playing),
      ArrowLeft: () => (event.shiftKey ? pan(-1, 0) : this.goTo(this.index - 1)),
      ArrowRight: () => (event.shiftKey ? pan(1, 0) : this.goTo(this.index + 1)),
      ArrowUp: () => event.shiftKey && pan(0, -1),
      ArrowDown: () => event.shiftKey && pan(0, 1),
      Home: () => this.goTo(0),
      End: () => this.goTo(data.frames.length - 1),
      s: () => this.set({ mode: "split" }),
      f: () => this.flip(),
      g: () => this.set({ mode: "grid" }),
      b: () => this.blink(!this.blinking),
      x: () => this.swap(),
      e: () => {
        // What maps compare with has no error: it stays a picture.
        const show = cycle(["picture", ...this.maps.map((m) => m.id)], state.showA, event.shiftKey ? -1 : 1);
        const map = this.mapOf(show), against = map?.stored ? data.reference : map?.base ? state.base : null;
        this.set({ showA: show, showB: state.b === against ? "picture" : show });
      },
      "[": () => this.set({ exposure: clamp(state.exposure - 0.5, -30, 30) }),
      "]": () => this.set({ exposure: clamp(state.exposure + 0.5, -30, 30) }),
      "\\": () => this.set({ exposure: data.display.exposure }),
      t: () => this.set({ tone: cycle(["srgb", "filmic", "none"], state.tone) }),
      "+": () => this.viewer.zoomBy(1.25),
      "=": () => this.viewer.zoomBy(1.25),
      "-": () => this.viewer.zoomBy(0.8),
      z: () => this.set({ zoom: 0 }),
      o: () => this.set({ zoom: 1, center: this.viewer.center() }),
      m: () => this.hasMotion && this.set({ track: !state.track }),
      p: () => this.set({ panel: !state.panel }),
      l: () => this.copyLink(),
      "?": () => this.help(),
    };
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key, action = actions[key];
    const control = event.target.closest?.("button, summary, input");
    // A control that was reached by keyboard keeps the keys that it knows; the scrubber's do what ours do.
    const isSlider = control?.type === "range" && control.id !== "scrubber";
    if ((control && key === " ") || (isSlider && /^Arrow|Home|End/.test(key))) return;
    if (!action) return;
    event.preventDefault();
    if (this.blinking && key !== "b") this.blink(false);
    action();
  }

  // --- For scripts --------------------------------------------------------------------------------------------------

  /** Resolves when everything that the state asks for is on the screen. */
  async settled() {
    await this.ready;
    const pause = () => new Promise((resolve) => setTimeout(resolve, 15));
    do {
      await pause();
    } while (this.scheduled || !this.viewer.complete || !this.panel.pixelDone || this.surfaces.pending.size > 0);
    await new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)));
  }
}

/** Whether colors can go from low to high. */
function isRange(scale, low, high) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return false;
  return scale === "signed" ? high > 0 : scale === "log" ? low > 0 && high > low : low !== high;
}

const app = new App(JSON.parse(document.getElementById("report-data").textContent));

/** What scripts can do with the page; docs/report.md. */
window.temperaReport = {
  ready: app.ready,
  data: app.data,
  maps: app.maps.map(({ id, title }) => ({ id, title })),
  get state() {
    return structuredClone(app.state);
  },
  get errors() {
    return app.errors.map(String);
  },
  set: (changes) => app.set(changes),
  settled: () => app.settled(),
  /** [r, g, b] of a pixel, null where the side has no such frame. */
  async pixel(side, frame, x, y) {
    const picture = await app.store.picture(side, frame);
    return picture && picture.rgb(y * app.data.width + x);
  },
  /** Values of a map, [height * width], or null. */
  async map(id, side, frame, { base = app.state.base } = {}) {
    const values = await computeMap(app.store, app.mapOf(id), { side, base, frame });
    return values && Array.from(values);
  },
  /** { positions, series, values, size } of a slice; see tracks.js. */
  async slice(side, x, y, { origin = app.state.frame, track = false, axis = "column", length = 95 } = {}) {
    const positions = await trackPixel(app.store, [x, y], origin, track);
    const { series, values, size } = await sliceAlong(app.store, side, positions, { axis, length });
    return { positions, series, values: Array.from(values), size };
  },
};

if (window.DecompressionStream) {
  app.start();
} else {
  document.getElementById("loading").textContent =
    "This browser cannot unpack the pictures. Chromium 103, Firefox 113, Safari 16.4 and later ones can.";
}
