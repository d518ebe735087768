// Menus, keys, and files that are dropped on the page.
import { $, el, icon } from "./dom.js";

const root = document.documentElement;

// A menu below a button; returns a function that opens and closes it.
export function dropDown(button, menu) {
  const set = (open) => {
    menu.hidden = !open;
    button.setAttribute("aria-expanded", String(open));
  };
  button.addEventListener("click", () => set(menu.hidden));
  button.addEventListener("keydown", (event) => {
    if (event.key === "ArrowDown") {
      event.preventDefault();
      set(true);
      menu.firstElementChild.focus();
    } else if (event.key === "Escape" && !menu.hidden) {
      set(false);
    }
  });
  menu.addEventListener("keydown", (event) => {
    const items = [...menu.children];
    const way = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (way) {
      event.preventDefault();
      items.at((items.indexOf(document.activeElement) + way) % items.length).focus();
    } else if (event.key === "Escape") {
      set(false);
      button.focus();
    }
  });
  document.addEventListener("pointerdown", (event) => {
    if (!menu.hidden && !menu.contains(event.target) && event.target !== button) {
      set(false);
    }
  });
  return set;
}

$("menu").addEventListener("click", () => {
  const open = root.toggleAttribute("data-menu");
  $("menu").setAttribute("aria-expanded", String(open));
  $("menu").replaceChildren(icon(open ? "close" : "menu"));
});
$("commands").addEventListener("click", (event) => {
  if (event.target.closest("button") && !event.target.closest("#export")) {
    root.removeAttribute("data-menu");
    $("menu").setAttribute("aria-expanded", "false");
    $("menu").replaceChildren(icon("menu"));
  }
});

// --- keys --------------------------------------------------------------------------------------------------------------

const KEYS = [
  ["Tab", "next handle or control"],
  ["Arrow keys", "move the handle that has the focus; with Shift a tenth of it"],
  ["Space", "play or pause the motion"],
  ["Ctrl+Z, Ctrl+Shift+Z", "undo, redo"],
  ["Ctrl+S, Ctrl+O", "save, open"],
  ["+, −, 0", "zoom in, out, fit"],
  ["V, D, P, X, R, B", "select, draw a curve, pick from curves, list exact solutions, region of the pivots, background"],
  ["L", "links as parts with their layers, or as lines"],
  ["Esc", "give up a drag, close"],
  ["Double-click", "rename a joint or a link"],
  ["Wheel, two fingers", "zoom; drag the empty canvas to pan"],
];
$("keys-text").append(
  el("dl", {}, ...KEYS.flatMap(([key, text]) => [el("dt", { text: key }), el("dd", { text })])),
  el("p", { text: "A circle is a handle: with a dot it is a fixed dimension, with two arrows it moves along a line, on an arc it is an angle. A red bar shows where feasibility ends. A dashed linkage is not verified; it is checked on release." })
);
$("help").addEventListener("click", () => $("keys").showModal());

const COMMANDS = { z: "undo", y: "redo", Z: "redo", s: "save", o: "open" };
const SINGLE = { v: "tool-select", d: "tool-draw", p: "tool-dyads", x: "tool-solutions", l: "view-parts", r: "tool-region", b: "tool-back", "+": "zoom-in", "=": "zoom-in", "-": "zoom-out", 0: "zoom-fit", "?": "help", " ": "play" };

// Keys of the page. `before()` runs before a command; `single()`: whether keys without Ctrl count; `escape()`.
export function keyboard({ before, single, escape }) {
  document.addEventListener("keydown", (event) => {
    if (event.target.closest("input[type=text], input[type=search], input[type=number]") || document.querySelector("dialog[open]")) {
      return;
    }
    const command = event.ctrlKey || event.metaKey ? COMMANDS[event.key] : null;
    if (command) {
      event.preventDefault();
      before();
      $(command).click();
    } else if (single() && !event.ctrlKey && !event.metaKey && !event.altKey && SINGLE[event.key]) {
      if (event.key !== " " || !event.target.closest("button, summary")) {
        event.preventDefault();
        $(SINGLE[event.key]).click();
      }
    } else if (event.key === "Escape") {
      escape();
    }
  });
}

// Files that are dropped on the page.
export function takeFiles(open) {
  addEventListener("dragover", (event) => {
    event.preventDefault();
    root.setAttribute("data-dropping", "");
  });
  for (const kind of ["dragleave", "drop"]) {
    addEventListener(kind, (event) => {
      if (kind === "drop" || !event.relatedTarget) {
        root.removeAttribute("data-dropping");
      }
    });
  }
  addEventListener("drop", (event) => {
    event.preventDefault();
    const [file] = event.dataTransfer.files;
    if (file) {
      open(file);
    }
  });
}
