// The full search: progress above the canvas, the button that starts and stops it, what it found; and the first hint.
import { $, hint, setText, toast } from "./dom.js";
import { onCanvas } from "./handles.js";

const LONG = 500; // after which a search is shown [ms]
const READ = 10000; // for which the first hint is shown [ms]
const BETTER = 1e-6; // share by which an objective is better
const root = document.documentElement;

export class Search {
  // `actions`: send(type) -> id, objective()
  constructor(actions) {
    this.actions = actions;
    this.running = false;
    $("search").addEventListener("click", () => {
      if (this.running) {
        this.stopping = true;
        actions.send("stop");
      } else {
        this.value = actions.objective();
        this.asked = actions.send("search");
      }
    });
  }

  state({ id, searching, status, objective }) {
    this.take(searching ? 0 : null, "searching");
    this.stopping &&= Boolean(searching);
    if (this.asked === id && !searching) {
      this.asked = null;
      if (status === "verified" && Number.isFinite(this.value) && Number.isFinite(objective?.value)) {
        const better = this.value - objective.value > BETTER * Math.abs(this.value);
        toast(better ? "The search found a better design." : "The search found no better design.");
      }
    }
  }

  // `fraction` is null, or 1, when no search runs.
  take(fraction, text) {
    this.running = fraction !== null && fraction < 1;
    root.toggleAttribute("data-searching", this.running);
    clearTimeout(this.timer);
    if (this.stopping && text === "stopped") {
      this.stopping = false; // the last state says that the search runs
      setText($("conclusion"), `${$("canvas").dataset.status === "verified" ? "Validated; the" : "The"} search for a better design was stopped.`);
    }
    if (this.running) {
      this.begun ??= performance.now();
      this.timer = setTimeout(() => this.show(fraction, text), Math.max(0, this.begun + LONG - performance.now()));
      return;
    }
    if (root.hasAttribute("data-long")) {
      hint(null);
    }
    root.removeAttribute("data-long");
    setText($("search"), "Search");
    this.begun = null;
  }

  show(fraction, text) {
    root.setAttribute("data-long", "");
    setText($("search"), "Stop");
    $("progress").style.setProperty("--share", fraction);
    $("progress").toggleAttribute("data-begun", fraction > 0);
    const aim = $("canvas").hasAttribute("data-draft") ? "Searching for the best design …" : "Searching for a better design …";
    hint(`${text === "searching" ? aim : text}${fraction > 0 ? ` ${Math.round(100 * fraction)} %` : ""}`);
  }
}

// What a new user does first: shown once, until a handle is taken.
export const guide = {
  known: false,
  show(handles, kind) {
    if (!this.known && onCanvas(handles).length) {
      this.known = true;
      hint(`Drag a ring, and the ${kind === "analysis" ? "analysis" : "optimum"} follows`);
      this.timer = setTimeout(() => this.done(), READ);
    }
  },
  done() {
    this.known = true;
    if (this.timer) {
      clearTimeout(this.timer);
      this.timer = null;
      hint(null);
    }
  },
};
