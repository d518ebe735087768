// The first screen, which also opens another problem: pictures of tasks, file, example, templates, shipped problems, shared link.
import { $, el, toast } from "./dom.js";

const LARGEST = 900000; // characters of a problem file: a message has at most 1 MB

export class Start {
  // `actions`: draw(), open(fields), fresh(template), save(), changed(): title of a problem that is not saved
  constructor(actions) {
    this.actions = actions;
    $("start-draw").addEventListener("click", () => (this.hide(), actions.draw()));
    $("start-example").addEventListener("click", () => this.pick(() => actions.open({ name: "crank-rocker" })));
    $("start-file").addEventListener("click", () => $("file").click());
    $("start-close").addEventListener("click", () => this.hide());
    $("file").addEventListener("change", () => {
      const [file] = $("file").files;
      $("file").value = "";
      if (file) {
        this.file(file);
      }
    });
    $("filter").addEventListener("input", () => this.filter($("filter").value));
    $("paste").addEventListener("submit", (event) => {
      event.preventDefault();
      const text = $("pasted").value.trim();
      this.pick(() => actions.open({ fragment: text.slice(text.indexOf("#") + 1) }));
      $("pasted").value = "";
    });
    $("start").addEventListener("keydown", (event) => event.key === "Escape" && this.closable && this.hide());
  }

  take({ problems, templates }) {
    const pictured = [...document.querySelectorAll(".way[data-template]")];
    const others = templates.filter(({ name }) => !pictured.some((one) => one.dataset.template === name));
    $("templates").replaceChildren(...others.map(({ name, title }) => el("button", { "data-template": name, text: title })));
    for (const one of [...pictured, ...$("templates").children]) {
      one.onclick = () => this.pick(() => this.actions.fresh(one.dataset.template));
    }
    $("problems").replaceChildren(
      ...problems.map(({ name, title, kind }) =>
        el("button", { "data-problem": name, onclick: () => this.pick(() => this.actions.open({ name })) }, el("b", { text: title }), el("small", { text: kind || name }))
      )
    );
  }

  filter(text) {
    const words = text.toLowerCase().split(/\s+/).filter(Boolean);
    for (const node of $("problems").children) {
      const content = `${node.dataset.problem} ${node.textContent}`.toLowerCase();
      node.hidden = !words.every((word) => content.includes(word));
    }
  }

  pick(open) {
    this.unless(() => {
      this.hide();
      open();
    });
  }

  // Opens another problem, after a question if that discards changes.
  unless(open) {
    const changed = this.actions.changed();
    if (!changed) {
      open();
      return;
    }
    const dialog = $("unsaved");
    $("unsaved-name").textContent = changed;
    dialog.returnValue = "";
    const answered = () => {
      if (dialog.returnValue === "save") {
        this.actions.save();
      }
      if (dialog.returnValue) {
        open();
      }
    };
    dialog.addEventListener("close", answered, { once: true });
    dialog.showModal();
  }

  show(closable) {
    this.closable = closable;
    $("start-close").hidden = !closable;
    $("start").hidden = false;
    $("main").inert = true;
    $("start").querySelector("button:not([hidden])").focus({ preventScroll: true });
  }

  hide() {
    const focused = $("start").contains(document.activeElement);
    $("start").hidden = true;
    $("main").inert = false;
    if (focused) {
      $("stage").focus({ preventScroll: true });
    }
  }

  get open() {
    return !$("start").hidden;
  }

  async file(file) {
    try {
      const text = new TextDecoder("utf-8", { fatal: true }).decode(await file.arrayBuffer());
      if (text.length > LARGEST) {
        toast(`${file.name} is too large for a problem file (at most 900 kB).`, true);
      } else {
        this.pick(() => this.actions.open({ text, title: file.name }));
      }
    } catch (error) {
      toast(error instanceof TypeError ? `${file.name} is not UTF-8 text. Save the file as UTF-8.` : `${file.name} cannot be read: ${error.message}`, true);
    }
  }
}
