// The region of the pivots: a box that is drawn on the canvas; a side that is open lies outside the view.
import { svg } from "./dom.js";

const LEAST = 8; // sides of a box [px]

export class Region {
  // `send(box)`: left, lower, right, upper side [mm]
  constructor(overlay, view, send) {
    Object.assign(this, { view, send, sides: null, begun: null });
    this.node = overlay.appendChild(svg("rect", { id: "region" }));
  }

  take(sides) {
    this.sides = sides;
    this.begun = null;
    this.draw();
  }

  begin(event) {
    this.begun = this.at = this.view.of(event);
  }

  move(event) {
    this.at = this.view.of(event);
    this.draw();
  }

  // Whether a box has been drawn.
  end() {
    const [[x, y], [u, v]] = [this.begun, this.at];
    const drawn = Math.min(Math.abs(u - x), Math.abs(v - y)) * this.view.scale >= LEAST;
    this.begun = null;
    if (drawn) {
      this.sides = [Math.min(x, u), Math.min(y, v), Math.max(x, u), Math.max(y, v)].map((one) => Number(one.toPrecision(4)));
      this.send(this.sides);
    }
    this.draw();
    return drawn;
  }

  draw() {
    const sides = this.begun ? [...this.begun, ...this.at] : this.sides || [];
    this.node.style.display = sides.some((one) => one !== null) ? "" : "none";
    const far = [this.view.mm(-9, this.view.height + 9), this.view.mm(this.view.width + 9, -9)].flat();
    const [a, b] = [0, 2].map((k) => this.view.px(sides[k] ?? far[k], sides[k + 1] ?? far[k + 1]));
    const box = { x: Math.min(a[0], b[0]), y: Math.min(a[1], b[1]), width: Math.abs(a[0] - b[0]), height: Math.abs(a[1] - b[1]) };
    Object.entries(box).forEach(([name, value]) => this.node.setAttribute(name, value.toFixed(1)));
  }
}
