// Paths as they are packed in the page: 16-bit numbers across a box, in base64.

/** Coordinates of a track: x and y of every individual, frame after frame [arena unit]. */
function unpackPath(packed, [x, y, step]) {
  const bytes = Uint8Array.from(atob(packed), (sign) => sign.charCodeAt(0));
  const levels = new DataView(bytes.buffer);
  const path = new Float32Array(bytes.length / 2);
  for (let i = 0; i < path.length; i += 1) {
    path[i] = (i % 2 ? y : x) + step * levels.getUint16(2 * i, true);
  }
  return path;
}

/** One episode that can be asked where everybody was. */
class Track {
  constructor({ path, ending }, box, count) {
    this.path = unpackPath(path, box);
    this.count = count;
    this.frames = this.path.length / (2 * count);
    this.ending = ending;
  }

  /** Place of one individual; after the end it stays where it was. */
  at(frame, who) {
    const i = 2 * (Math.min(frame, this.frames - 1) * this.count + who);
    return [this.path[i], this.path[i + 1]];
  }

  hasEnded(frame) {
    return frame >= this.frames - 1;
  }
}

/** The scenes of the page, their tracks unpacked when they are first shown. */
function readScenes(data) {
  return data.scenes.map((scene) => ({
    ...scene,
    cache: {},
    track(kind, count) {
      if (!scene.tracks[kind]) return null;
      this.cache[kind] ??= new Track(scene.tracks[kind], scene.box, count);
      return this.cache[kind];
    },
  }));
}

/** Whether pursuers touch the target, or the searcher is at the source, in a frame. */
function inContact(track, frame, data) {
  if (data.contact === null) return false;
  const last = data.individuals.length - 1;
  return data.individuals.some(({ role }, who) => {
    if (role === "target") return false;
    const [x, y] = track.at(frame, who);
    const [tx, ty] = role === "searcher" ? [0, 0] : track.at(frame, last);
    return Math.hypot(x - tx, y - ty) <= data.contact;
  });
}
