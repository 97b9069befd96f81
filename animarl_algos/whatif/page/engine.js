// The simulator of a what-if page: worlds, policies and rollouts, without a DOM.
//
// It computes what animarl_envs.worlds and animarl_algos.networks compute; a test compares both, step by
// step. Positions and velocities are float64, observations and networks float32, as there. Arrays:
// position[2 (b K + i) + x] for copy b of B and individual i of K, observation[(b K + i) n + c].
"use strict";
const AnimaRL = (() => {
  const ABSENT = -1, TIME_OUT = 0, TARGET_OUT = -1, PURSUER_OUT = -2;
  const REST = 0.3, HARDEST = 4, FAINT = 0.1, DIRECTIONS = 12;

  // -- data ----------------------------------------------------------------------------------------

  const TYPES = { f4: Float32Array, f8: Float64Array, i1: Int8Array, u1: Uint8Array, i8: null };

  /** Return the model with every packed array {dtype, shape, data} unpacked to a typed array. */
  async function unpack(node) {
    if (Array.isArray(node)) return Promise.all(node.map(unpack));
    if (node === null || typeof node !== "object") return node;
    if (typeof node.data === "string" && node.dtype) {
      const bytes = Uint8Array.from(atob(node.data), (c) => c.charCodeAt(0));
      const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
      const array = new TYPES[node.dtype](await new Response(stream).arrayBuffer());
      array.shape = node.shape;
      return array;
    }
    const entries = Object.entries(node).map(async ([key, value]) => [key, await unpack(value)]);
    return Object.fromEntries(await Promise.all(entries));
  }

  // -- random numbers ------------------------------------------------------------------------------

  /** Return a generator of uniform numbers in [0, 1), one stream for each triple of whole numbers. */
  function stream(seed, start, repetition) {
    let state = (Math.imul(seed + 1, 0x9e3779b1) ^ Math.imul(start + 1, 0x85ebca6b)) >>> 0;
    state = (state ^ Math.imul(repetition + 1, 0xc2b2ae35)) >>> 0;
    return () => {
      state = (state + 0x6d2b79f5) >>> 0;
      let z = Math.imul(state ^ (state >>> 15), 1 | state);
      z = (z + Math.imul(z ^ (z >>> 7), 61 | z)) ^ z;
      return ((z ^ (z >>> 14)) >>> 0) / 4294967296;
    };
  }

  // -- matrix products -----------------------------------------------------------------------------

  // gemm.wat (sha256 67dd5371141d64373c1340e23130e36b5b621bdaead1e72e613a15ff0375527e) in WebAssembly, written by `python tools/assemble_gemm.py`
  const GEMM = "AGFzbQEAAAABDQFgCX9/f39/f39/fwACCAEBZQFtAgABAwIBAAcIAQRnZW1tAAAKpwQBpAQCCX8LeyAERQRADwsgBkECdCEMIAdBAXQhECAQIAdqIREDQEEAIQoDQCACIApqIQ4gDv0AAgAhGiAO/QACECEbIBohEiAbIRMgGiEUIBshFSAaIRYgGyEXIBohGCAbIRkgASAKaiEOIAAgCSAHbGohDUEAIQsCQANAIAsgBU8NASAO/QACACEaIA79AAIQIRsgDf0JAgAhHCASIBogHP3mAf3kASESIBMgGyAc/eYB/eQBIRMgDSAHav0JAgAhHCAUIBogHP3mAf3kASEUIBUgGyAc/eYB/eQBIRUgDSAQav0JAgAhHCAWIBogHP3mAf3kASEWIBcgGyAc/eYB/eQBIRcgDSARav0JAgAhHCAYIBogHP3mAf3kASEYIBkgGyAc/eYB/eQBIRkgDUEEaiENIA4gDGohDiALQQFqIQsMAAsLIAgEQP0MAAAAAAAAAAAAAAAAAAAAACEcIBIgHP3pASESIBMgHP3pASETIBQgHP3pASEUIBUgHP3pASEVIBYgHP3pASEWIBcgHP3pASEXIBggHP3pASEYIBkgHP3pASEZCyADIApqIAkgDGxqIQ8gDyAS/QsCACAPIBP9CwIQIA8gDGohDyAPIBT9CwIAIA8gFf0LAhAgDyAMaiEPIA8gFv0LAgAgDyAX/QsCECAPIAxqIQ8gDyAY/QsCACAPIBn9CwIQIApBIGohCiAKIAxJDQALIAlBBGohCSAJIARJDQALCwDdAQRuYW1lAqABAQAdAAF4AQF3AgFiAwF5BARyb3dzBQZpbnB1dHMGB291dHB1dHMHBnN0cmlkZQgEcmVsdQkDcm93CgZjb2x1bW4LBWlucHV0DAV3aWR0aA0CeHAOAndwDwJ5cBAHc3RyaWRlMhEHc3RyaWRlMxIDczAwEwNzMDEUA3MxMBUDczExFgNzMjAXA3MyMRgDczMwGQNzMzEaAncwGwJ3MRwBdgMzAQAEAQlyb3dzX2xlZnQCDGNvbHVtbnNfbGVmdAMIbm9faW5wdXQEC2lucHV0c19sZWZ0";

  /** Memory with matrix products on it; plain JavaScript where there is no SIMD. */
  class Products {
    constructor(floats) {
      const pages = Math.ceil((4 * floats + 64) / 65536) + 1;
      this.memory = new WebAssembly.Memory({ initial: pages });
      this.floats = new Float32Array(this.memory.buffer);
      this.end = 4; // address 0 stays unused [floats]
      try {
        const module = new WebAssembly.Module(Uint8Array.from(atob(GEMM), (c) => c.charCodeAt(0)));
        this.gemm = new WebAssembly.Instance(module, { e: { m: this.memory } }).exports.gemm;
      } catch {
        this.gemm = null;
      }
    }

    /** Reserve floats; return the index of the first. */
    take(count) {
      const at = this.end;
      this.end += (count + 3) & ~3;
      if (this.end > this.floats.length) throw new Error("too little memory was asked for");
      return at;
    }

    /** y (rows, m) = x (rows, n) w (n, m) + b, below zero cut off with relu; places are indices. */
    affine(x, layer, y, rows, relu) {
      const { weight, bias, inputs, outputs } = layer;
      const padded = (rows + 3) & ~3;
      if (this.gemm) {
        this.gemm(4 * x, 4 * weight, 4 * bias, 4 * y, padded, inputs, outputs, 4 * layer.stride, +relu);
        return;
      }
      const f = this.floats;
      for (let r = 0; r < rows; r++) {
        const out = y + r * outputs, from = x + r * layer.stride;
        for (let j = 0; j < outputs; j++) f[out + j] = f[bias + j];
        for (let i = 0; i < inputs; i++) {
          const value = f[from + i];
          if (value === 0) continue;
          const row = weight + i * outputs;
          for (let j = 0; j < outputs; j++) f[out + j] += value * f[row + j];
        }
        if (relu) for (let j = 0; j < outputs; j++) if (f[out + j] < 0) f[out + j] = 0;
      }
    }
  }

  const eight = (count) => (count + 7) & ~7;

  // -- policies ------------------------------------------------------------------------------------

  /** The networks of all individuals, and how they choose among action values. */
  class Policy {
    constructor(model, copies) {
      this.model = model;
      this.net = model.network;
      this.copies = copies;
      const net = this.net, K = model.individuals.length;
      const { size, units, actions } = net;
      const rows = (copies + 3) & ~3;
      const widest = Math.max(size + actions, 3 * units, net.head_inputs, net.head_units, 16) + 8;
      let floats = 6 * rows * eight(widest) + 4096;
      for (const layer of Object.values(net.layers)) {
        floats += K * (layer.weight.shape[1] + 1) * eight(layer.weight.shape[2]) + 16;
      }
      this.products = new Products(floats);
      this.layers = Array.from({ length: K }, (_, k) => this.#place(k));
      this.width = eight(widest);
      this.a = this.products.take(rows * this.width);
      this.b = this.products.take(rows * this.width);
      this.c = this.products.take(rows * this.width);
      this.d = this.products.take(rows * this.width);
      this.hidden = new Float32Array(copies * K * units);
      this.previous = new Int16Array(copies * K);
      this.values = new Float32Array(copies * K * actions);
      this.reset();
    }

    #place(k) {
      const placed = {}, f = this.products.floats;
      for (const [name, { weight, bias }] of Object.entries(this.net.layers)) {
        const [nets, inputs, outputs] = weight.shape, padded = eight(outputs), own = k % nets;
        const at = this.products.take(inputs * padded), zero = this.products.take(padded);
        for (let i = 0; i < inputs; i++) {
          for (let j = 0; j < outputs; j++) {
            f[at + i * padded + j] = weight[(own * inputs + i) * outputs + j];
          }
        }
        for (let j = 0; j < outputs; j++) f[zero + j] = bias[k * outputs + j];
        placed[name] = { weight: at, bias: zero, inputs, outputs: padded, stride: inputs };
      }
      return placed;
    }

    /** Forget everything. */
    reset() {
      this.hidden.fill(0);
      this.previous.fill(this.net.actions);
    }

    /** Compute action values of all individuals in the copies listed; flag is the condition told. */
    decide(observation, flags, copies) {
      const net = this.net, model = this.model, K = model.individuals.length;
      const { size, units, actions } = net, f = this.products.floats, n = model.components;
      const count = copies.length, sensed = net.sensed;
      const encoderInputs = sensed + (net.previous_action ? actions : 0);
      for (let k = 0; k < K; k++) {
        const layers = this.layers[k];
        for (let r = 0; r < count; r++) {
          const slot = copies[r] * K + k, row = this.a + r * encoderInputs;
          for (let c = 0; c < sensed; c++) {
            const value = c < n ? observation[slot * n + c] : flags[copies[r]];
            let z = Math.fround(value - net.input_mean[k * size + c]) / net.input_sd[k * size + c];
            if (net.input_limit !== null) z = Math.min(net.input_limit, Math.max(-net.input_limit, z));
            f[row + c] = z;
          }
          if (net.previous_action) {
            f.fill(0, row + sensed, row + encoderInputs);
            if (this.previous[slot] < actions) f[row + sensed + this.previous[slot]] = 1;
          }
        }
        let x = this.a, y = this.b;
        for (let layer = 1; layer <= net.depth; layer++) {
          const weights = layers[`encoder_${layer}`];
          weights.stride = layer === 1 ? encoderInputs : eight(units);
          this.products.affine(x, weights, y, count, true);
          [x, y] = [y, x === this.a ? this.c : x];
        }
        let seen = x, stride = eight(units), width = units;
        if (net.recurrent) {
          [seen, stride, width] = this.#remember(k, x, y, copies);
        }
        const read = this.#head(k, seen, stride, width, flags, copies);
        const outputs = layers.head.outputs;
        this.products.affine(read.at, Object.assign(layers.head, { stride: read.stride }), this.d, count, false);
        for (let r = 0; r < count; r++) {
          const slot = copies[r] * K + k;
          for (let a = 0; a < actions; a++) this.values[slot * actions + a] = f[this.d + r * outputs + a];
        }
      }
      return this.values;
    }

    #remember(k, x, spare, copies) {
      const net = this.net, units = net.units, f = this.products.floats, count = copies.length;
      const layers = this.layers[k], K = this.model.individuals.length;
      const input = Object.assign(layers.gru_input, { stride: eight(units) });
      const state = Object.assign(layers.gru_hidden, { stride: units });
      const gates = input.outputs;
      this.products.affine(x, input, this.d, count, false);
      for (let r = 0; r < count; r++) {
        const slot = copies[r] * K + k;
        for (let j = 0; j < units; j++) f[spare + r * units + j] = this.hidden[slot * units + j];
      }
      const other = [this.a, this.b, this.c].find((place) => place !== x && place !== spare);
      this.products.affine(spare, state, other, count, false);
      const width = units * (net.skip ? 2 : 1);
      const sigmoid = (z) => 1 / (1 + Math.exp(-z));
      for (let r = 0; r < count; r++) {
        const slot = copies[r] * K + k, from = this.d + r * gates, old = other + r * gates;
        for (let j = 0; j < units; j++) {
          const reset = sigmoid(f[from + j] + f[old + j]);
          const update = sigmoid(f[from + units + j] + f[old + units + j]);
          const fresh = Math.tanh(f[from + 2 * units + j] + reset * f[old + 2 * units + j]);
          const h = this.hidden[slot * units + j];
          this.hidden[slot * units + j] = fresh + update * (h - fresh);
          f[spare + r * width + (width - units) + j] = this.hidden[slot * units + j];
          if (net.skip) f[spare + r * width + j] = f[x + r * eight(units) + j];
        }
      }
      return [spare, width, width];
    }

    /** Put what the head reads into one place: features, flag and, without a hidden layer, both. */
    #head(k, seen, stride, width, flags, copies) {
      const net = this.net, f = this.products.floats, count = copies.length;
      let at = seen, wide = stride;
      if (net.flag_in_head) {
        const inputs = net.head_inputs;
        at = [this.a, this.b, this.c].find((place) => place !== seen);
        for (let r = 0; r < count; r++) {
          const flag = flags[copies[r]], from = seen + r * stride, to = at + r * inputs;
          for (let j = 0; j < width; j++) f[to + j] = f[from + j];
          f[to + width] = flag;
          if (net.gated) for (let j = 0; j < width; j++) f[to + width + 1 + j] = flag * f[from + j];
        }
        wide = inputs;
      }
      if (!net.head_units) return { at, stride: wide };
      const hidden = Object.assign(this.layers[k].head_hidden, { stride: wide });
      const out = [this.a, this.b, this.c].find((place) => place !== at);
      this.products.affine(at, hidden, out, count, true);
      return { at: out, stride: hidden.outputs };
    }

    /** Choose one action for a slot from its values with one uniform draw. */
    choose(slot, individual, draw, warmth = 1) {
      const { acting, network } = this.model, A = network.actions, at = slot * A;
      const q = this.values.subarray(at, at + A);
      let best = 0;
      for (let a = 1; a < A; a++) if (q[a] > q[best]) best = a;
      if (acting.kind === "greedy") return best;
      if (acting.kind === "epsilon") {
        if (!(draw < acting.epsilon)) return best;
        return Math.min(Math.floor((draw / acting.epsilon) * A), A - 1);
      }
      const each = acting.temperature;
      const temperature = warmth * each[each.length === 1 ? 0 : individual];
      let scaled = Array.from(q, (value) => value / temperature);
      if (acting.thrust !== 1 || acting.direction !== 1) {
        scaled = twoStages(scaled, acting.thrust, acting.direction);
      }
      const most = Math.max(...scaled);
      let total = 0;
      const cumulative = scaled.map((value) => (total += Math.exp(value - most)));
      let chosen = 0;
      while (chosen < A - 1 && cumulative[chosen] <= draw * total) chosen++;
      return chosen;
    }
  }

  function logSumExp(values) {
    const most = Math.max(...values);
    return most + Math.log(values.reduce((sum, value) => sum + Math.exp(value - most), 0));
  }

  /** Draw a thrust's magnitude before its direction, each at its own temperature. */
  function twoStages(scaled, thrust, direction) {
    const magnitudes = (scaled.length - 1) / DIRECTIONS, out = scaled.slice();
    const ways = Array.from({ length: magnitudes }, (_, m) =>
      scaled.slice(m * DIRECTIONS, (m + 1) * DIRECTIONS));
    let hard = [...ways.map(logSumExp), scaled[scaled.length - 1]].map((value) => value / thrust);
    const all = logSumExp(hard);
    hard = hard.map((value) => value - all);
    ways.forEach((way, m) => {
      const cooled = way.map((value) => value / direction), sum = logSumExp(cooled);
      cooled.forEach((value, d) => (out[m * DIRECTIONS + d] = hard[m] + value - sum));
    });
    out[scaled.length - 1] = hard[magnitudes];
    return out;
  }

  // -- worlds --------------------------------------------------------------------------------------

  /** What both worlds share: state, starts from recordings, warm-up. */
  class World {
    constructor(model, options, copies) {
      this.model = model;
      this.copies = copies;
      this.dt = model.dt;
      this.damping = Float64Array.from(options.damping);
      this.thrust = Float64Array.from(options.thrust);
      this.size = options.arena;
      this.contact = options.contact;
      this.limit = options.time_limit;
      const K = (this.K = model.individuals.length);
      this.n = model.components;
      this.position = new Float64Array(copies * K * 2);
      this.velocity = new Float64Array(copies * K * 2);
      this.push = new Float64Array(copies * K * 2); // acceleration of the last step [thrust]
      this.traits = new Float64Array(copies * K * 2); // of each individual [sd]
      this.observation = new Float32Array(copies * K * this.n);
      this.steps = new Int32Array(copies);
      this.start = new Int32Array(copies).fill(-1);
      this.condition = new Int8Array(copies);
      this.outcome = new Int8Array(copies);
      this.over = new Uint8Array(copies);
      this.absent = new Uint8Array(K);
      options.absent.forEach((i) => (this.absent[i] = 1));
    }

    /**
     * Start copy b from a recorded start, or from given places [K][2] at rest. Traits are those of
     * training animals that random numbers choose, or of the mean animal without any.
     */
    begin(b, start, places = null, condition = null, random = null) {
      const K = this.K, starts = this.model.starts;
      this.steps[b] = 0;
      this.outcome[b] = TIME_OUT;
      this.over[b] = 0;
      this.start[b] = places ? -1 : start;
      this.condition[b] = condition === null ? starts.condition[start] : condition;
      const frames = starts.frames, at = start * frames * K * 2;
      for (let i = 0; i < K; i++) {
        for (let x = 0; x < 2; x++) {
          const own = 2 * (b * K + i) + x;
          this.position[own] = places ? places[i][x] : starts.position[at + 2 * i + x];
          this.velocity[own] = places ? 0 : starts.velocity[at + 2 * i + x];
          this.push[own] = 0;
        }
      }
      this.traits.fill(0, 2 * b * K, 2 * (b + 1) * K);
      const table = this.model.traits, alike = table !== null && table[0].length === 1;
      let drawn = null;
      for (let i = 0; i < (table !== null && random !== null ? K : 0); i++) {
        if (i === 0 || alike) drawn = table[Math.floor(random() * table.length)];
        this.traits.set(drawn[alike ? 0 : i], 2 * (b * K + i));
      }
      this.woken(b, start);
      this.placeAbsent(b);
      this.observe(b);
    }

    /** Nobody is removed from a world in which nobody is pursued by several. */
    placeAbsent() {}

    /** Whether the frame that a step leads to is replayed, and its place in the starts. */
    replayed(b) {
      const starts = this.model.starts;
      if (this.start[b] < 0 || this.steps[b] > this.model.warmup) return -1;
      if (this.steps[b] >= starts.recorded[this.start[b]]) return -1;
      return (this.start[b] * starts.frames + this.steps[b]) * this.K * 2;
    }

    follow(b, at) {
      const K = this.K;
      for (let k = 0; k < 2 * K; k++) {
        this.position[2 * b * K + k] = this.model.starts.position[at + k];
        this.velocity[2 * b * K + k] = this.model.starts.velocity[at + k];
      }
    }

    /** Whether the next step is a warm-up step, in which actions have no effect. */
    warming(b) {
      const recorded = this.start[b] < 0 ? 0 : this.model.starts.recorded[this.start[b]];
      return this.start[b] >= 0 && this.steps[b] < this.model.warmup && recorded - this.steps[b] > 1;
    }
  }

  const egocentric = (x, y, ex, ey) => [Math.fround(x * ex + y * ey), Math.fround(y * ex - x * ey)];
  const squash = (x) => Math.tanh(x), tripled = (t) => (t * (3 + t * t)) / (1 + 3 * t * t);
  const averaged = (mean, value, share, steps) => mean + Math.max(share, 1 / (1 + steps)) * (value - mean);
  const held = (value) => Math.min(HARDEST, Math.max(-HARDEST, value));

  /** Pursuers and a target, a pursuer of several, or animals of which nobody is pursued. */
  class Chase extends World {
    constructor(model, options, copies) {
      super(model, options, copies);
      const K = this.K, { past, memory, delays } = model.senses;
      const scales = (this.scales = past.length + 2 * memory.length + delays.length / 2);
      this.boundary = options.boundary;
      this.edge = model.arena.rebound ? this.size : this.boundary ?? Infinity;
      const factor = this.size / model.arena.size, deep = model.arena.walled ? 0 : 1 - this.size / this.boundary;
      this.landmarks = options.landmarks.map((at) => at.map((value) => factor * value));
      this.holes = options.obstacles.map(([x, y, radius]) => [factor * x, factor * y, factor * (radius - Math.min(radius * deep, model.arena.size * deep / (1 - deep)))]);
      this.past = new Float64Array(copies * scales * K * 2);
      this.towards = new Float64Array(copies * K * 2);
      this.before = new Float64Array(K * 2);
    }

    woken(b) {
      const K = this.K, scales = this.scales, at = 2 * b * K, v = this.velocity;
      for (let s = 0; s < scales; s++) {
        const base = (b * scales + s) * 2 * K, own = this.model.senses.memory.length;
        const turning = this.model.free && s >= own, delayed = turning && s >= 2 * own;
        for (let k = 0; k < 2 * K; k += 2) {
          const speed = Math.hypot(v[at + k], v[at + k + 1]);
          this.past[base + k] = delayed ? speed : turning ? 0 : v[at + k];
          this.past[base + k + 1] = turning ? speed : v[at + k + 1];
        }
      }
      for (let i = 0; i < K; i++) this.towards[2 * (b * K + i)] = 1;
    }

    /** Update the averages of the past with the present, before a step is taken. */
    #remember(b) {
      const { K, scales, velocity, past } = this, { past: over, memory, delays, on_course } = this.model.senses;
      over.forEach((steps, s) => {
        const base = (b * scales + s) * 2 * K;
        for (let k = 0; k < 2 * K; k++) past[base + k] += (1 / steps) * (velocity[2 * b * K + k] - past[base + k]);
      });
      for (let i = 0; i < (memory.length ? K : 0); i++) {
        const [vx, vy] = velocity.subarray(2 * (b * K + i)), count = this.steps[b] - 1;
        const place = (s) => ((b * scales + s) * K + i) * 2;
        const [mx, my] = past.subarray(place(on_course)), share = memory[on_course];
        const nx = averaged(mx, vx, share, count), ny = averaged(my, vy, share, count);
        const turned = Math.atan2(Math.fround(mx * ny - my * nx), Math.fround(mx * nx + my * ny)) / this.dt;
        [vx, vy, turned, Math.sqrt(vx * vx + vy * vy)].forEach((value, x) => memory.forEach((part, s) => {
          const to = place(s + (x > 1 ? memory.length : 0)) + (x & 1);
          past[to] = averaged(past[to], value, part, count);
        }));
        delays.reduce((speed, part, k) => { // each follows what the one before was
          const to = place(2 * memory.length + (k >> 1)) + (k & 1), was = past[to];
          past[to] += part * (speed - was);
          return was;
        }, Math.sqrt(vx * vx + vy * vy));
      }
    }

    /** The course of a free animal: its mean velocity, the present one included. */
    #course(b, i) {
      const { memory, on_course } = this.model.senses, own = 2 * (b * this.K + i);
      const at = ((b * this.scales + on_course) * this.K + i) * 2;
      const [x, y] = [0, 1].map((k) => averaged(this.past[at + k], this.velocity[own + k], memory[on_course], this.steps[b]));
      const length = Math.sqrt(x * x + y * y);
      return length > 0 ? [x / length, y / length] : [1, 0];
    }

    /** One step of copy b; actions [K]. */
    step(b, actions) {
      const K = this.K, model = this.model, senses = model.senses, at = 2 * b * K, dt = this.dt;
      const { position, velocity, towards } = this;
      this.steps[b] += 1;
      this.#remember(b);
      for (let i = 0; i < K; i++) {
        const own = at + 2 * i, [ahead, left] = model.pushes[i][actions[i]];
        const ex = towards[own], ey = towards[own + 1];
        const ax = ahead * ex - left * ey, ay = ahead * ey + left * ex;
        this.before[2 * i] = velocity[own];
        this.before[2 * i + 1] = velocity[own + 1];
        velocity[own] = (1 - this.damping[i]) * velocity[own] + this.thrust[i] * ax * dt;
        velocity[own + 1] = (1 - this.damping[i]) * velocity[own + 1] + this.thrust[i] * ay * dt;
        position[own] += velocity[own] * dt;
        position[own + 1] += velocity[own + 1] * dt;
        if (model.arena.walled) for (let turn = 0; turn < (this.holes.length ? 3 : 1); turn++) this.#rebound(own);
      }
      const recorded = this.replayed(b);
      if (recorded >= 0) this.follow(b, recorded);
      for (let k = 0; k < 2 * K; k++) {
        const i = k >> 1, was = recorded >= 0; // a recorded animal had the body of the recordings
        const kept = (1 - (was ? senses.damping[i] : this.damping[i])) * this.before[k] + 0;
        this.push[at + k] = (velocity[at + k] - kept) / (was ? senses.push[i] : this.thrust[i] * dt);
      }
      this.placeAbsent(b);
      const outcome = this.#judge(b);
      this.outcome[b] = outcome;
      this.over[b] = outcome !== TIME_OUT || this.steps[b] >= this.limit ? 1 : 0;
      this.observe(b);
    }

    /** Put the removed beyond the pursuer nearest to the target, and far from it: see whatif/absent.py. */
    placeAbsent(b) {
      if (!this.absent.includes(1)) return;
      const K = this.K, at = 2 * b * K, p = this.position, v = this.velocity, last = at + 2 * K - 2;
      const { farthest, beyond, aside } = this.model.absent;
      let nearest = 0, least = Infinity;
      for (let i = 0; i < K - 1; i++) {
        const apart = Math.hypot(p[at + 2 * i] - p[last], p[at + 2 * i + 1] - p[last + 1]);
        if (!this.absent[i] && apart < least) [nearest, least] = [at + 2 * i, apart];
      }
      const ex = least > 0 ? (p[nearest] - p[last]) / least : 1, ey = least > 0 ? (p[nearest + 1] - p[last + 1]) / least : 0;
      const far = Math.max(beyond * least, farthest), c = Math.cos(aside), s = Math.sin(aside);
      for (let i = 0; i < K - 1; i++) {
        if (!this.absent[i]) continue;
        const own = at + 2 * i;
        p[own] = p[last] + (ex * c - ey * s) * far;
        p[own + 1] = p[last + 1] + (ex * s + ey * c) * far;
        for (let x = 0; x < 2; x++) [v[own + x], this.push[own + x]] = [v[nearest + x], 0];
      }
    }

    #rebound(own) {
      const { position, velocity } = this, size = this.size;
      for (const hole of this.holes) this.#hold(own, hole, -1);
      if (this.model.arena.shape === "square") {
        for (let x = 0; x < 2; x++) {
          const p = position[own + x], inside = Math.min(size, Math.max(-size, p));
          if (p !== inside && velocity[own + x] * p > 0) velocity[own + x] = 0;
          position[own + x] = inside;
        }
      } else if (this.model.arena.shape === "disc") this.#hold(own, [0, 0, size], 1);
    }

    /** Hold an individual within a circle (side 1), or out of it (-1). */
    #hold(own, [middleX, middleY, radius], side) {
      const { position, velocity } = this, x = position[own] - middleX, y = position[own + 1] - middleY;
      const out = Math.sqrt(x * x + y * y);
      if (side * (out - radius) <= 0) return;
      const whole = Math.max(out, 1e-300), back = (radius / whole) * (1 - side * 1e-12);
      const nx = x / whole, ny = y / whole, outwards = velocity[own] * nx + velocity[own + 1] * ny;
      const into = side * Math.max(0, side * outwards);
      position[own] = middleX + back * x;
      position[own + 1] = middleY + back * y;
      velocity[own] -= into * nx;
      velocity[own + 1] -= into * ny;
    }

    #judge(b) {
      const K = this.K, last = K - 1, at = 2 * b * K, p = this.position;
      const lone = this.model.lone, arena = this.model.arena;
      let nearest = this.contact * this.contact, code = TIME_OUT;
      for (let i = 0; i < (this.model.free ? 0 : last); i++) {
        if (this.absent[i]) continue;
        const dx = p[at + 2 * last] - p[at + 2 * i], dy = p[at + 2 * last + 1] - p[at + 2 * i + 1];
        const squared = dx * dx + dy * dy;
        if (squared < nearest) code = i + 1;
        nearest = Math.min(nearest, squared);
      }
      if (arena.walled || code !== TIME_OUT || arena.shape === "open") return code;
      for (let j = 0; j < K; j++) {
        const i = lone ? j : last - j, x = p[at + 2 * i], y = p[at + 2 * i + 1];
        if (this.absent[i]) continue;
        const out = arena.shape === "square"
          ? Math.max(Math.abs(x), Math.abs(y)) > this.boundary
          : x * x + y * y > this.boundary * this.boundary;
        if (out || this.holes.some(([hx, hy, r]) => (x - hx) * (x - hx) + (y - hy) * (y - hy) < r * r)) return (i === last) !== lone && !this.model.free ? TARGET_OUT : PURSUER_OUT;
      }
      return TIME_OUT;
    }

    /** Compute focus directions and observations of copy b. */
    observe(b) {
      const K = this.K, last = K - 1, at = 2 * b * K, p = this.position, v = this.velocity;
      for (let i = 0; i < K; i++) {
        const own = at + 2 * i, others = [];
        for (let j = 0; j < K; j++) {
          if (j === i) continue;
          const other = at + 2 * j, dx = p[other] - p[own], dy = p[other + 1] - p[own + 1];
          const dvx = v[other] - v[own], dvy = v[other + 1] - v[own + 1];
          others.push({ j, dx, dy, dvx, dvy, apart: Math.sqrt(dx * dx + dy * dy) });
        }
        const { free, senses } = this.model, first = free ? -1 : last;
        others.sort((one, two) => (two.j === first) - (one.j === first) || one.apart - two.apart || one.j - two.j);
        let [ex, ey] = [1, 0];
        if (free) [ex, ey] = this.#course(b, i);
        else if (others[0].apart > 0) [ex, ey] = [others[0].dx / others[0].apart, others[0].dy / others[0].apart];
        this.towards[own] = ex;
        this.towards[own + 1] = ey;
        this.#write(b, i, ex, ey, others.slice(0, senses.first.length - 1 - this.landmarks.length));
      }
    }

    #write(b, i, ex, ey, others) {
      const { senses } = this.model, S = senses.columns, K = this.K, own = 2 * (b * K + i);
      const out = this.observation.subarray((b * K + i) * this.n, (b * K + i + 1) * this.n);
      const p = this.position, v = this.velocity, stride = senses.stride[i], factor = senses.own_velocity[i];
      const column = (rank, name) => senses.first[rank][S[name]];
      const pair = (place, first, second) => {
        if (place === ABSENT) return;
        out[place] = first;
        out[place + 1] = second;
      };
      const x = p[own], y = p[own + 1], vx = v[own], vy = v[own + 1];
      pair(column(0, "POSITION"), x, y);
      if (column(0, "POSITION") !== ABSENT) pair(column(0, "FOCUS"), ex, ey);
      pair(column(0, "VELOCITY"), ...egocentric(factor * vx, factor * vy, ex, ey));
      pair(column(0, "PLANE_VELOCITY"), factor * vx, factor * vy);
      const [ahead, left] = egocentric(this.push[own], this.push[own + 1], ex, ey);
      pair(column(0, "ACCELERATION"), held(ahead), held(left));
      const scaled = (fine, coarse, log, wx, wy) => {
        if (fine === ABSENT) return;
        const sx = wx / stride, sy = wy / stride;
        const a = squash((sx * ex + sy * ey) / 3), l = squash((sy * ex - sx * ey) / 3);
        pair(coarse, a, l);
        pair(fine, tripled(a), tripled(l));
        out[log] = Math.log(Math.fround(Math.sqrt(sx * sx + sy * sy) + REST));
      };
      scaled(column(0, "FINE"), column(0, "COARSE"), column(0, "LOG_SPEED"), vx, vy);
      const harmonics = (place, wx, wy, faint) => {
        if (place === ABSENT) return;
        const [a, l] = egocentric(wx, wy, ex, ey), length = Math.sqrt(a * a + l * l);
        const per = length > 0 ? 1 / length : 0, ux = a * per, uy = l * per;
        const clear = length / (length + faint), x2 = ux * ux - uy * uy, y2 = 2 * ux * uy;
        pair(place, clear * x2, clear * y2);
        pair(place + 2, clear * (x2 * ux - y2 * uy), clear * (x2 * uy + y2 * ux));
        pair(place + 4, clear * (x2 * x2 - y2 * y2), clear * 2 * x2 * y2);
      };
      harmonics(column(0, "COURSE"), vx, vy, FAINT * stride);
      harmonics(column(0, "PUSH"), this.push[own], this.push[own + 1], FAINT);
      const time = column(0, "TIME");
      if (time !== ABSENT) out[time] = Math.log(1 + Math.min(this.steps[b], senses.limit));
      senses.past.forEach((_, s) => {
        const mean = ((b * this.scales + s) * K + i) * 2, names = ["SHORT", "LONG"][s];
        scaled(
          column(0, `FINE_${names}`), column(0, `COARSE_${names}`), column(0, `LOG_${names}`),
          this.past[mean], this.past[mean + 1],
        );
      });
      senses.memory.forEach((_, s) => {
        const place = (row) => ((b * this.scales + row) * K + i) * 2, at = S.FINE_MEMORY + 5 * s;
        const [fine, coarse, log, turn, speed] = senses.first[0].slice(at, at + 5), more = place(s + senses.memory.length);
        if (fine === ABSENT) return;
        scaled(fine, coarse, log, this.past[place(s)], this.past[place(s) + 1]);
        out[turn] = this.past[more];
        out[speed] = Math.log(Math.fround(this.past[more + 1] / stride + REST));
      });
      const delayed = column(0, "DELAYED_SPEED");
      if (delayed !== ABSENT) senses.delays.forEach((_, k) => {
        const row = 2 * senses.memory.length + (k >> 1), at = ((b * this.scales + row) * K + i) * 2 + (k & 1);
        out[delayed + k] = Math.log(Math.fround(this.past[at] / stride + REST));
      });
      pair(column(0, "OWN_TRAITS"), this.traits[own], this.traits[own + 1]);
      const faced = this.model.free ? 0 : 1; // how many of the others lie straight ahead by definition
      others.forEach((other, rank) => {
        const c = (name) => senses.first[rank + 1][S[name]];
        const [oa, ol] = egocentric(other.dx, other.dy, ex, ey);
        out[c("DISTANCE")] = other.apart;
        pair(c("PLACE"), oa, rank < faced ? 0 : ol);
        if (c("BEARING") !== ABSENT) out[c("BEARING")] = rank < faced ? 0 : Math.atan2(ol, oa);
        pair(c("DRIFT"), ...egocentric(other.dvx, other.dvy, ex, ey));
        if (rank >= faced && c("BEARING_CIRCLE") !== ABSENT) {
          const ux = other.apart > 0 ? other.dx / other.apart : ex;
          const uy = other.apart > 0 ? other.dy / other.apart : ey;
          pair(c("DIRECTION"), ux, uy);
          pair(c("BEARING_CIRCLE"), ux * ex + uy * ey, uy * ex - ux * ey);
        }
        if (c("NEARNESS") !== ABSENT) out[c("NEARNESS")] = 1 / (other.apart + senses.near);
        if (c("OTHER_POSITION") !== ABSENT) {
          pair(c("OFFSET"), other.dx, other.dy);
          pair(c("OTHER_POSITION"), x + other.dx, y + other.dy);
          pair(c("OTHER_VELOCITY"), vx + other.dvx, vy + other.dvy);
        }
      });
      this.landmarks.forEach(([lx, ly], k) => {
        const rank = senses.first.length - 1 - k;
        const dx = lx - x, dy = ly - y, apart = Math.sqrt(dx * dx + dy * dy);
        const [ahead, left] = apart > 0 && apart < Infinity ? egocentric(dx / apart, dy / apart, ex, ey) : [0, 0];
        pair(column(rank, "LANDMARK_CIRCLE"), ahead, left);
        out[column(rank, "LANDMARK_DISTANCE")] = squash(apart / this.model.arena.size);
      });
      const square = this.model.arena.shape === "square", radius = Math.sqrt(x * x + y * y);
      const centre = column(0, "CENTRE_DISTANCE"), edge = column(0, "EDGE");
      if (centre !== ABSENT) out[centre] = radius;
      if (edge !== ABSENT) {
        out[edge] = this.edge - (square ? Math.max(Math.abs(x), Math.abs(y)) : radius);
        pair(column(0, "CENTRE"), ...egocentric(-x, -y, ex, ey));
      }
      if (column(0, "AT_WALL") !== ABSENT) {
        let far, nx, ny;
        if (square) {
          const sideways = Math.abs(x) >= Math.abs(y), sign = (z) => (z < 0 || Object.is(z, -0) ? -1 : 1);
          far = sideways ? Math.abs(x) : Math.abs(y);
          nx = sideways ? sign(x) : 0;
          ny = sideways ? 0 : sign(y);
        } else {
          far = radius;
          [nx, ny] = radius > 0 ? [x / radius, y / radius] : [ex, ey];
        }
        let near = this.edge - far;
        for (const [middleX, middleY, hole] of this.holes) {
          const dx = middleX - x, dy = middleY - y, away = Math.sqrt(dx * dx + dy * dy);
          if (away - hole < near && away > 0) [near, nx, ny] = [away - hole, dx / away, dy / away];
        }
        out[column(0, "AT_WALL")] = squash(near / senses.scales[0]);
        out[column(0, "BY_WALL")] = squash(near / senses.scales[1]);
        pair(column(0, "WALL_CIRCLE"), nx * ex + ny * ey, ny * ex - nx * ey);
        const sx = vx / stride, sy = vy / stride;
        const outwards = squash((sx * nx + sy * ny) / 3), along = squash((sy * nx - sx * ny) / 3);
        pair(column(0, "COARSE_WALL"), outwards, along);
        pair(column(0, "FINE_WALL"), tripled(outwards), tripled(along));
      }
    }
  }

  const HALF_TURN = Math.PI - 1e-6;
  function turnBetween(before, after) {
    let turned = after - before;
    if (turned > Math.PI) turned -= 2 * Math.PI;
    else if (turned < -Math.PI) turned += 2 * Math.PI;
    return Math.abs(turned) > HALF_TURN ? 0 : turned;
  }

  /** One searcher, a plume, two antennae, wind and visual flow. */
  class Search extends World {
    constructor(model, options, copies) {
      super(model, options, copies);
      this.heading = new Float64Array(2 * copies);
      this.angle = new Float64Array(copies);
      this.turn = new Float64Array(copies);
      this.odour = new Float64Array(2 * copies);
      this.trace = new Float64Array(2 * copies);
      this.hits = new Uint8Array(2 * copies);
      this.pattern = new Int32Array(copies);
      this.phase = new Int32Array(copies);
    }

    #face(b, cosine, sine, angle) {
      this.heading[2 * b] = cosine;
      this.heading[2 * b + 1] = sine;
      this.turn[b] = turnBetween(this.angle[b], angle);
      this.angle[b] = angle;
    }

    #point(b, direction) {
      const cosine = Math.cos(direction), sine = Math.sin(direction);
      this.#face(b, cosine, sine, Math.atan2(-sine, -cosine));
    }

    #walk(b) {
      const vx = this.velocity[2 * b], vy = this.velocity[2 * b + 1], speed = Math.sqrt(vx * vx + vy * vy);
      this.turn[b] = 0;
      if (speed > this.model.senses.rest_speed) {
        this.#face(b, vx / speed, vy / speed, Math.atan2(-vy, -vx));
      }
    }

    woken(b, start) {
      const starts = this.model.starts, senses = this.model.senses, paired = this.start[b] >= 0;
      const known = paired && starts.heading !== null;
      if (known) this.#point(b, starts.heading[start * starts.frames]);
      else this.#face(b, -1, 0, 0);
      if (!(senses.turns && known)) this.#walk(b);
      this.turn[b] = 0;
      this.pattern[b] = starts.pattern[start];
      this.phase[b] = starts.phase[start];
      for (let side = 0; side < 2; side++) {
        this.odour[2 * b + side] = senses.baseline;
        this.trace[2 * b + side] = 0;
      }
      const frame = start * starts.frames;
      this.#smell(b, paired && starts.hits !== null ? frame : -1);
    }

    #smell(b, recorded) {
      const { senses, starts } = this.model;
      for (let side = 0; side < 2; side++) {
        const hit = recorded >= 0 ? starts.hits[2 * recorded + side] : this.#antenna(b, side);
        const at = 2 * b + side, base = senses.baseline;
        this.hits[at] = hit;
        this.odour[at] = hit ? 1 : base + (this.odour[at] - base) * senses.remains;
        this.trace[at] = hit ? 1 : this.trace[at] * senses.trace_remains;
      }
    }

    #antenna(b, side) {
      const { senses, plume } = this.model, hx = this.heading[2 * b], hy = this.heading[2 * b + 1];
      const sign = side === 0 ? 1 : -1;
      const x = this.position[2 * b] + senses.ahead * hx - sign * senses.beside * hy;
      const y = this.position[2 * b + 1] + senses.ahead * hy + sign * senses.beside * hx;
      return hit(plume, this.pattern[b], this.phase[b] + this.steps[b], x, y);
    }

    step(b, actions) {
      const model = this.model, senses = model.senses, at = 2 * b;
      this.steps[b] += 1;
      const beforeX = this.velocity[at], beforeY = this.velocity[at + 1];
      const recorded = this.replayed(b);
      if (recorded >= 0) this.follow(b, recorded);
      else {
        const vector = model.pushes[0][actions[0]];
        for (let x = 0; x < 2; x++) {
          const pushed = this.thrust[0] * -vector[x] * this.dt;
          this.velocity[at + x] = (1 - this.damping[0]) * this.velocity[at + x] + pushed;
          this.position[at + x] += this.velocity[at + x] * this.dt;
        }
      }
      const px = this.position[at], py = this.position[at + 1];
      const reached = px * px + py * py < this.contact * this.contact;
      this.outcome[b] = reached ? 1 : TIME_OUT;
      this.over[b] = reached || this.steps[b] >= this.limit ? 1 : 0;
      const frame = recorded >= 0 ? recorded / 2 : -1, starts = model.starts;
      if (!senses.turns) this.#walk(b);
      else if (frame >= 0 && starts.heading !== null) this.#point(b, starts.heading[frame]);
      else this.#swing(b);
      this.#smell(b, frame >= 0 && starts.hits !== null ? frame : -1);
      const [damping, push] = // a recorded animal had the body of the recordings
        recorded >= 0 ? [senses.damping, senses.stride] : [this.damping[0], this.thrust[0] * this.dt];
      const residual = (after, before) => (after - ((1 - damping) * before + 0)) / push;
      this.push[at] = residual(this.velocity[at], beforeX);
      this.push[at + 1] = residual(this.velocity[at + 1], beforeY);
      this.observe(b);
    }

    #swing(b) {
      const s = this.model.senses, vx = this.velocity[2 * b], vy = this.velocity[2 * b + 1];
      const speed = Math.sqrt(vx * vx + vy * vy);
      let turn = s.persistence * this.turn[b];
      if (speed > 0) {
        const x = vx * s.slip_cosine - vy * s.slip_sine, y = vx * s.slip_sine + vy * s.slip_cosine;
        const off = (this.heading[2 * b] * y - this.heading[2 * b + 1] * x) / speed;
        turn += s.gain * Math.tanh(speed / s.turning_speed) * off;
      }
      const raw = this.angle[b] + turn, angle = raw - 2 * Math.PI * Math.floor(0.5 + raw / (2 * Math.PI));
      this.heading[2 * b] = -Math.cos(angle);
      this.heading[2 * b + 1] = -Math.sin(angle);
      this.angle[b] = angle;
      this.turn[b] = turn;
    }

    observe(b) {
      const { senses } = this.model, S = senses.columns, at = 2 * b;
      const out = this.observation.subarray(b * this.n, (b + 1) * this.n);
      const vx = this.velocity[at], vy = this.velocity[at + 1], [hx, hy] = [this.heading[at], this.heading[at + 1]];
      out.fill(0, S.FLOW, S.WIND_BACK + 1);
      out[S.VELOCITY_AHEAD] = -vx * senses.own_velocity;
      out[S.VELOCITY_LEFT] = -vy * senses.own_velocity;
      out[S.BODY_ANGLE] = this.angle[b];
      out[S.ODOUR_LEFT] = this.odour[at];
      out[S.ODOUR_RIGHT] = this.odour[at + 1];
      if (this.condition[b] === 0) {
        let flow = -this.turn[b] / this.dt;
        if (Math.abs(flow) < senses.flow_threshold) flow = 0;
        out[S.FLOW] = Math.min(senses.flow_limit, Math.max(-senses.flow_limit, flow));
        const ahead = -hx, left = -hy;
        if (ahead >= Math.abs(left)) out[S.WIND_FRONT] = 1;
        else if (-ahead >= Math.abs(left)) out[S.WIND_BACK] = 1;
        else if (left > 0) out[S.WIND_RIGHT] = 1;
        else out[S.WIND_LEFT] = 1;
      }
      if (this.n <= S.WIND_BACK + 1) return;
      out[S.HIT_LEFT] = this.hits[at];
      out[S.HIT_RIGHT] = this.hits[at + 1];
      out[S.ODOUR_DIFFERENCE] = this.odour[at] - this.odour[at + 1];
      out[S.ODOUR_SUM] = this.odour[at] + this.odour[at + 1];
      out[S.TRACE_LEFT] = this.trace[at];
      out[S.TRACE_RIGHT] = this.trace[at + 1];
      out[S.ANGLE_COSINE] = -hx;
      out[S.ANGLE_SINE] = -hy;
      const ahead = -vx / senses.stride, left = -vy / senses.stride;
      out[S.FINE_AHEAD] = Math.tanh(ahead);
      out[S.FINE_LEFT] = Math.tanh(left);
      out[S.COARSE_AHEAD] = Math.tanh(ahead / 3);
      out[S.COARSE_LEFT] = Math.tanh(left / 3);
      out[S.LOG_SPEED] = Math.log(Math.sqrt(ahead * ahead + left * left) + REST);
      out[S.ACCELERATION_AHEAD] = held(-this.push[at]);
      out[S.ACCELERATION_LEFT] = held(-this.push[at + 1]);
      out[S.YAW_RATE] = this.turn[b] / this.dt;
    }
  }

  /** Whether the plume hits an antenna at (x, y) [arena unit] in a step of a pattern. */
  function hit(plume, pattern, step, x, y) {
    const cells = (z) => (z < 0 ? -1 : 1) * Math.floor(Math.abs(z) / plume.cell + 0.5);
    const column = plume.source_column + cells(x), row = plume.source_row + cells(y);
    if (column < 0 || column >= plume.columns || row < 0 || row >= plume.rows) return 0;
    const [, steps, bytes] = plume.bits.shape, index = row * plume.columns + column;
    const byte = plume.bits[(pattern * steps + (step % steps)) * bytes + (index >> 3)];
    return (byte >> (index & 7)) & 1;
  }

  function makeWorld(model, options, copies) {
    return new (model.world === "search" ? Search : Chase)(model, options, copies);
  }

  /** Return the options of the unchanged world. */
  function unchanged(model) {
    return {
      damping: Array.from(model.locomotion, (own) => own.damping),
      thrust: Array.from(model.locomotion, (own) => own.thrust),
      arena: model.arena.size, boundary: model.arena.boundary, contact: model.contact_radius,
      time_limit: model.time_limit, warmth: 1, condition: null, absent: [],
      landmarks: model.arena.landmarks.map(([, x, y]) => [x, y]), obstacles: model.arena.obstacles,
    };
  }

  /** Return the condition of the world and the flag that a policy is told, for one start. */
  function conditions(model, options, start) {
    const recorded = model.starts.condition[start];
    const chosen = options.condition === null ? recorded : options.condition;
    return model.condition_is_sensed ? [chosen, chosen] : [recorded, chosen];
  }

  // -- rollouts ------------------------------------------------------------------------------------

  /**
   * Simulate from recorded starts; tasks are [start, repetition]. Same seed, same random numbers.
   * Returns for each task what is measured of it, with measured also the verdict's measures (Measures);
   * onProgress gets the share done, and may wait.
   */
  async function rollOut(model, options, tasks, seed, onProgress = null, measured = false) {
    const K = model.individuals.length, B = tasks.length;
    const world = makeWorld(model, options, B), policy = new Policy(model, B);
    const flags = new Int8Array(B), random = tasks.map(([start, again]) => stream(seed, start, again));
    const path = new Float64Array(B * K), near = new Float64Array(B), frames = new Int32Array(B).fill(1);
    const beyond = new Float64Array(K), seen = new Float64Array(K), inputs = new Float64Array(2 * K * world.n);
    const actions = new Int32Array(K), tracks = tasks.map(() => []);
    tasks.forEach(([start], b) => {
      const [condition, told] = conditions(model, options, start);
      flags[b] = told;
      world.begin(b, start, null, condition, stream(~seed, ...tasks[b]));
      near[b] = distance(world, b);
    });
    let running = Array.from(tasks.keys()), waited = Date.now();
    while (running.length) {
      policy.decide(world.observation, flags, running);
      for (const b of running) {
        for (let i = 0; i < K; i++) {
          const slot = b * K + i;
          actions[i] = policy.choose(slot, i, random[b](), options.warmth);
          policy.previous[slot] = actions[i];
          if (world.absent[i]) continue;
          seen[i] += 1;
          beyond[i] += countBeyond(model, i, world.observation, slot * world.n, inputs);
        }
        const warming = world.warming(b), old = world.position.slice(2 * b * K, 2 * (b + 1) * K);
        if (measured) tracks[b].push(old);
        if (warming) actionsOf(model, world, b, old, policy, actions);
        world.step(b, actions);
        for (let i = 0; i < K; i++) {
          if (world.absent[i]) continue;
          const at = 2 * (b * K + i);
          path[b * K + i] += Math.hypot(
            world.position[at] - old[2 * i], world.position[at + 1] - old[2 * i + 1]);
        }
        near[b] += distance(world, b);
        frames[b] += 1;
      }
      running = running.filter((b) => !world.over[b]);
      if (onProgress && Date.now() - waited > 50) {
        await onProgress(Math.max(1 - running.length / B, running.length ? world.steps[running[0]] / world.limit : 1));
        waited = Date.now();
      }
    }
    const scale = model.unit.per_arena_unit, there = K - options.absent.length;
    const results = tasks.map(([start], b) => {
      const seconds = (frames[b] - 1) * model.dt, own = path.slice(b * K, (b + 1) * K);
      return {
        start, reached: world.outcome[b] > 0 ? 1 : 0, outcome: world.outcome[b], duration: seconds,
        path: (scale * own.reduce((sum, value) => sum + value, 0)) / there,
        distance: (scale * near[b]) / frames[b],
        speed: Array.from(own, (value) => (scale * value) / Math.max(seconds, model.dt)),
        measures: measured ? Measures.measure(model, options, [...tracks[b], world.position.slice(2 * b * K, 2 * (b + 1) * K)], start, world.outcome[b]) : null,
      };
    });
    return {
      results,
      beyond: Array.from(beyond, (value, i) => value / Math.max(seen[i], 1)),
      inputs: Array.from(inputs, (value, k) => value / Math.max(seen[Math.floor(k / (2 * world.n))], 1)),
    };
  }

  const CLOSE_ENOUGH = 0.02, MOST_TRIES = 24, USUAL_SLOPE = 0.7, LONGEST_STEP = 1.4, NARROWEST = 1e-3, SLOWEST = 1e-12, LIMITS = [1 / 8, 8];
  const clipped = (value, [low, high]) => Math.min(high, Math.max(low, value));

  /** The search of animarl_algos.whatif.thrust_search: bracket a wanted speed, then narrow the bracket. */
  class ThrustSearch {
    constructor(wanted, usual) {
      Object.assign(this, { wanted: Math.log(wanted), low: null, high: null, step: 0, onLine: false });
      this.factor = clipped(wanted / usual, LIMITS);
    }
    /** Record the speed that the present factor gave. */
    record(speed) {
      const here = [Math.log(this.factor), Math.log(Math.max(speed, SLOWEST))];
      const [side, other, sign] = here[1] < this.wanted ? ["low", "high", 1] : ["high", "low", -1];
      this.miss = this.wanted - here[1];
      if (this[other] !== null && sign * (this[other][0] - here[0]) <= 0) this[other] = null;
      this[side] = here;
    }
    /** Choose the next factor; return false where none is left that could help. */
    advance() {
      if (this.low !== null && this.high !== null) {
        const [[left, slow], [right, fast]] = [this.low, this.high];
        if (right - left < NARROWEST) return false;
        const share = (this.onLine = !this.onLine) ? (this.wanted - slow) / (fast - slow) : 0.5;
        return (this.factor = Math.exp(left + clipped(share, [0.1, 0.9]) * (right - left))) > 0;
      }
      const before = this.factor;
      this.step = Math.min(Math.max(Math.abs(this.miss) / USUAL_SLOPE, 2 * this.step), LONGEST_STEP);
      this.factor = clipped(before * Math.exp(Math.sign(this.miss) * this.step), LIMITS);
      return this.factor !== before;
    }
  }

  /**
   * Find factors on thrusts at which individuals reach wanted mean speeds, as animarl_algos.whatif.answer does.
   * wanted: [[individual, speed, usual], ...]. Returns factors, last speeds, and whether all are within 2 %.
   */
  async function findThrusts(model, options, wanted, tasks, seed, onProgress = null) {
    const searches = wanted.map(([, speed, usual]) => new ThrustSearch(speed, usual));
    for (let again = 1; ; again++) {
      const thrust = options.thrust.slice(), factors = searches.map((search) => search.factor);
      wanted.forEach(([i], k) => (thrust[i] *= factors[k]));
      const { results } = await rollOut(model, { ...options, thrust }, tasks, seed);
      const achieved = wanted.map(([i]) => results.reduce((sum, one) => sum + one.speed[i], 0) / tasks.length);
      searches.forEach((search, k) => search.record(achieved[k]));
      if (onProgress) await onProgress(again / MOST_TRIES);
      const missed = searches.filter((search) => Math.abs(search.miss) > CLOSE_ENOUGH), reached = missed.length === 0;
      if (reached || again === MOST_TRIES || missed.some((search) => !search.advance())) return { factors, achieved, reached };
    }
  }

  /** In a warm-up step the executed actions are the demonstrated ones: what policies remember. */
  function actionsOf(model, world, b, old, policy, actions) {
    const { starts } = model, K = world.K;
    if (starts.actions === null) return;
    for (let i = 0; i < K; i++) {
      const done = starts.actions[(world.start[b] * starts.frames + world.steps[b]) * K + i];
      actions[i] = done;
      policy.previous[b * K + i] = done;
    }
  }

  /** Add to the counts of inputs below their training range, and above it; return 1 if there is any. */
  function countBeyond(model, i, observation, at, inputs) {
    const { low, high } = model.ranges, n = low.shape[1];
    let any = 0;
    for (let c = 0; c < n; c++) {
      const value = observation[at + c], above = value > high[i * n + c];
      if (above || value < low[i * n + c]) {
        inputs[2 * i * n + above * n + c] += 1;
        any = 1;
      }
    }
    return any;
  }

  /** Distance of the nearest pursuer to the target, of a searcher to the source, or of free neighbours. */
  function distance(world, b) {
    const K = world.K, at = 2 * b * K, p = world.position;
    if (world.model.world === "search") return Math.hypot(p[at], p[at + 1]);
    if (world.model.free) {
      let sum = 0;
      for (let i = 0; i < K; i++) {
        let least = K > 1 ? Infinity : 0;
        for (let j = 0; j < K; j++) {
          if (j !== i) least = Math.min(least, Math.hypot(p[at + 2 * i] - p[at + 2 * j], p[at + 2 * i + 1] - p[at + 2 * j + 1]));
        }
        sum += least / K;
      }
      return sum;
    }
    let nearest = Infinity;
    for (let i = 0; i < K - 1; i++) {
      if (world.absent[i]) continue;
      const dx = p[at + 2 * i] - p[at + 2 * K - 2], dy = p[at + 2 * i + 1] - p[at + 2 * K - 1];
      nearest = Math.min(nearest, Math.hypot(dx, dy));
    }
    return nearest;
  }

  // -- statistics ----------------------------------------------------------------------------------

  const T975 = [12.71, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179,
    2.16, 2.145, 2.131, 2.12, 2.11, 2.101, 2.093, 2.086, 2.08, 2.074, 2.069, 2.064, 2.06, 2.056,
    2.052, 2.048, 2.045, 2.042];
  const student = (freedom) => T975[freedom - 1] || 1.96 + 2.4 / freedom;

  /**
   * Mean of paired differences with Student's 95 % interval over recordings: units[start] is the
   * recording of a start, or the start itself where there is one recording.
   */
  function pairedShift(before, after, value, units) {
    const sums = new Map();
    before.forEach((one, k) => {
      const unit = units[one.start], difference = value(after[k]) - value(one);
      const [sum, count] = sums.get(unit) || [0, 0];
      if (!Number.isNaN(difference)) sums.set(unit, [sum + difference, count + 1]);
    });
    const all = [...sums.values()], n = all.length, counts = all.reduce((sum, [, count]) => sum + count, 0);
    const mean = all.reduce((sum, [part]) => sum + part, 0) / counts;
    if (n < 2) return { mean, low: NaN, high: NaN };
    const square = all.reduce((sum, [part, count]) => sum + (part - count * mean) ** 2, 0) / (n - 1);
    const half = student(n - 1) * Math.sqrt(square * n) / counts;
    return { mean, low: mean - half, high: mean + half };
  }

  /** Mean, and the half-width of its 95 % interval by the chance of rollouts from the same starts alone. */
  function meanWithChance(results, value) {
    const groups = new Map();
    for (const one of results) {
      const number = value(one);
      if (!Number.isNaN(number)) groups.set(one.start, [...(groups.get(one.start) || []), number]);
    }
    const all = [...groups.values()], count = all.flat().length, average = (values) => values.reduce((sum, one) => sum + one, 0) / values.length;
    const several = all.filter((values) => values.length > 1), of = several.flat().length;
    const within = several.reduce((sum, values) => {
      const middle = average(values);
      return sum + (values.length / of) * values.reduce((square, one) => square + (one - middle) ** 2, 0) / (values.length - 1);
    }, 0);
    return { mean: average(all.flat()), error: several.length ? student(of - several.length) * Math.sqrt(within / count) : NaN };
  }

  /** Return the action that pushes individual i most nearly along (x, y) of the arena frame. */
  function actionTowards(world, b, i, x, y) {
    const pushes = world.model.pushes[i], own = 2 * (b * world.K + i);
    const search = world.model.world === "search";
    const ex = search ? -1 : world.towards[own], ey = search ? 0 : world.towards[own + 1];
    let best = pushes.length - 1, most = 0;
    pushes.forEach(([ahead, left], a) => {
      const along = (ahead * ex - left * ey) * x + (ahead * ey + left * ex) * y;
      if (along > most + 1e-9) [best, most] = [a, along];
    });
    return best;
  }

  return { unpack, stream, Policy, makeWorld, unchanged, conditions, rollOut, ThrustSearch, findThrusts, pairedShift, meanWithChance, actionTowards };
})();
if (typeof module !== "undefined") module.exports = AnimaRL;
