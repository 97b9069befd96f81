// The player: one start at a time, side by side; play, scrub, speed, keyboard.

const LONGEST = 30; // seconds that the first start takes, as the page is opened

class Player {
  constructor(data) {
    this.data = data;
    this.scenes = readScenes(data);
    this.find = (name) => document.getElementById(name);
    this.frame = 0;
    this.playing = false;
    this.last = null;
    this.fill("start", this.scenes.map(({ title }) => title));
    this.fill("view", data.views.map(({ title }) => title));
    this.find("viewing").hidden = data.views.length < 2;
    document.querySelectorAll(".controls").forEach((row) => { row.hidden = false; });
    this.listen();
    this.setView(0);
    this.suitSpeed();
  }

  /** As slow as may be, but so that the first start is over in good time. */
  suitSpeed() {
    const speed = this.find("speed");
    const seconds = this.frames * this.data.dt;
    const speeds = [...speed.options].map(({ value }) => Number(value));
    const fitting = speeds.findIndex((value) => value >= 1 && seconds / value <= LONGEST);
    speed.selectedIndex = fitting < 0 ? speeds.length - 1 : fitting;
  }

  fill(name, titles) {
    this.find(name).append(...titles.map((title, i) => new Option(title, i)));
  }

  get scene() {
    return this.scenes[this.find("start").selectedIndex];
  }

  /** Frames of the longest track that is shown. */
  get frames() {
    return Math.max(...this.stages.map(({ kind, data }) => this.scene.track(kind, data.individuals.length)?.frames ?? 1));
  }

  setView(index) {
    this.stages = this.data.views[index].panels.map((panel) => new Stage(panel, this.data));
    this.find("panels").replaceChildren(...this.stages.map((stage) => stage.element));
    this.setScene(this.find("start").selectedIndex);
  }

  setScene(index) {
    this.find("start").selectedIndex = (index + this.scenes.length) % this.scenes.length;
    this.find("time").max = this.frames - 1;
    this.seek(0);
  }

  seek(frame) {
    this.frame = Math.max(0, Math.min(frame, this.frames - 1));
    this.draw();
  }

  draw() {
    const frame = Math.floor(this.frame);
    const zoom = Number(this.find("zoom").value);
    this.stages.forEach((stage) => stage.draw(this.scene, frame, zoom));
    const seconds = (steps) => (steps * this.data.dt).toFixed(1);
    const clock = `${seconds(frame)} of ${seconds(this.frames - 1)} s`;
    this.find("clock").textContent = clock;
    this.find("time").value = frame;
    this.find("time").setAttribute("aria-valuetext", clock);
  }

  play(on) {
    if (on && this.frame >= this.frames - 1) this.seek(0);
    this.playing = on;
    this.last = null;
    this.find("play").textContent = on ? "Pause" : "Play";
    if (on) requestAnimationFrame((now) => this.advance(now));
  }

  advance(now) {
    if (!this.playing) return;
    const passed = this.last === null ? 0 : (now - this.last) / 1000;
    this.last = now;
    this.seek(this.frame + (passed * Number(this.find("speed").value)) / this.data.dt);
    if (this.frame >= this.frames - 1) this.play(false);
    else requestAnimationFrame((later) => this.advance(later));
  }

  step(by) {
    this.play(false);
    this.seek(Math.floor(this.frame) + by);
  }

  changeSpeed(by) {
    const speed = this.find("speed");
    speed.selectedIndex = Math.max(0, Math.min(speed.options.length - 1, speed.selectedIndex + by));
  }

  listen() {
    const on = (name, event, act) => this.find(name).addEventListener(event, act);
    on("play", "click", () => this.play(!this.playing));
    on("time", "input", () => { this.play(false); this.seek(Number(this.find("time").value)); });
    on("before", "click", () => this.setScene(this.find("start").selectedIndex - 1));
    on("after", "click", () => this.setScene(this.find("start").selectedIndex + 1));
    on("start", "change", () => this.setScene(this.find("start").selectedIndex));
    on("zoom", "change", () => this.draw());
    on("view", "change", () => this.setView(this.find("view").selectedIndex));
    on("player", "keydown", (event) => this.press(event));
    new ResizeObserver(() => this.draw()).observe(this.find("panels"));
  }

  /** Keys work on the panels and the slider; in lists and on buttons they mean what they always do. */
  press(event) {
    if (!["panels", "time"].includes(event.target.id) || event.ctrlKey || event.metaKey || event.altKey) return;
    const keys = {
      " ": () => this.play(!this.playing),
      ArrowRight: () => this.step(1),
      ArrowLeft: () => this.step(-1),
      ArrowDown: () => this.setScene(this.find("start").selectedIndex + 1),
      ArrowUp: () => this.setScene(this.find("start").selectedIndex - 1),
      Home: () => this.step(-this.frames),
      End: () => this.step(this.frames),
      "+": () => this.changeSpeed(1),
      "-": () => this.changeSpeed(-1),
    };
    if (!(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  }
}
