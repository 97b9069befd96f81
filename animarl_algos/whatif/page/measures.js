// The verdict's measures of one episode, as animarl_algos.evaluation.order_in_time and metrics compute
// them; a test compares both. A track is a list of frames, each [x0, y0, x1, y1, ...] [arena unit].
"use strict";
const Measures = (() => {
  const ROUNDING = 1e-24, LOW = 0.05, LEAD = 2, DELAYS = 10, NEAR_WALL = 0.1, CELLS = 8;
  const SPREADS = ["speed", "share at rest", "turning", "nearest neighbour", "distance from the wall", "distance from the start"];

  /** Mean of what is defined; NaN where nothing is. */
  function mean(values) {
    let sum = 0, count = 0;
    for (const value of values) if (!Number.isNaN(value)) { sum += value; count += 1; }
    return count ? sum / count : NaN;
  }
  function moment(values, power) {
    const middle = mean(values);
    return mean(values.map((value) => (value - middle) ** power));
  }
  const spread = (values) => Math.sqrt(moment(values, 2));

  function correlation(first, second, lag) {
    const a = [], b = [];
    for (let t = 0; t < first.length && t + lag < second.length; t++) {
      if (!Number.isNaN(first[t] + second[t + lag])) { a.push(first[t]); b.push(second[t + lag]); }
    }
    const [p, q] = [mean(a), mean(b)], one = moment(a, 2), other = moment(b, 2);
    return Math.min(one, other) > ROUNDING ? mean(a.map((value, k) => (value - p) * (b[k] - q))) / Math.sqrt(one * other) : NaN;
  }

  /** Lengths of uninterrupted stretches [steps]. */
  function stretches(flags) {
    const lengths = [];
    flags.forEach((flag, t) => {
      if (flag && t && flags[t - 1]) lengths[lengths.length - 1] += 1;
      else if (flag) lengths.push(1);
    });
    return lengths;
  }
  const bout = (flags) => mean(stretches(flags)) || 0;

  /** On the grid of the recordings, and smoothed by the moving average of the verdict. */
  function prepare(track, { grid, smoothing }) {
    const last = track.length - 1, round = (value, k) => grid === null ? value : grid.single ? Math.fround(value)
      : grid.origin[k % 2] + Math.round((value - grid.origin[k % 2]) / grid.step[k % 2]) * grid.step[k % 2];
    const stored = track.map((frame) => Array.from(frame, round));
    return smoothing === 1 ? stored : stored.map((frame, t) => {
      const reach = Math.min(smoothing >> 1, t, last - t);
      return frame.map((value, k) => {
        for (let d = 1; d <= reach; d++) value += stored[t - d][k] + stored[t + d][k];
        return Number((value / (2 * reach + 1)).toFixed(9));
      });
    });
  }

  /** What each individual did: speed, turn, moving and course of every step, and what it faces. */
  function follow(track, there, model) {
    const { rest, otherwise } = model.measuring, { dt, free } = model, target = there.length - 1;
    return there.map((i, k) => {
      const place = track.map((p) => [p[2 * i], p[2 * i + 1]]), step = [], apart = [], nearest = [];
      for (let t = 1; t < place.length; t++) step.push([place[t][0] - place[t - 1][0], place[t][1] - place[t - 1][1]]);
      const length = step.map(([x, y]) => Math.hypot(x, y)), moving = length.map((one) => one > rest[i]);
      const angle = step.slice(1).map(([x, y], t) => Math.atan2(step[t][0] * y - step[t][1] * x, 0 + step[t][0] * x + step[t][1] * y));
      const turn = angle.map((one, t) => (moving[t] && moving[t + 1] ? one : NaN));
      track.forEach((p, t) => {
        let least = Infinity, focus = Infinity, towards = otherwise;
        there.forEach((j, other) => {
          if (other === k) return;
          const x = p[2 * j] - place[t][0], y = p[2 * j + 1] - place[t][1], far = Math.hypot(x, y);
          least = Math.min(least, far);
          if ((free || k === target || other === target) && far < focus) {
            focus = far;
            towards = far > 0 ? [x / far, y / far] : otherwise;
          }
        });
        nearest.push(least);
        apart.push(towards);
      });
      const course = step.map(([x, y], t) => (moving[t] ? [x / length[t], y / length[t]] : [NaN, NaN]));
      return { i, place, length, moving, turn, angle, course, nearest, apart, speed: length.map((one) => one / dt) };
    });
  }

  /** Motion, reactions and places of one individual, by name. */
  function ofOne(one, all, model, options) {
    const { lags } = model.measuring, { dt, free } = model, { speed, turn, moving, course, place } = one, first = lags[0];
    const sine = turn.map(Math.sin), square = mean(sine.map((value) => value * value)), size = turn.map(Math.abs), m = {};
    const still = moving.map((flag) => !flag), middle = mean(speed), half = speed.length / 2;
    m.speed = middle;
    m["spread of speed"] = spread(speed);
    m["share at rest"] = mean(still.map(Number));
    m.turning = mean(size) / dt;
    m["turning to the left"] = mean(turn) / dt;
    const acceleration = speed.slice(1).map((value, t) => (value - speed[t]) / dt);
    m["skewness of acceleration"] = moment(acceleration, 3) / moment(acceleration, 2) ** 1.5;
    m["length of bouts of motion"] = bout(moving) * dt;
    const [early, late] = [0, 1].map((side) => mean(speed.filter((_, t) => +(t >= half) === side)));
    m["speed gained late"] = middle > 0 ? (late - early) / middle : NaN;
    m["longest rest"] = Math.max(0, ...stretches(still)) * dt;
    m.windings = Math.abs(mean(turn)) / (2 * Math.PI * dt);
    for (const lag of lags) {
      const seconds = `${Number((lag * dt).toPrecision(3))} s`;
      m[`displacement in ${seconds}`] = mean(place.slice(lag).map(([x, y], t) => Math.hypot(x - place[t][0], y - place[t][1])));
      m[`speed autocorrelation at ${seconds}`] = correlation(speed, speed, lag);
      m[`turn autocorrelation at ${seconds}`] = square > 0 ? mean(sine.slice(lag).map((value, t) => value * sine[t])) / square : NaN;
    }
    m["speed before turn"] = correlation(speed, size, first) - correlation(size, speed, first);
    if (!free || all.length > 1) {
      m["course towards the focus"] = mean(course.map(([x, y], t) => x * one.apart[t][0] + y * one.apart[t][1]));
      m["course to the left of the focus"] = mean(course.map(([x, y], t) => one.apart[t][0] * y - one.apart[t][1] * x));
    }
    if (all.length > 1) {
      m["nearest neighbour"] = mean(one.nearest);
      m["spread of the nearest neighbour"] = spread(one.nearest);
      const others = speed.map((_, t) => all.reduce((sum, other) => sum + (other === one ? 0 : other.speed[t]), 0) / (all.length - 1));
      m["speed with the others"] = correlation(speed, others, 0);
      m["speed ahead of the others"] = correlation(speed, others, first) - correlation(others, speed, first);
    }
    if (free && all.length !== 2) m["length of rests"] = bout(still) * dt;
    const [cosine, sinus] = [Math.cos, Math.sin].map((part) => mean(course.map(([x, y]) => part(2 * Math.atan2(y, x)))));
    m["anisotropy of the course"] = Math.hypot(cosine, sinus);
    m["course along the x axis"] = cosine;
    const shape = model.arena.shape, radius = place.map(([x, y]) => Math.hypot(x, y));
    if (shape === "open" && model.world === "search") m["distance from the source"] = mean(radius);
    else if (shape === "open") m["distance from the start"] = mean(place.map(([x, y]) => Math.hypot(x - place[0][0], y - place[0][1])));
    else {
      const far = shape === "disc" ? radius : place.map(([x, y]) => Math.max(Math.abs(x), Math.abs(y)));
      const clear = clearance(options.obstacles, options.arena / model.arena.size);
      const wall = far.map((out, t) => Math.min(options.arena - out, clear(place[t])));
      m["distance from the wall"] = mean(wall);
      m["share at the wall"] = mean(wall.map((value) => +(value < NEAR_WALL * options.arena)));
    }
    return m;
  }

  /** Return the distance of a place to the nearest obstacle; a factor on places and radii, and how deep one may be in it. */
  function clearance(obstacles, factor, deep = 0, size = 1) {
    const reduced = (radius) => radius - Math.min(radius * deep, size * deep / (1 - deep));
    return ([x, y]) => Math.min(...obstacles.map((at) => Math.hypot(x - factor * at[0], y - factor * at[1]) - factor * reduced(at[2])));
  }

  /** How much individuals point the same way at each step. */
  function polarisation(all) {
    return mean(all[0].course.map((_, t) => Math.hypot(mean(all.map((one) => one.course[t][0])), mean(all.map((one) => one.course[t][1])))));
  }

  /** Measures of a group as a whole. */
  function ofGroup(all, model) {
    const near = all.flatMap((one) => one.nearest).sort((a, b) => a - b), at = LOW * (near.length - 1), low = Math.floor(at);
    const extent = [], around = [], frames = all[0].place.length, K = all.length, dt = model.dt;
    for (let t = 0; t < frames; t++) {
      const [cx, cy] = [0, 1].map((k) => mean(all.map((one) => one.place[t][k])));
      const arms = all.map((one) => [one.place[t][0] - cx, one.place[t][1] - cy]), far = arms.map(([x, y]) => Math.hypot(x, y));
      extent.push(Math.sqrt(mean(far.map((value) => value * value))));
      if (t < frames - 1) around.push(Math.abs(mean(all.map((one, k) => (arms[k][0] * one.course[t][1] - arms[k][1] * one.course[t][0]) / far[k]))));
    }
    const farthest = Math.min(model.measuring.lags.at(-1), Math.max(1, Math.round(LEAD / dt))), count = Math.min(farthest, DELAYS);
    const even = (value) => { const down = Math.floor(value); return value - down === 0.5 ? down + (down % 2 ? 1 : 0) : Math.round(value); };
    const delays = [...new Set(Array.from({ length: 2 * count + 1 }, (_, k) => even(-farthest + (k * farthest) / count)))].filter((d) => Math.abs(d) < frames - 1);
    const filled = all.map((one) => one.course.map(([x, y]) => (Number.isNaN(x) ? [0, 0] : [x, y])));
    const sums = filled[0].map((_, t) => [0, 1].map((k) => filled.reduce((sum, one) => sum + one[t][k], 0)));
    const leads = all.map((one, i) => {
      const agree = delays.map((delay) => mean(one.course.map(([x, y], t) => {
        const then = sums[t + delay];
        return then ? (x * (then[0] - filled[i][t + delay][0]) + y * (then[1] - filled[i][t + delay][1])) / (K - 1) : NaN;
      }))).map((value) => (Number.isNaN(value) ? -Infinity : value));
      const best = Math.max(...agree);
      return best === -Infinity ? NaN : Math.abs(delays[agree.indexOf(best)]);
    });
    return {
      "5 % nearest neighbour": near[low] + (at - low) * ((near[low + 1] ?? near[low]) - near[low]),
      "extent of the group": mean(extent), milling: mean(around), "leadership lag": mean(leads) * dt,
    };
  }

  /** Share of the time that would have to be spent elsewhere to go where the recordings go. */
  function occupancy(all, start, { low, size, maps }) {
    const [, rows, cells] = maps.shape;
    return mean(all.map((one, k) => {
      const at = (start * rows + (rows === 1 ? 0 : one.i)) * cells, share = new Float64Array(cells);
      const cell = (value, axis) => Math.min(CELLS - 1, Math.max(0, Math.trunc((CELLS * (value - low[axis])) / size[axis])));
      one.place.forEach(([x, y]) => (share[cell(x, 0) * CELLS + cell(y, 1)] += 1 / one.place.length));
      return 0.5 * share.reduce((sum, value, c) => sum + Math.abs(value - maps[at + c]), 0);
    }));
  }

  /** Return every measure of one episode, by the name that the package gives it. */
  function measure(model, options, track, start, outcome) {
    const names = model.individuals, there = names.map((_, i) => i).filter((i) => !options.absent.includes(i));
    const { measuring, dt, free, arena } = model, group = free && names.length > 2;
    const positions = prepare(track, measuring), all = follow(positions, there, model), found = {};
    const each = all.map((one) => ofOne(one, all, model, options));
    for (const name of Object.keys(each[0])) {
      const values = each.map((one) => one[name]);
      if (group) {
        found[name] = mean(values);
        if (SPREADS.includes(name)) found[`spread of ${name} between animals`] = spread(values);
      } else values.forEach((value, k) => (found[all.length > 1 ? `${name}, ${names[there[k]]}` : name] = value));
    }
    if (all.length > 1) found.polarisation = polarisation(all);
    if (group) Object.assign(found, ofGroup(all, model));
    const seconds = (track.length - 1) * dt, steps = all.map((one) => one.speed);
    const middle = (values) => { const s = values.slice().sort((a, b) => a - b), n = s.length; return (s[(n - 1) >> 1] + s[n >> 1]) / 2; };
    found.duration = seconds;
    const movers = model.roles.filter((_, i) => there.includes(i)).map((role) => role !== "target");
    found["path length"] = mean(all.filter((_, k) => movers[k]).map((one) => one.length.reduce((sum, value) => sum + value, 0)));
    found["mean speed"] = mean(steps.flat());
    found["median speed"] = mean(steps.map(middle));
    found["slow steps"] = mean(all.flatMap((one) => one.speed.map((value) => +(value < measuring.slow[one.i]))));
    found.turning = mean(all.map((one) => one.angle.reduce((sum, value) => sum + Math.abs(value), 0))) / seconds;
    found["occupancy distance"] = occupancy(all, start, measuring);
    const margin = measuring.grid ? measuring.grid.reach : 0, closed = arena.shape !== "open";
    const clear = clearance(options.obstacles, options.arena / arena.size, arena.walled ? 0 : 1 - arena.size / arena.boundary, arena.size);
    const edge = (arena.rebound ? options.arena : options.boundary) + margin;
    const outside = ([x, y]) => {
      const far = arena.shape === "disc" ? Math.hypot(x, y) : Math.max(Math.abs(x), Math.abs(y));
      return (closed && far > edge) || clear([x, y]) < -margin;
    };
    const left = outcome === -1 || outcome === -2;
    found["somebody outside the arena"] = +(left || all.some((one) => one.place.some(outside)));
    found["ended by the target leaving"] = +(outcome === -1);
    found["ended by a pursuer leaving"] = +(outcome === -2);
    found["target reached"] = +(outcome > 0);
    return found;
  }

  return { measure };
})();
if (typeof module !== "undefined") module.exports = Measures;
