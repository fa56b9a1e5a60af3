// SPDX-License-Identifier: Apache-2.0
// The images of the page: decoded when they are first needed, kept while there is room.

/** Least recently used values by key, within a bound on the bytes that they take. */
class Cache {
  constructor(limit) {
    this.limit = limit;
    this.size = 0;
    this.entries = new Map();
  }

  get(key) {
    const entry = this.entries.get(key);
    if (!entry) return undefined;
    this.entries.delete(key);  // a Map keeps the order of insertion: to the end with it
    this.entries.set(key, entry);
    return entry.value;
  }

  set(key, value, bytes) {
    this.delete(key);
    this.entries.set(key, { value, bytes });
    this.size += bytes;
    for (const oldest of this.entries.keys()) {
      if (this.size <= this.limit || oldest === key) break;
      this.delete(oldest);
    }
  }

  delete(key) {
    const entry = this.entries.get(key);
    if (!entry) return;
    this.entries.delete(key);
    this.size -= entry.bytes;
  }

  get full() {
    return this.size > 0.9 * this.limit;
  }
}

/** Decodes blocks, a few at a time: what is on the screen goes before what may be wanted later. */
class Store {
  constructor(data) {
    this.data = data;
    this.cache = new Cache(768 << 20);
    this.pending = new Map();  // id -> { promise, start, urgent }
    this.queue = [];
    this.running = 0;
    this.parsed = document.readyState !== "loading";
    document.addEventListener("DOMContentLoaded", () => {
      this.parsed = true;
      this.pump();
    });
  }

  /** Id of the block of a side's picture, or null if the side has none of that frame. */
  pictureId(side, frame) {
    const { frames, stored } = this.data.sides[side];
    const i = frames.indexOf(frame);
    return i < 0 ? null : `picture-${side === this.data.reference ? "reference" : side}-${stored[i]}`;
  }

  /** The picture if it is decoded, null if there is none, undefined if it has yet to be decoded. */
  peek(side, frame) {
    const id = this.pictureId(side, frame);
    return id === null ? null : this.cache.get(id);
  }

  /** Promise of a Picture or Vectors; of null if the page has no such block. */
  get(id, urgent = true) {
    if (id === null) return Promise.resolve(null);
    const known = this.cache.get(id);
    if (known !== undefined) return Promise.resolve(known);
    let job = this.pending.get(id);
    if (!job) {
      job = { id, urgent };
      job.promise = new Promise((resolve, reject) => Object.assign(job, { resolve, reject }));
      this.pending.set(id, job);
      this.queue.push(job);
      this.pump();
    }
    job.urgent ||= urgent;
    return job.promise;
  }

  picture(side, frame, urgent = true) {
    return this.get(this.pictureId(side, frame), urgent);
  }

  /** Vectors from a frame to its neighbor, `direction` "forward" or "backward", or null. */
  motion(direction, frame, urgent = true) {
    return this.get(this.data.motion[direction].includes(frame) ? `motion-${direction}-${frame}` : null, urgent);
  }

  map(metric, side, frame, urgent = true) {
    const known = this.data.maps.find((m) => m.id === metric)?.frames[side]?.includes(frame);
    return this.get(known ? `map-${metric}-${side}-${frame}` : null, urgent);
  }

  get busy() {
    return this.pending.size > 0;
  }

  pump() {
    while (this.running < 4 && this.queue.length > 0) {
      // The newest urgent job: after quick scrubbing, the frame on the screen comes first.
      let at = this.queue.findLastIndex((job) => job.urgent);
      if (at < 0) at = 0;
      const [job] = this.queue.splice(at, 1);
      ++this.running;
      this.decode(job).finally(() => {
        --this.running;
        this.pump();
      });
    }
  }

  async decode(job) {
    try {
      // A large page is used before all of it has been read: the block may be missing, or have no end yet.
      let element = document.getElementById(job.id);
      while (!this.parsed && !element?.nextSibling) {
        await new Promise((resolve) => setTimeout(resolve, 20));
        element = document.getElementById(job.id);
      }
      if (!element) throw new Error(`the page has no block "${job.id}"`);
      const image = await decodeBlock(element, this.data.width, this.data.height);
      this.cache.set(job.id, image, image.bytes);
      this.pending.delete(job.id);
      job.resolve(image);
    } catch (error) {
      this.pending.delete(job.id);
      job.reject(error);
    }
  }
}
