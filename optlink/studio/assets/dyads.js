// Dyads of four poses: the curves of their pivots (solid) and of their points on the body (dashed); two that are picked are a four-bar.
import { svg } from "./dom.js";
import { pathOf } from "./linkage.js";

const REACH = 14; // distance from a curve at which a dyad is picked [px]
const FIRST = "Pick the driver on a blue part: its pivot (solid) or its point on the body at pose 1 (dashed).";
const SECOND = "Pick its partner on a green part: each is a four-bar that passes all poses within your bounds.";
const NONE = "This driver has no partner within your bounds and limits. Pick another driver.";
const NO_DRIVER = "No two of these dyads are a four-bar that passes all poses within your bounds and limits. Widen them, or list the exact solutions (X), which name the bounds.";

export class Dyads {
  // `actions`: ask(fields) of the server, hint(text)
  constructor(overlay, view, actions) {
    Object.assign(this, { view, actions, curves: null, wanted: false });
    this.node = svg("g", { id: "dyads" });
    const line = (look) => this.node.appendChild(svg("path", { class: look }));
    this.lines = ["all", "drives", "usable"].flatMap((part) => ["pivots", "points"].map((kind) => [part, kind, line(`${part} ${kind === "points" ? "on-body" : ""}`)]));
    this.picked = line("driver");
    this.under = line("under");
    overlay.append(this.node);
  }

  open(wanted) {
    if (wanted !== this.wanted) {
      Object.assign(this, { wanted, curves: null, usable: null, driver: null, at: null });
      if (wanted) {
        this.actions.ask({});
      }
    }
    this.draw();
  }

  take({ points, pivots, drives, driver, usable }) {
    if (this.wanted && points) {
      this.curves = { points, pivots, drives };
      this.actions.hint(drives.includes(true) ? FIRST : NO_DRIVER);
    } else if (this.wanted && this.curves) {
      Object.assign(this, { driver, usable });
      this.actions.hint(usable.includes(true) ? SECOND : NONE);
    }
    this.draw();
  }

  // Dyads that may be picked: drivers, or partners of the driver.
  get pickable() {
    return this.usable?.includes(true) ? this.usable : this.curves?.drives;
  }

  // Number of the dyad whose pivot or point lies under the pointer; null if there is none.
  near(event) {
    const [x, y] = this.view.of(event);
    let [found, least] = [null, REACH / this.view.scale];
    this.pickable?.forEach((fits, k) => {
      for (const at of fits ? [this.curves.pivots[k], this.curves.points[k]] : []) {
        const distance = at ? Math.hypot(at[0] - x, at[1] - y) : Infinity;
        if (distance < least) {
          [found, least] = [k, distance];
        }
      }
    });
    return found;
  }

  move(event) {
    this.at = this.near(event);
    this.draw();
  }

  pick(event) {
    const k = this.near(event);
    if (k === null) {
      return;
    }
    this.actions.ask(this.usable?.includes(true) ? { driver: this.driver, follower: k } : { driver: k });
  }

  draw() {
    const shown = { all: this.curves?.drives.map(() => true), drives: this.curves?.drives, usable: this.usable };
    const px = (at) => at && this.view.px(...at);
    for (const [part, kind, path] of this.lines) {
      path.setAttribute("d", shown[part] && this.curves ? pathOf(this.curves[kind].map((at, k) => (shown[part][k] ? px(at) : null))) : "");
    }
    for (const [k, path] of [[this.driver, this.picked], [this.at, this.under]]) {
      const ends = this.curves && k !== null && k !== undefined ? [this.curves.pivots[k], this.curves.points[k]] : [];
      path.setAttribute("d", pathOf(ends.map(px)));
    }
    this.under.classList.toggle("second", Boolean(this.usable));
  }
}
