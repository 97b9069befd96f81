// Light and dark: as the reader's system has it, until the button is pressed.

const THEMES = ["light", "dark"];

/** The theme that is shown now. */
function shownTheme() {
  const chosen = document.documentElement.dataset.theme;
  if (chosen) return chosen;
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}

/** A colour of the theme that is shown, by the name of its variable. */
function colourOf(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** Make the button work; `changed` is called whenever the theme is another one. */
function startThemes(changed) {
  const button = document.getElementById("theme");
  const tell = () => {
    const other = THEMES.find((theme) => theme !== shownTheme());
    button.textContent = other === "dark" ? "Dark" : "Light";
    button.setAttribute("aria-label", `Change to ${other} colours`);
    changed();
  };
  button.hidden = false;
  button.addEventListener("click", () => {
    document.documentElement.dataset.theme = shownTheme() === "dark" ? "light" : "dark";
    tell();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", tell);
  tell();
}
