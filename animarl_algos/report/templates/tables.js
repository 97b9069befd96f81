// Tables: a click on a column's heading sorts by it, within each group of rows.

const MINUS = "\u2212";
const UNDEFINED = "\u2013";

/** The number that a cell begins with, or null. */
function leadingNumber(text) {
  const found = text.replaceAll(MINUS, "-").replaceAll(",", "").match(/^-?\d+(\.\d+)?(e-?\d+)?/);
  return found ? Number(found[0]) : null;
}

/** Order of two cells: undefined ones last, numbers before words, each among their kind. */
function compareCells(first, second) {
  const [a, b] = [leadingNumber(first), leadingNumber(second)];
  if (a !== null && b !== null) return a - b;
  if (a !== null || b !== null) return a !== null ? -1 : 1;
  return first.localeCompare(second, "en");
}

function sortTable(table, column, descending) {
  for (const body of table.tBodies) {
    const rows = [...body.rows].filter((row) => !row.classList.contains("group"));
    const text = (row) => row.cells[column].textContent.trim();
    const known = rows.filter((row) => text(row) !== UNDEFINED && text(row) !== "");
    const unknown = rows.filter((row) => !known.includes(row));
    known.sort((a, b) => (descending ? -1 : 1) * compareCells(text(a), text(b)));
    body.append(...known, ...unknown);
  }
}

/** Give every heading of every table a button that sorts. */
function startTables() {
  for (const table of document.querySelectorAll("table")) {
    const headings = [...table.tHead.rows[0].cells];
    headings.forEach((heading, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...heading.childNodes);
      if (button.textContent === "") return;
      heading.append(button);
      button.addEventListener("click", () => {
        const descending = heading.getAttribute("aria-sort") === "ascending";
        headings.forEach((other) => other.removeAttribute("aria-sort"));
        heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
        sortTable(table, column, descending);
      });
    });
  }
}
