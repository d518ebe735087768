// Families of linkages: the curves of one end of their dyads (solid) and of the other one (dashed); a driver and its partner are a
// linkage, of some families a driver alone.
import { svg } from "./dom.js";
import { pathOf } from "./linkage.js";

const REACH = 14; // distance from a curve at which a dyad is picked [px]

export class Dyads {
  // `actions`: ask(fields) of the server, hint(text)
  constructor(overlay, view, actions) {
    Object.assign(this, { view, actions, curves: null, partners: null, driver: null, at: null, wanted: false });
    this.node = svg("g", { id: "dyads" });
    const line = (look) => this.node.appendChild(svg("path", { class: look }));
    this.lines = ["all", "drives", "usable"].flatMap((part) => ["pivots", "points"].map((kind) => [part, kind, line(`${part} ${kind === "points" ? "on-body" : ""}`)]));
    this.picked = line("driver");
    this.under = line("under");
    overlay.append(this.node);
  }

  open(wanted) {
    if (wanted !== this.wanted) {
      Object.assign(this, { wanted, curves: null, partners: null, driver: null, at: null });
      if (wanted) {
        this.actions.ask({});
      }
    }
    this.draw();
  }

  take({ points, pivots, drives, driver, usable, hint, single }) {
    if (this.wanted && drives) {
      Object.assign(this, { curves: { points, pivots, fits: drives }, single });
      this.actions.hint(hint);
    } else if (this.wanted && this.curves) {
      Object.assign(this, { driver, at: null, partners: { points, pivots, fits: usable } });
      this.actions.hint(hint);
    }
    this.draw();
  }

  // Whether a partner is to be picked next; a driver without one is followed by another driver.
  get second() {
    return Boolean(this.partners?.fits.includes(true));
  }

  // Number of the dyad whose ends lie under the pointer, of those that may be picked; null if there is none.
  near(event) {
    const [x, y] = this.view.of(event);
    const among = this.second ? this.partners : this.curves;
    let [found, least] = [null, REACH / this.view.scale];
    among?.fits.forEach((fits, k) => {
      for (const at of fits ? [among.pivots[k], among.points[k]] : []) {
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
    if (k !== null) {
      this.actions.ask(this.second ? { driver: this.driver, follower: k } : this.single ? { driver: k, follower: 0 } : { driver: k });
    }
  }

  draw() {
    const { curves, partners } = this;
    const px = (at) => at && this.view.px(...at);
    const shown = { all: curves && { ...curves, fits: null }, drives: curves, usable: partners };
    for (const [part, kind, path] of this.lines) {
      const { [kind]: line = [], fits } = shown[part] || {};
      path.setAttribute("d", pathOf(line.map((at, k) => (!fits || fits[k] ? px(at) : null))));
    }
    for (const [k, of, path] of [[this.driver, curves, this.picked], [this.at, this.second ? partners : curves, this.under]]) {
      const ends = of && k !== null ? [of.pivots[k], of.points[k]] : [];
      path.setAttribute("d", pathOf(ends.map(px)));
    }
    this.under.classList.toggle("second", this.second);
  }
}
