// What the page does when it is opened.

const packed = document.getElementById("scenes");
const player = packed && new Player(JSON.parse(packed.textContent));
startThemes(() => player?.draw());
startTables();
startDownloads();
if (player && !matchMedia("(prefers-reduced-motion: reduce)").matches) player.play(true);
