// One panel of the player: a canvas on which a track is drawn up to a frame.

const DASHES = [[], [7, 3], [2, 3], [8, 3, 2, 3], [4, 2]];

/** Draw a mark of one individual around a place: shapes differ, as colours do. */
function drawMark(context, mark, x, y, size) {
  context.beginPath();
  if (mark === "o") {
    context.arc(x, y, size, 0, 2 * Math.PI);
  } else if (mark === "X") {
    for (const [dx, dy] of [[-1, -0.5], [-0.5, -1], [0, -0.5], [0.5, -1], [1, -0.5], [0.5, 0],
      [1, 0.5], [0.5, 1], [0, 0.5], [-0.5, 1], [-1, 0.5], [-0.5, 0]]) {
      context.lineTo(x + 1.2 * size * dx, y + 1.2 * size * dy);
    }
    context.closePath();
  } else {
    const corners = { s: 4, "^": 3, D: 4, v: 3, P: 8 }[mark] ?? 6;
    const turn = { s: Math.PI / 4, D: 0, v: Math.PI / 2 }[mark] ?? -Math.PI / 2;
    for (let i = 0; i < corners; i += 1) {
      const angle = turn + (2 * Math.PI * i) / corners;
      context.lineTo(x + 1.25 * size * Math.cos(angle), y + 1.25 * size * Math.sin(angle));
    }
    context.closePath();
  }
  context.fill();
  context.stroke();
}

class Stage {
  constructor({ title, track, world = {} }, data) {
    this.data = { ...data, ...world }; // a panel may show another world
    this.kind = track;
    this.title = title;
    this.element = document.createElement("figure");
    this.element.className = "panel";
    const caption = document.createElement("figcaption");
    caption.append(title);
    this.state = document.createElement("output");
    caption.append(this.state);
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.element.append(caption, this.canvas);
  }

  /** Draw a scene's track up to a frame; zoomed in, the middle of the animals stays in the middle. */
  draw(scene, frame, zoom) {
    const track = scene.track(this.kind, this.data.individuals.length);
    const side = Math.min(this.canvas.clientWidth, this.canvas.clientHeight) || 300;
    const dots = window.devicePixelRatio || 1;
    if (this.canvas.width !== Math.round(side * dots)) {
      this.canvas.width = Math.round(side * dots);
      this.canvas.height = Math.round(side * dots);
    }
    const context = this.canvas.getContext("2d");
    context.setTransform(dots, 0, 0, dots, 0, 0);
    context.clearRect(0, 0, side, side);
    context.lineJoin = "round";
    context.font = "12px system-ui, sans-serif";
    const half = scene.view[2] / zoom;
    const [cx, cy] = zoom > 1 && track !== null ? this.middle(track, frame) : scene.view;
    const scale = side / (2 * half);
    this.place = ([x, y]) => [(x - cx + half) * scale, (cy + half - y) * scale];
    this.drawField(context, scale, side, scene.bar.length / zoom, parseFloat(scene.bar.label) / zoom);
    if (track === null) {
      this.say("not simulated from this start");
      return;
    }
    const touching = inContact(track, frame, this.data);
    this.drawContact(context, scale, track, frame, touching);
    this.data.individuals.forEach((_, who) => this.drawTrail(context, track, frame, who));
    this.drawBodies(context, track, frame, side);
    const ended = track.hasEnded(frame);
    const last = ((track.frames - 1) * this.data.dt).toFixed(1);
    this.say(ended ? `${track.ending}, ${last} s` : touching ? "contact" : "");
  }

  middle(track, frame) {
    const places = this.data.individuals.map((_, who) => track.at(frame, who));
    return [0, 1].map((axis) => places.reduce((sum, place) => sum + place[axis], 0) / places.length);
  }

  say(text) {
    if (this.state.textContent !== text) this.state.textContent = text;
    this.canvas.setAttribute("aria-label", `${this.title}: paths of ${this.data.individuals
      .map(({ name }) => name).join(", ")}${text ? `; ${text}` : ""}`);
  }

  drawField(context, scale, side, length, value) {
    const { shape, size, walls, obstacles, corners, landmarks } = this.data.arena;
    context.strokeStyle = colourOf("muted");
    context.lineWidth = walls ? 3 : 1;
    context.setLineDash(walls ? [] : [5, 4]);
    context.beginPath();
    const [x, y] = this.place([0, 0]);
    if (shape === "disc") context.arc(x, y, size * scale, 0, 2 * Math.PI);
    if (shape === "square") {
      for (const corner of corners) context.lineTo(...this.place(corner));
      context.closePath();
    }
    context.stroke();
    for (const [...at] of obstacles) {
      context.beginPath();
      context.arc(...this.place(at), at[2] * scale, 0, 2 * Math.PI);
      context.stroke();
    }
    context.setLineDash([]);
    context.strokeStyle = colourOf("text");
    context.fillStyle = colourOf("text");
    for (const [name, ...at] of landmarks) context.fillText(`\u25b2 ${name}`, ...this.place(at));
    if (this.data.individuals.some(({ role }) => role === "searcher")) {
      context.lineWidth = 2;
      context.beginPath();
      for (const [dx, dy] of [[5, 5], [5, -5]]) {
        context.moveTo(x - dx, y - dy);
        context.lineTo(x + dx, y + dy);
      }
      context.stroke();
      context.fillText("source", x + 8, y + 4);
    }
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(8, side - 8);
    context.lineTo(8 + length * scale, side - 8);
    context.stroke();
    context.fillText(`${Number(value.toPrecision(3))} ${this.data.unit}`, 8, side - 13);
  }

  drawContact(context, scale, track, frame, touching) {
    const { contact, individuals } = this.data;
    if (contact === null) return;
    const target = individuals.findIndex(({ role }) => role === "target");
    const [x, y] = this.place(target < 0 ? [0, 0] : track.at(frame, target));
    context.strokeStyle = colourOf(touching ? "touch" : "muted");
    context.lineWidth = touching ? 3 : 1;
    context.setLineDash(touching ? [] : [2, 3]);
    context.beginPath();
    context.arc(x, y, contact * scale, 0, 2 * Math.PI);
    context.stroke();
    context.setLineDash([]);
  }

  /** The whole path pale, and what was gone so far in full. */
  drawTrail(context, track, frame, who) {
    const { colour, role } = this.data.individuals[who];
    context.strokeStyle = colourOf(colour);
    context.setLineDash(role === "target" ? [] : DASHES[who % DASHES.length]);
    for (const [upTo, opacity, width] of [[track.frames - 1, 0.35, 1], [frame, 0.95, 1.75]]) {
      context.globalAlpha = opacity;
      context.lineWidth = width;
      context.beginPath();
      for (let f = 0; f <= Math.min(upTo, track.frames - 1); f += 1) context.lineTo(...this.place(track.at(f, who)));
      context.stroke();
    }
    context.globalAlpha = 1;
    context.setLineDash([]);
  }

  drawBodies(context, track, frame, side) {
    const taken = [];
    this.data.individuals.forEach(({ name, colour, mark }, who) => {
      const [x, y] = this.place(track.at(frame, who));
      context.fillStyle = colourOf(colour);
      context.strokeStyle = colourOf("page");
      context.lineWidth = 1.5;
      drawMark(context, mark, x, y, 5);
      const width = context.measureText(name).width;
      const left = x + 9 + width > side ? x - 9 - width : x + 9;
      let line = y + 4; // names do not cover each other
      while (taken.some(([l, t, w]) => Math.abs(t - line) < 13 && left < l + w && l < left + width)) line += 13;
      taken.push([left, line, width]);
      context.lineWidth = 3;
      context.strokeStyle = colourOf("floor");
      context.strokeText(name, left, line);
      context.fillStyle = colourOf("text");
      context.fillText(name, left, line);
    });
  }
}
