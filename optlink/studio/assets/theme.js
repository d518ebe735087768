// Light and dark: the choice of the system, or of the button, which is remembered as that of the report page.
import { $ } from "./dom.js";

const root = document.documentElement;
const system = matchMedia("(prefers-color-scheme: dark)");
function remembered(value) {
  try {
    return value ? localStorage.setItem("optlink-theme", value) : localStorage.getItem("optlink-theme");
  } catch {
    return null; // no storage for this page
  }
}
function paint() {
  const dark = (remembered() || root.dataset.prefer || (system.matches ? "dark" : "light")) === "dark";
  root.dataset.theme = dark ? "dark" : "light";
  $("theme").setAttribute("aria-label", `Use ${dark ? "light" : "dark"} colours`);
}
$("theme").addEventListener("click", () => {
  remembered(root.dataset.theme === "dark" ? "light" : "dark");
  paint();
});
system.addEventListener("change", paint);
paint();
