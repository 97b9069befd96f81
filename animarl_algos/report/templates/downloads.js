// Downloads: every figure as SVG and PNG, in light colours, and every table as CSV.

const PNG_SCALE = 3;

/** Let the reader save some content under a name. */
function save(name, content, type) {
  const link = document.createElement("a");
  const address = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type }));
  link.href = address;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}

/** A figure as a file of its own: its colours are no longer variables. */
function standaloneDrawing(svg) {
  const text = new XMLSerializer().serializeToString(svg);
  return text.replace(/var\(--[\w-]+, (#[0-9a-f]{6})\)/g, "$1");
}

/** A figure as pixels on white. */
async function pixels(svg) {
  const image = new Image();
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(standaloneDrawing(svg))}`;
  await image.decode();
  const { width, height } = svg.viewBox.baseVal;
  const natural = Number(svg.getAttribute("width"));
  const canvas = document.createElement("canvas");
  canvas.width = natural * PNG_SCALE;
  canvas.height = Math.round((natural * height * PNG_SCALE) / width);
  const context = canvas.getContext("2d");
  context.fillStyle = "white";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.drawImage(image, 0, 0, canvas.width, canvas.height);
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}

const INTERVAL = /^(\S+) \[(\S+), (\S+)\]$/;

/** A table as rows of texts; a column of estimates with intervals becomes three. */
function tidy(table) {
  const grouped = table.querySelector("tr.group") !== null;
  const heading = [...table.tHead.rows[0].cells].map((cell) => cell.textContent.replace(/\s+/g, " ").trim());
  const rows = [...table.tBodies].flatMap((body) => {
    const group = body.querySelector("tr.group")?.textContent.trim() ?? "";
    return [...body.rows]
      .filter((row) => !row.classList.contains("group"))
      .map((row) => ({ group, cells: [...row.cells].map((cell) => cell.textContent.trim()) }));
  });
  const wide = heading.map((_, i) => rows.some((row) => INTERVAL.test(row.cells[i])));
  const plain = (text) => {
    const number = text.replaceAll(MINUS, "-").replaceAll(",", "");
    if (text === UNDEFINED) return "";
    return number !== "" && Number.isFinite(Number(number)) ? number : text;
  };
  const spread = (text) => (text.match(INTERVAL)?.slice(1) ?? [text, "", ""]).map(plain);
  const line = (cells) => cells.flatMap((cell, i) => (wide[i] ? spread(cell) : [plain(cell)]));
  const names = heading.flatMap((name, i) => (wide[i] ? [name, `${name} low`, `${name} high`] : [name]));
  const first = (group) => (grouped ? [group] : []);
  return [[...first("Group"), ...names], ...rows.map((row) => [...first(row.group), ...line(row.cells)])];
}

/** Rows of texts as CSV (RFC 4180). A cell that a spreadsheet would run is made text. */
function csv(rows) {
  const safe = (cell) => (/^[=+@]/.test(cell) ? `'${cell}` : cell);
  const quoted = (cell) => (/[",\r\n]/.test(cell) ? `"${cell.replaceAll('"', '""')}"` : cell);
  return rows.map((row) => row.map((cell) => quoted(safe(cell))).join(",")).join("\r\n") + "\r\n";
}

/** Buttons below something that can be saved: `ways` is a list of file endings and what they do. */
function addButtons(place, what, ways) {
  const row = document.createElement("div");
  row.className = "get";
  for (const [kind, act] of ways) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = kind;
    button.setAttribute("aria-label", `Download ${what} as ${kind}`);
    button.addEventListener("click", act);
    row.append(button);
  }
  place.append(row);
}

function startDownloads() {
  for (const picture of document.querySelectorAll(".picture")) {
    const svg = picture.querySelector("svg");
    const { name } = picture.dataset;
    addButtons(picture, svg.getAttribute("aria-label"), [
      ["SVG", () => save(`${name}.svg`, standaloneDrawing(svg), "image/svg+xml")],
      ["PNG", async () => save(`${name}.png`, await pixels(svg), "image/png")],
    ]);
  }
  for (const table of document.querySelectorAll("table")) {
    const region = table.closest(".scroll");
    addButtons(region.parentElement, region.getAttribute("aria-label"), [
      ["CSV", () => save(`${table.dataset.name}.csv`, csv(tidy(table)), "text/csv")],
    ]);
  }
}
