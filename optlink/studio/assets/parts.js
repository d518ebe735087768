// The parts of the design: their outlines in place of lines, their layers, the sizes that the file states, and files to make them.
import { $, colour, el, plain, toast } from "./dom.js";

const COLUMNS = { width: "Width", thickness: "Thickness", hole: "Hole", pin: "Pin" };

// A table with a value at a path of keys; null and what it leaves empty are left out.
function stated(table, [key, ...rest], value) {
  const inner = rest.length ? stated(table?.[key], rest, value) : value;
  const entries = Object.entries({ ...table, [key]: inner }).filter(([, one]) => one !== null);
  return entries.length ? Object.fromEntries(entries) : null;
}

export class Parts {
  // `actions`: ask() for the parts, edit(tables), section() as the file has it, file(format), at(crank angle), colour(body), drawn(parts or null)
  constructor(actions) {
    this.actions = actions;
    this.on = false;
    $("view-parts").addEventListener("click", () => this.open(!this.on));
  }

  open(on) {
    this.on = on;
    $("view-parts").setAttribute("aria-pressed", String(on));
    $("parts").hidden = true;
    this.actions.drawn(null);
    this.asked = on ? this.actions.ask() : null;
  }

  // A state of the design: its parts are asked for when it rests.
  state({ moving, searching }) {
    this.asked = this.on && !moving && !searching ? this.actions.ask() : null;
  }

  take(message) {
    if (!this.on || message.id !== this.asked) {
      return;
    }
    this.actions.drawn(message.parts ? message : null);
    const focus = document.activeElement?.id;
    const { parts = [], joints = [], usual, notes = [], refused, at } = message;
    const layered = [...parts].sort((a, b) => (b.layer ?? 0) - (a.layer ?? 0));
    const show = Number.isFinite(at) ? [" ", el("button", { class: "inline", text: "Show", onclick: () => this.actions.at(at) })] : [];
    $("parts").hidden = false;
    $("parts").replaceChildren(
      el("h2", {}, "Parts ", el("small", { text: "sizes in mm" })),
      ...(refused ? [el("p", { class: "alert" }, refused, ...show)] : []),
      ...(parts.length ? [this.table("Layer", "Link", layered, usual.parts, ({ name, layer }) => [el("td", { text: layer ?? "–" }), el("th", { scope: "row" }, this.swatch(name), name)])] : []),
      ...(joints.length ? [this.table(null, "Joint", joints, usual.joints, ({ name }) => [el("th", { scope: "row", text: name })])] : []),
      ...notes.map((text) => el("small", { class: "about", text })),
      ...(parts.length ? [this.files()] : [])
    );
    if (focus?.startsWith("part-")) {
      document.getElementById(focus)?.focus();
    }
  }

  table(first, second, rows, usual, heads) {
    const sizes = usual.map(({ key }) => key);
    const head = el("tr", {}, ...[...(first ? [first] : []), second, ...sizes.map((key) => COLUMNS[key])].map((text) => el("th", { scope: "col", text })));
    const all = el("tr", {}, ...(first ? [el("td")] : []), el("th", { scope: "row", text: "all" }), ...usual.map((one) => el("td", {}, this.field("all", one))));
    const lines = rows.map((row) => {
      const line = el("tr", {}, ...heads(row), ...row.fields.map((one) => el("td", {}, this.field(row.name, one))));
      const look = (on) => document.querySelector(`[data-part="${row.name}"]`)?.classList.toggle("chosen", on);
      for (const [event, on] of [["pointerenter", true], ["focusin", true], ["pointerleave", false], ["focusout", false]]) {
        line.addEventListener(event, () => look(on));
      }
      return line;
    });
    return el("table", {}, el("thead", {}, head), el("tbody", {}, all, ...lines));
  }

  swatch(name) {
    const mark = el("i", { class: "swatch" });
    mark.style.background = colour(this.actions.colour(name));
    return mark;
  }

  // A size: as the file states it, else faint as it follows from the others. An empty field leaves it to them.
  field(name, { key, value, stated: own }) {
    const shown = own === null ? "" : Number.isFinite(value) ? plain(value) : String(own).replace(/ ?mm$/, "");
    const usual = own === null && value !== null ? plain(value) : "usual";
    const node = el("input", { type: "text", id: `part-${key}`, inputmode: "decimal", spellcheck: "false", autocomplete: "off", placeholder: usual, "aria-label": `${COLUMNS[key.split(".").at(-1)]} of ${name}` });
    node.value = shown;
    node.addEventListener("change", () => {
      const text = node.value.trim().replace("−", "-");
      const stating = text ? (/^[-+.\deE]+$/.test(text) ? `${text} mm` : text) : null;
      this.actions.edit({ parts: stated(this.actions.section(), key.split("."), stating) });
    });
    node.addEventListener("keydown", (event) => event.key === "Escape" && ((node.value = shown), node.blur()));
    return node;
  }

  files() {
    const kinds = [...$("formats").children].filter(({ dataset }) => dataset.made !== undefined);
    return el("p", { class: "files" }, ...kinds.map((one) => el("button", { text: one.dataset.made, "aria-label": one.firstChild.textContent.trim(), title: one.textContent, onclick: () => this.actions.file(one.dataset.format) })));
  }
}
