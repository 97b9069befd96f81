// What the page shows and how it answers: controls, one episode on the stage, and many in a worker.
"use strict";
(async () => {
  const $ = (id) => document.getElementById(id);
  const model = await AnimaRL.unpack(JSON.parse($("model").textContent));
  const names = model.individuals, K = names.length, scale = model.unit.per_arena_unit;
  const usual = AnimaRL.unchanged(model), ROLLOUTS = 200, YELLOW = 0.05, RED = 0.25;
  const COLOURS = ["#0b63b8", "#1f8a5b", "#7a4fb5", "#0f7f8c", "#5b6b1f", "#8a3d6e"];
  const TARGET = "#c0392b";
  const colour = (i) => (model.roles[i] === "target" ? TARGET : COLOURS[i % COLOURS.length]);

  // -- the change ----------------------------------------------------------------------------------

  const factors = {}; // by control: a factor on what is there
  function slider(key, label, least = 1 / 4, most = 4, parent = $("controls")) {
    const box = document.createElement("div"), id = `control-${key}`;
    box.className = "control";
    const text = document.createElement("label"), out = document.createElement("output");
    const input = document.createElement("input");
    Object.assign(text, { htmlFor: id, textContent: label });
    Object.assign(input, { id, type: "range", min: Math.log2(least), max: Math.log2(most), step: 0.05, value: 0 });
    out.htmlFor = id;
    const say = () => {
      const factor = 2 ** input.valueAsNumber;
      factors[key] = factor;
      out.textContent = Math.abs(factor - 1) < 1e-9 ? "as it is" : `× ${factor.toFixed(2)}`;
      input.setAttribute("aria-valuetext", out.textContent);
    };
    input.addEventListener("input", () => { say(); changed(); });
    box.append(text, out, input);
    parent.append(box);
    say();
    return { text, reset: () => { input.value = 0; say(); } };
  }

  function choice(id, label, options, value) {
    const box = document.createElement("label"), select = document.createElement("select");
    box.className = "row";
    select.id = id;
    options.forEach(([key, text]) => select.add(new Option(text, key)));
    select.value = value;
    box.append(`${label} `, select);
    $("controls").append(box);
    select.addEventListener("change", () => changed());
    return select;
  }

  const body = choice("body", "Sliders of animals change", [["thrust", "thrust"], ["speed", "achieved speed"]], "thrust");
  // A group without a target has a slider for all, and those of single animals folded away below it.
  const alike = model.free && K > 1, own = alike ? ["all animals", ...names] : names;
  const factorOf = (i) => (alike ? factors.all * factors[`body-${i}`] : factors[`body-${i}`]);
  const sliders = alike ? [slider("all", "Thrust of all animals")] : [];
  const fold = document.createElement("details"), summary = document.createElement("summary");
  summary.textContent = "One animal alone";
  fold.append(summary);
  if (alike) $("controls").append(fold);
  names.forEach((name, i) => sliders.push(slider(`body-${i}`, `Thrust of ${name}`, 1 / 4, 4, alike ? fold : $("controls"))));
  body.addEventListener("change", () =>
    own.forEach((name, i) => (sliders[i].text.textContent = `${body.value === "speed" ? "Speed" : "Thrust"} of ${name}`)));
  let found = null; // factors on thrusts that wanted speeds take, once they are known
  if (model.arena.shape !== "open") sliders.push(slider("arena", "Size of the arena", 1 / 2, 4));
  if (!model.free) sliders.push(slider("contact", "Contact radius"));
  if (model.acting.kind === "boltzmann") sliders.push(slider("warmth", "Temperature of the choice of actions"));
  const condition = model.conditions.length && (model.told || model.condition_is_sensed)
    ? choice("condition", "Condition", [["", "as recorded"], ...model.conditions.map((name, k) => [k, name])], "")
    : null;
  const absent = new Set(); // pursuers that are taken away
  const pursuers = names.map((_, i) => i).filter((i) => model.roles[i] === "pursuer");
  const boxes = model.absent ? [presence("Pursuers", "there", pursuers, (i) => names[i], absent, 1)] : [];
  // Landmarks and obstacles can be hidden and dragged [arena unit of the unchanged arena].
  const noLandmark = new Set(), noObstacle = new Set();
  const copied = (places) => places.map((at) => [...at]);
  let landmarks = copied(usual.landmarks), obstacles = copied(usual.obstacles);
  if (landmarks.length) boxes.push(presence("Landmarks", "landmark", [...landmarks.keys()], (k) => model.arena.landmarks[k][0], noLandmark, 0));
  if (obstacles.length) boxes.push(presence("Obstacles", "obstacle", [...obstacles.keys()], (k) => `${obstacles[k][2] > 100 ? "wall" : "obstacle"} ${k + 1}`, noObstacle, 0));
  if (model.world !== "search" && (model.arena.shape !== "open" || model.arena.walled)) {
    const more = document.createElement("button");
    Object.assign(more, { id: "more-obstacles", type: "button", textContent: "Add an obstacle" });
    more.addEventListener("click", () => { obstacles.push([0, 0, 0.15 * usual.arena]); changed(); });
    $("controls").append(more);
  }
  const shownOf = (places, hidden) => places.map((at, k) => (hidden.has(k) ? at.map((value, axis) => (axis < 2 ? Infinity : value)) : at));

  /** A box for each thing that can be taken away, of which so many stay. */
  function presence(title, key, things, nameOf, gone, least) {
    const group = document.createElement("fieldset"), legend = document.createElement("legend");
    legend.textContent = `${title} that are there`;
    group.append(legend);
    $("controls").append(group);
    const all = things.map((i) => {
      const label = document.createElement("label"), box = document.createElement("input");
      Object.assign(box, { id: `control-${key}-${i}`, type: "checkbox", checked: true });
      label.append(box, ` ${nameOf(i)}`);
      group.append(label);
      return [i, box];
    });
    const mark = () => {
      gone.clear();
      all.forEach(([i, box]) => box.checked || gone.add(i));
      all.forEach(([, box]) => (box.disabled = box.checked && gone.size === all.length - least));
    };
    all.forEach(([, box]) => box.addEventListener("change", () => { mark(); changed(); }));
    return { reset: () => { all.forEach(([, box]) => (box.checked = true)); mark(); } };
  }
  const kinds = [...new Set(model.quantities.map(({ kind }) => kind))];
  const kind = choice("kind", "Compare", kinds.map((one) => [one, one]), kinds[0]);
  const seed = choice("seed", "Random numbers", [0, 1, 2, 3, 4].map((k) => [k, `seed ${k}`]), 0);

  function options() {
    return {
      ...usual,
      thrust: usual.thrust.map((value, i) => value * (body.value === "speed" ? (found ? found[i] : 1) : factorOf(i))),
      arena: usual.arena * (factors.arena || 1),
      boundary: usual.boundary === null ? null : usual.boundary * (factors.arena || 1),
      contact: usual.contact * (factors.contact || 1),
      warmth: factors.warmth || 1,
      condition: condition && condition.value !== "" ? Number(condition.value) : null,
      absent: [...absent],
      landmarks: shownOf(landmarks, noLandmark),
      obstacles: shownOf(obstacles, noObstacle),
    };
  }

  // -- one episode ---------------------------------------------------------------------------------

  const stage = $("stage"), pen = stage.getContext("2d");
  const starts = model.starts.condition.length;
  for (let k = 0; k < starts; k++) $("start").add(new Option(`recording ${k + 1}`, k));
  names.forEach((name, i) => $("steer").add(new Option(name, i)));
  let playing = false, places = null, episodes = [], track = [], carried = 0, dragged = -1;
  const held = new Set();
  let finger = null; // where a finger steers to, arena frame

  /** The same start in the changed and in the unchanged world. */
  function begin() {
    const start = Number($("start").value);
    episodes = [options(), usual].map((chosen) => {
      const world = AnimaRL.makeWorld(model, chosen, 1), policy = new AnimaRL.Policy(model, 1);
      const [state, told] = AnimaRL.conditions(model, chosen, start);
      world.begin(0, start, places, state, AnimaRL.stream(~Number(seed.value), start, 0));
      return { world, policy, chosen, flags: Int8Array.of(told),
        draw: AnimaRL.stream(Number(seed.value), start, 0), trail: [Array.from(world.position)] };
    });
    track = [Array.from(episodes[0].world.position)];
    carried = 0;
    draw();
  }

  function advance(one, steered) {
    const { world, policy, flags, chosen, draw: random } = one;
    if (world.over[0]) return;
    policy.decide(world.observation, flags, [0]);
    const actions = names.map((_, i) => policy.choose(i, i, random(), chosen.warmth));
    if (world.warming(0) && model.starts.actions !== null) {
      names.forEach((_, i) => (actions[i] = model.starts.actions[(world.start[0] * model.starts.frames + world.steps[0]) * K + i]));
    } else if (steered >= 0 && !world.absent[steered]) actions[steered] = steering(world, steered);
    actions.forEach((action, i) => (policy.previous[i] = action));
    world.step(0, actions);
    one.trail.push(Array.from(world.position));
  }

  /** Where the arrow keys that are held point to. */
  const pointed = () => [held.has("ArrowRight") - held.has("ArrowLeft"), held.has("ArrowUp") - held.has("ArrowDown")];

  /** Places that can be dragged, with what moves them: starts of animals, landmarks, obstacles. */
  function handles() {
    const { world } = episodes[0], factor = world.size / usual.arena;
    const move = (places, k, place) => { places[k].splice(0, 2, ...place.map((value) => value / factor)); changed(); };
    const own = names.map((_, i) => [absent.has(i) ? [Infinity, 0] : [world.position[2 * i], world.position[2 * i + 1]], (place) => moveStart(i, place)]);
    return [...own, ...[[world.landmarks || [], landmarks], [world.holes || [], obstacles]].flatMap(([shown, places]) =>
      shown.map((at, k) => [at, (place) => move(places, k, place)]))];
  }

  function moveStart(moved, place) {
    const p = episodes[0].world.position;
    places = names.map((_, i) => (i === moved ? place : [p[2 * i], p[2 * i + 1]]));
    begin();
  }

  /** The action of the keys that are held or of the finger; none without either. */
  function steering(world, i) {
    let [x, y] = pointed();
    if (finger) [x, y] = [finger[0] - world.position[2 * i], finger[1] - world.position[2 * i + 1]];
    return x || y ? AnimaRL.actionTowards(world, 0, i, x, y) : model.pushes[i].length - 1;
  }

  function step() {
    const steered = Number($("steer").value);
    advance(episodes[0], steered);
    advance(episodes[1], -1);
    if (!episodes[0].world.over[0] || track.length < episodes[0].trail.length) track = episodes[0].trail;
    if (episodes[0].world.over[0] && episodes[1].world.over[0]) stop();
  }

  function stop() {
    playing = false;
    $("play").textContent = "Play";
  }

  let last = 0;
  function frame(now) {
    if (playing) {
      carried += Math.min(0.1, (now - last) / 1000) * Number($("pace").value) * (model.world === "search" ? 10 : 1);
      for (; carried >= model.dt && playing; carried -= model.dt) step();
      draw();
    }
    last = now;
    requestAnimationFrame(frame);
  }

  function reach() {
    if (model.world === "search") return 0.36;
    const seen = model.arena.shape === "open" ? episodes.flatMap((one) => Array.from(one.world.position, Math.abs)) : [];
    return 1.12 * Math.max(usual.arena, episodes[0] ? episodes[0].world.size : usual.arena, ...seen);
  }

  function toPixels([x, y]) {
    const half = stage.width / 2, unit = half / reach();
    const shift = model.world === "search" ? -0.15 : 0; // the source stands left of the middle
    return [half + (x + shift) * unit, half - y * unit];
  }

  function toArena(event) {
    const box = stage.getBoundingClientRect(), half = stage.width / 2, unit = half / reach();
    const px = ((event.clientX - box.left) / box.width) * stage.width;
    const py = ((event.clientY - box.top) / box.height) * stage.height;
    return [(px - half) / unit + (model.world === "search" ? 0.15 : 0), (half - py) / unit];
  }

  function line(points, style, width) {
    pen.beginPath();
    points.forEach((point, k) => pen[k ? "lineTo" : "moveTo"](...toPixels(point)));
    Object.assign(pen, { strokeStyle: style, lineWidth: width });
    pen.stroke();
  }

  function draw() {
    const style = getComputedStyle(document.documentElement), quiet = style.getPropertyValue("--quiet");
    const { world } = episodes[0], unit = stage.width / 2 / reach();
    pen.clearRect(0, 0, stage.width, stage.height);
    if (model.world === "search") drawPlume(world);
    for (const [size, dash] of [[world.size, []], [usual.arena, [6, 6]]]) {
      if (model.arena.shape === "open") break;
      pen.setLineDash(dash);
      Object.assign(pen, { strokeStyle: quiet, lineWidth: 1.5 });
      pen.beginPath();
      if (model.arena.shape === "disc") pen.arc(...toPixels([0, 0]), size * unit, 0, 2 * Math.PI);
      else pen.rect(...toPixels([-size, size]), 2 * size * unit, 2 * size * unit);
      pen.stroke();
    }
    pen.setLineDash([]);
    Object.assign(pen, { strokeStyle: quiet, fillStyle: style.getPropertyValue("--field"), lineWidth: 1.5 });
    for (const ink of ["stroke", "fill"]) for (const [x, y, radius] of world.holes || []) {
      if (x === Infinity || (ink === "fill" && radius < 100 * world.size)) continue; // what lies behind a straight wall is hidden
      pen.beginPath();
      pen.arc(...toPixels([x, y]), radius * unit, 0, 2 * Math.PI);
      pen[ink]();
    }
    pen.fillStyle = quiet;
    (world.landmarks || []).forEach((at, k) => {
      if (at[0] < Infinity) pen.fillText(`\u25b2 ${model.arena.landmarks[k][0]}`, ...toPixels(at));
    });
    const recorded = model.recorded.paths, start = Number($("start").value);
    if (recorded && !places) {
      const [from, to] = model.recorded.offsets.slice(start, start + 2);
      for (let i = 0; i < K; i++) {
        const points = [];
        for (let t = from; t < to; t++) points.push([recorded[2 * (t * K + i)], recorded[2 * (t * K + i) + 1]]);
        line(points, quiet, 0.7);
      }
    }
    for (let i = 0; i < K; i++) {
      const tail = episodes[0].trail.slice(-80).map((p) => [p[2 * i], p[2 * i + 1]]);
      if (!absent.has(i)) line(tail, colour(i), 2);
      const ghost = toPixels([episodes[1].world.position[2 * i], episodes[1].world.position[2 * i + 1]]);
      Object.assign(pen, { strokeStyle: colour(i), lineWidth: 1.5 });
      pen.beginPath();
      pen.arc(...ghost, 9, 0, 2 * Math.PI);
      pen.stroke();
      if (absent.has(i)) continue;
      const at = toPixels([world.position[2 * i], world.position[2 * i + 1]]);
      pen.beginPath();
      pen.arc(...at, 9, 0, 2 * Math.PI);
      pen.fillStyle = colour(i);
      pen.fill();
      pen.fillStyle = style.getPropertyValue("--ink");
      pen.font = "18px system-ui, sans-serif";
      if (K <= 6) pen.fillText(names[i], at[0] + 13, at[1] - 9);
    }
    const goal = model.world === "search" ? [0, 0] : [world.position[2 * K - 2], world.position[2 * K - 1]];
    Object.assign(pen, { strokeStyle: TARGET, lineWidth: 1 });
    pen.beginPath();
    if (!model.free) pen.arc(...toPixels(goal), world.contact * unit, 0, 2 * Math.PI);
    pen.stroke();
    const time = (world.steps[0] * model.dt).toFixed(1);
    $("state").textContent = world.over[0] ? `${time} s: ${ending(world.outcome[0])}` : `${time} s`;
  }

  function drawPlume(world) {
    const { rows, columns, source_row, source_column, cell, bits } = model.plume, [, steps, bytes] = bits.shape;
    const step = (world.phase[0] + world.steps[0]) % steps, base = (world.pattern[0] * steps + step) * bytes;
    pen.fillStyle = "rgba(150, 120, 40, 0.35)";
    const unit = stage.width / 2 / reach(), side = Math.max(1, cell * unit);
    for (let k = 0; k < rows * columns; k++) {
      if (!((bits[base + (k >> 3)] >> (k & 7)) & 1)) continue;
      const x = ((k % columns) - source_column) * cell, y = (Math.floor(k / columns) - source_row) * cell;
      pen.fillRect(...toPixels([x, y]), side, side);
    }
  }

  function ending(outcome) {
    if (outcome > 0) return model.world === "search" ? "the source is reached" : `${names[outcome - 1]} touches ${model.lone ? names[K - 1] : "the target"}`;
    if (outcome === 0) return "the time limit";
    if (model.free) return "an animal leaves the arena";
    return outcome === -1 ? "the target leaves the arena" : "a pursuer leaves the arena";
  }

  stage.addEventListener("pointerdown", (event) => {
    stage.focus();
    const place = toArena(event), { world } = episodes[0];
    if (world.steps[0] === 0 && !playing) {
      const apart = handles().map(([[x, y]]) => Math.hypot(x - place[0], y - place[1]));
      const nearest = apart.indexOf(Math.min(...apart));
      if (apart[nearest] < 0.08 * reach()) dragged = nearest;
    }
    if (dragged < 0) finger = place;
    stage.setPointerCapture(event.pointerId);
  });
  stage.addEventListener("pointermove", (event) => {
    const place = toArena(event);
    if (dragged >= 0) handles()[dragged][1](place);
    else if (finger) finger = place;
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    stage.addEventListener(kind, () => { dragged = -1; finger = null; });
  }
  stage.addEventListener("keydown", (event) => {
    if (event.key.startsWith("Arrow")) {
      held.add(event.key);
      event.preventDefault();
      const i = Number($("steer").value), { world } = episodes[0], by = 0.02 * reach();
      if (i >= 0 && !absent.has(i) && world.steps[0] === 0 && !playing) {
        moveStart(i, pointed().map((sign, axis) => world.position[2 * i + axis] + by * sign));
      }
    }
    if (event.key === " ") { $("play").click(); event.preventDefault(); }
  });
  stage.addEventListener("keyup", (event) => held.delete(event.key));
  stage.addEventListener("blur", () => held.clear());
  $("play").addEventListener("click", () => {
    if (episodes[0].world.over[0] && episodes[1].world.over[0]) begin();
    playing = !playing;
    $("play").textContent = playing ? "Pause" : "Play";
    if (playing && $("steer").value !== "-1") stage.focus();
  });
  $("restart").addEventListener("click", () => { stop(); begin(); });
  $("start").addEventListener("change", () => { places = null; stop(); begin(); });
  $("reset").addEventListener("click", () => {
    [...sliders, ...boxes].forEach((one) => one.reset());
    [landmarks, obstacles] = [copied(usual.landmarks), copied(usual.obstacles)];
    if (condition) condition.value = "";
    places = null;
    changed();
  });

  /** The track of the episode on the stage as a table: a column for each coordinate. */
  function table() {
    const there = (_, k) => !absent.has(k >> 1);
    const head = ["time", ...names.flatMap((name) => [`${name}_x`, `${name}_y`]).filter(there)];
    const quoted = head.map((name) => (/[",\n]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name));
    const rows = track.map((p, t) => [(t * model.dt).toFixed(4), ...p.filter(there).map((value) => (value * scale).toFixed(6))]);
    return [quoted, ...rows].map((row) => row.join(",")).join("\n") + "\n";
  }
  $("save").addEventListener("click", () => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([table()], { type: "text/csv" }));
    link.download = `${model.name}_track.csv`;
    link.click();
    URL.revokeObjectURL(link.href);
  });

  // -- many episodes -------------------------------------------------------------------------------

  const GLUE = `
    let model = null;
    onmessage = async ({ data }) => {
      if (data.model) { model = AnimaRL.unpack(data.model); return; }
      const progress = (share) => postMessage({ id: data.id, share });
      const { options, wanted, tasks, seed, measured } = data, known = await model;
      const found = wanted
        ? await AnimaRL.findThrusts(known, options, wanted, tasks, seed, progress)
        : await AnimaRL.rollOut(known, options, tasks, seed, progress, measured);
      postMessage({ id: data.id, found });
    };`;
  const program = URL.createObjectURL(new Blob([$("engine").textContent, GLUE], { type: "text/javascript" }));
  const raw = JSON.parse($("model").textContent);
  let worker = null, asked = 0, waiting = null;
  const baselines = new Map();

  function freshWorker() {
    if (worker) worker.terminate();
    worker = new Worker(program);
    worker.postMessage({ model: raw });
    return worker;
  }

  /** Simulate many episodes; with wanted speeds, find the thrusts that give them in these episodes. */
  function simulate(chosen, share, wanted = null) {
    const id = ++asked, tasks = [];
    for (let again = 0; tasks.length < ROLLOUTS; again++) {
      for (let k = 0; k < starts && tasks.length < ROLLOUTS; k++) tasks.push([k, again]);
    }
    return new Promise((resolve) => {
      worker.onmessage = ({ data }) => {
        if (data.id !== id) return;
        if (data.found) resolve(data.found);
        else share(data.share);
      };
      worker.postMessage({ id, options: chosen, tasks, wanted, seed: Number(seed.value), measured: kind.value !== kinds[0] });
    });
  }

  const meanOf = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
  /** How each quantity is read from an episode; those that are not here are measures of the verdict. */
  const readings = {
    speed: (one) => meanOf(one.speed), "nearest neighbour": (one) => one.distance, "mean distance": (one) => one.distance,
    reached: (one) => one.reached, duration: (one) => one.duration, "path length": (one) => one.path,
  };
  names.forEach((name, i) => (readings[`speed of ${name}`] = (one) => one.speed[i]));
  const quantities = model.quantities.map((one) => {
    const reading = one.kind === kinds[0] && readings[one.name], usually = (result) => one.scale * (result.measures[one.name] ?? NaN);
    return { ...one, value: reading || usually, index: names.findIndex((name) => one.name.endsWith(` of ${name}`) || one.name.endsWith(`, ${name}`)) };
  });

  async function answer() {
    const token = (waiting = {});
    freshWorker();
    const say = (part) => {
      const first = performance.now();
      $("progress").textContent = `${part}: ${ROLLOUTS} episodes are simulated ...`;
      return (share) => {
        const left = ((performance.now() - first) / 1000) * (1 / share - 1);
        $("progress").textContent = `${part}: ${Math.round(100 * share)} % of ${ROLLOUTS} episodes${share > 0 ? `, about ${Math.ceil(left)} s left` : ""}`;
      };
    };
    const key = `${seed.value} ${kind.value === kinds[0]}`;
    if (!baselines.has(key)) baselines.set(key, await simulate(usual, say("unchanged world")));
    if (token !== waiting) return;
    const before = baselines.get(key), moved = names.map((_, i) => i).filter((i) => factorOf(i) !== 1 && !absent.has(i));
    let told = "";
    if (body.value === "speed" && moved.length) {
      const usually = (i) => before.results.reduce((sum, one) => sum + one.speed[i], 0) / ROLLOUTS;
      const wanted = moved.map((i) => [i, factorOf(i) * usually(i), usually(i)]);
      const { factors: thrusts, reached } = await simulate(options(), (share) => {
        $("progress").textContent = `Thrusts for these speeds: try ${Math.round(10 * share)} of 10 at most`;
      }, wanted);
      if (token !== waiting) return;
      found = names.map((_, i) => (moved.includes(i) ? thrusts[moved.indexOf(i)] : 1));
      told = ` Thrust ${alike ? `× ${meanOf(found).toFixed(2)} on average` : moved.map((i) => `× ${found[i].toFixed(2)} for ${names[i]}`).join(", ")}`
        + (reached ? "." : ": no thrust was found that reaches the wanted speed, so look at the speeds in the table.");
      begin();
    }
    const began = performance.now(), after = await simulate(options(), say("changed world"));
    if (token !== waiting) return;
    $("progress").textContent = `${ROLLOUTS} episodes of the changed world in ${((performance.now() - began) / 1000).toFixed(1)} s.${told}`;
    show(before, after);
  }

  function show(before, after) {
    const more = after.beyond.map((share, i) => (absent.has(i) ? 0 : share - before.beyond[i]));
    const worst = more.indexOf(Math.max(...more)), n = model.ranges.words.length;
    const red = more[worst] > RED, some = more[worst] > YELLOW;
    const inputs = after.inputs.slice(worst * n, (worst + 1) * n).map((value, c) => value - before.inputs[worst * n + c]);
    const which = model.ranges.words[inputs.indexOf(Math.max(...inputs))].replace(/{(\d+)}/, (_, k) => model.ranges.others[worst][k - 1]);
    $("warning").className = `warning ${red ? "red" : some ? "some" : "none"}`;
    $("warning").textContent = some
      ? `${red ? "This answer is a guess. " : ""}In ${Math.round(100 * more[worst])} % more steps than usual ${names[worst]} perceives what it never did in training: most often, ${which}.`
      : "The animals perceive hardly anything that they did not perceive in training.";
    const body = $("table");
    body.replaceChildren();
    // A quantity of nobody is not asked, nor the speed of one of a group that is not changed alone.
    const alone = (i) => !alike || kind.value !== kinds[0] || i < 0 || factors[`body-${i}`] !== 1;
    const shown = quantities.filter((one) => one.kind === kind.value && !absent.has(one.index) && alone(one.index));
    const known = (name) => model.recorded.measured[name].filter((value) => value !== null);
    for (const { name, unit, value } of shown) {
      const truth = meanOf(known(name)), [{ mean: b, error }, { mean: a, error: later }] = [before, after].map(({ results }) => AnimaRL.meanWithChance(results, value));
      const shift = AnimaRL.pairedShift(before.results, after.results, value, model.starts.recording);
      const unclear = shift.low <= 0 && shift.high >= 0, small = Math.abs(shift.mean) < Math.abs(b - truth);
      const row = body.insertRow();
      row.className = red ? "hatched" : unclear || small ? "grey" : "";
      const number = (x, digits = 3) => (Number.isNaN(x) ? "not known" : Number(x.toPrecision(digits)).toString());
      const sign = shift.mean > 0 ? "+" : "", chance = (x, by) => number(x) + (Number.isNaN(by) ? "" : ` ± ${number(by, 2)}`);
      [name, number(truth), chance(b, error), chance(a, later), `${sign}${number(shift.mean)} [${number(shift.low)}, ${number(shift.high)}] ${unit}`]
        .forEach((text) => (row.insertCell().textContent = text));
    }
    const box = $("histograms");
    const leaving = !model.free || [...before.results, ...after.results].some((one) => one.outcome !== 0);
    box.replaceChildren(...(leaving ? [outcomes(before.results, after.results)] : []));
    const moving = shown.filter(({ name }) => name !== "reached" && name !== "mean distance");
    for (const { name, unit, value } of moving.slice(0, 5)) {
      const [one, other] = [before, after].map(({ results }) => results.map(value).filter((number) => !Number.isNaN(number)));
      if (one.length && other.length) box.append(histogram(unit ? `${name} [${unit}]` : name, known(name), one, other));
    }
  }

  const SVG = "http://www.w3.org/2000/svg";
  function element(name, attributes) {
    const node = document.createElementNS(SVG, name);
    Object.entries(attributes).forEach(([key, value]) => node.setAttribute(key, value));
    return node;
  }

  function figure(caption, draw, height = 120) {
    const box = document.createElement("figure"), text = document.createElement("figcaption");
    text.textContent = caption;
    const svg = element("svg", { viewBox: `0 0 240 ${height}`, role: "img", "aria-label": caption });
    draw(svg);
    box.append(text, svg);
    return box;
  }

  function label(svg, x, y, text, anchor = "middle") {
    const node = element("text", { x, y, "text-anchor": anchor, "font-size": 10, fill: "currentColor" });
    node.textContent = text;
    svg.append(node);
  }

  /** Unchanged as a filled area, changed as bars' outline, recorded as a dashed outline. */
  function histogram(caption, recorded, before, after) {
    const every = [...recorded, ...before, ...after], low = Math.min(...every), high = Math.max(...every), BINS = 20;
    const width = (high - low) / BINS || 1;
    const shares = (values) => {
      const counts = new Array(BINS).fill(0);
      values.forEach((value) => (counts[Math.min(BINS - 1, Math.floor((value - low) / width))] += 1 / values.length));
      return counts;
    };
    const all = [recorded, before, after].map(shares), most = Math.max(...all.flat());
    return figure(caption, (svg) => {
      const outline = (counts) => counts.map((share, k) => {
        const x = 10 + (220 / BINS) * k, y = 100 - (90 * share) / most;
        return `${k ? "L" : "M"}${x},${y}L${x + 220 / BINS},${y}`;
      }).join("");
      svg.append(element("path", { d: `${outline(all[1])}L230,100L10,100Z`, fill: "var(--grey)", "fill-opacity": 0.45 }));
      svg.append(element("path", { d: outline(all[0]), fill: "none", stroke: "currentColor", "stroke-dasharray": "3 2" }));
      svg.append(element("path", { d: outline(all[2]), fill: "none", stroke: "var(--changed)", "stroke-width": 2 }));
      label(svg, 10, 114, Number(low.toPrecision(3)), "start");
      label(svg, 230, 114, Number(high.toPrecision(3)), "end");
    });
  }

  function outcomes(before, after) {
    const codes = [...new Set([...before, ...after].map((one) => one.outcome))].sort((a, b) => b - a);
    const share = (all, code) => all.filter((one) => one.outcome === code).length / all.length;
    const STEP = 30;
    return figure("endings", (svg) => {
      codes.forEach((code, k) => {
        const y = STEP * k + 14, place = { x: 10, y, height: 12 };
        const [b, a] = [share(before, code), share(after, code)];
        svg.append(element("rect", { ...place, width: 220 * b, fill: "var(--grey)", "fill-opacity": 0.45 }));
        svg.append(element("rect", { ...place, width: 220 * a, fill: "none", stroke: "var(--changed)", "stroke-width": 2 }));
        label(svg, 10, y - 3, `${ending(code)}: ${Math.round(100 * b)} → ${Math.round(100 * a)} %`, "start");
      });
    }, Math.max(60, STEP * codes.length + 4));
  }

  let timer = 0;
  function changed() {
    found = null;
    $("progress").textContent = "The changed world is simulated ...";
    stop();
    begin();
    clearTimeout(timer);
    timer = setTimeout(answer, 150);
  }

  const fewest = Math.floor(ROLLOUTS / starts), most = Math.ceil(ROLLOUTS / starts), of = model.starts.of;
  $("rollouts").textContent = `${ROLLOUTS} rollouts, ${fewest === most ? most : `${fewest} or ${most}`} from ${starts === 1 ? "the one test start" : `each of ${starts} test starts`}${starts < of ? ` (the first of ${of})` : ""}.`;
  begin();
  requestAnimationFrame(frame);
  answer();
  window.animarlPage = { model, table, episode: () => episodes[0], step, answered: () => $("table").rows.length };
})();
