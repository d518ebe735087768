// A curve drawn by hand, and the four-bars that were found for it.
import { $, colour, el, keyed, quantity, setText, svg } from "./dom.js";
import { pathOf } from "./linkage.js";

const CLOSE = 26; // distance of the ends up to which a curve is closed [px]
const NEAR = 3; // least distance of neighbouring points [px]
const MOST = 240; // points sent
const SHORTEST = 60; // length of a curve [px]

export class Curve {
  // `actions`: draw(points, closed) -> id, choose(candidate), preview(scene or null, whether it is valid), fit(points), hint(text or null)
  constructor(overlay, view, actions) {
    Object.assign(this, { view, actions, stroke: [], id: null, points: [] });
    this.line = svg("path", { class: "stroke" });
    this.fitted = svg("path", { class: "fitted" });
    overlay.append(this.line, this.fitted);
    $("six-bar").addEventListener("click", () => actions.choose("six-bar", () => this.close()));
    $("tray-close").addEventListener("click", () => (this.close(), actions.preview(null)));
  }

  begin(event) {
    this.close();
    this.actions.preview(null);
    this.stroke = [this.view.of(event)];
    this.draw();
  }

  move(event) {
    const at = this.view.of(event);
    const last = this.stroke.at(-1);
    if (Math.hypot(at[0] - last[0], at[1] - last[1]) * this.view.scale >= NEAR) {
      this.stroke.push(at);
      this.draw();
    }
  }

  end() {
    const points = this.stroke;
    const lengths = points.slice(1).map((at, k) => Math.hypot(at[0] - points[k][0], at[1] - points[k][1]));
    const length = lengths.reduce((sum, one) => sum + one, 0) * this.view.scale;
    if (points.length < 6 || length < SHORTEST) {
      this.stroke = [];
      this.draw();
      this.actions.hint("Draw a longer curve in one stroke; end at its start to close it.");
      return false;
    }
    const gap = Math.hypot(points[0][0] - points.at(-1)[0], points[0][1] - points.at(-1)[1]) * this.view.scale;
    this.closed = gap < Math.max(CLOSE, 0.08 * length);
    if (this.closed) {
      this.joined();
    }
    const every = Math.max(1, Math.ceil(this.stroke.length / MOST));
    this.points = this.stroke.filter((_, k) => k % every === 0);
    this.draw();
    this.id = this.actions.draw(this.points, this.closed);
    this.waiting = true;
    this.items = [];
    this.show({ items: [], done: false });
    return true;
  }

  // Spreads the gap of a closed curve over its points, so that it has no corner at the start.
  joined() {
    const [first, last] = [this.stroke[0], this.stroke.at(-1)];
    const count = this.stroke.length;
    this.stroke = this.stroke.map(([x, y], k) => [x + (first[0] - last[0]) * (k / count - 0.5), y + (first[1] - last[1]) * (k / count - 0.5)]);
  }

  draw() {
    const line = this.stroke.map((at) => this.view.px(...at));
    this.line.setAttribute("d", pathOf(line, this.closed && this.id !== null));
    this.fitted.setAttribute("d", this.shown ? pathOf(this.shown.curve.map((at) => at && this.view.px(...at))) : "");
  }

  candidates(message) {
    if (message.id === this.id) {
      this.waiting = !message.done;
      this.show(message);
    }
  }

  show({ items, done, seconds, poor }) {
    this.items = items;
    $("six-bar").hidden = !poor;
    $("tray").hidden = false;
    const time = Number.isFinite(seconds) ? `, ${seconds.toFixed(1)} s` : "";
    const count = `${items.length} four-bar${items.length === 1 ? "" : "s"}${time}`;
    setText($("tray-title"), !items.length ? (done ? "No four-bar found for this curve" : "Searching four-bars …") : done ? count : `${count}, searching for better ones …`);
    $("tray").toggleAttribute("data-searching", !done);
    keyed(
      $("items"),
      items,
      (_, k) => k,
      (_, k) => this.item(k),
      (node, one, k) => this.fill(node, one, k)
    );
    if (!this.pointed && items[0]?.scene && JSON.stringify(items[0].design) !== this.best) {
      this.best = JSON.stringify(items[0].design); // the best one moves until another one is pointed at
      this.look(items[0]);
    }
  }

  item(k) {
    return candidate(() => ((this.pointed = true), this.look(this.items[k])), () => this.choose(k));
  }

  fill(node, one, k) {
    const button = node.firstChild;
    const [plot, error, note] = button.children;
    thumbnail(plot, one.scene, this.points, this.closed, one.curve);
    setText(error, quantity(one.error, one.unit, 3));
    setText(note, one.valid ? "valid" : "not valid");
    button.classList.toggle("bad", !one.valid);
    button.setAttribute("aria-label", `Four-bar ${k + 1}: error ${quantity(one.error, one.unit, 3)}, ${one.valid ? "valid" : "not valid"}`);
  }

  look(item) {
    this.shown = item;
    this.actions.fit([...this.points, ...corners(item.scene.box)]);
    this.draw();
    this.actions.preview(item.scene, item.valid);
  }

  choose(k) {
    this.chosen = this.items[k]; // stays drawn until its state arrives
    this.actions.choose(this.chosen?.id ?? k, () => this.close());
  }

  close() {
    this.stroke = [];
    this.id = null;
    this.closed = false;
    this.shown = this.best = null;
    this.pointed = false;
    $("tray").hidden = true;
    this.draw();
  }
}

// An entry of a list of linkages: its picture, two lines of text; `look()` when it is pointed at, `choose()` when it is clicked.
export function candidate(look, choose) {
  const plot = svg("svg", { viewBox: "0 0 100 76", "aria-hidden": "true" }, svg("path", { class: "drawn" }), svg("path", { class: "fit" }), svg("g", { class: "links" }));
  const button = el("button", { class: "candidate", onclick: choose, onpointerenter: look, onfocus: look }, plot, el("b"), el("small"));
  return el("div", { role: "listitem" }, button);
}

// Draws a linkage small, at its first position, with target points and the curve that its point draws.
export function thumbnail(plot, scene, points = [], closed = false, curve = []) {
  const links = standing(scene);
  const place = fitting([...points, ...curve.filter(Boolean), ...links.flatMap(({ line }) => line)]);
  plot.children[0].setAttribute("d", pathOf(points.map(place), closed));
  plot.children[1].setAttribute("d", pathOf(curve.map((at) => at && place(at))));
  plot.children[2].replaceChildren(
    ...links.map(({ line, closed: whole, own }) => {
      const path = svg("path", { d: pathOf(line.map(place), whole), class: whole ? "plate" : "bar" });
      path.style.setProperty("--own", colour(own));
      return path;
    })
  );
}

const corners = ([x0, y0, x1, y1]) => [
  [x0, y0],
  [x1, y1],
];

// Bars and plates of a scene at its first position.
function standing(scene) {
  return (scene?.bodies || []).flatMap(({ parts, poses, colour: own }) => {
    const [x, y, angle] = poses[0];
    const [c, s] = [Math.cos((angle * Math.PI) / 180), Math.sin((angle * Math.PI) / 180)];
    return (parts || []).map(({ closed, outline }) => ({ own, closed, line: outline.map(([u, v]) => [x + c * u - s * v, y + s * u + c * v]) }));
  });
}

// Maps millimetres to a thumbnail of 100 by 76.
function fitting(points) {
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const scale = Math.min(90 / (x1 - x0 || 1), 66 / (y1 - y0 || 1));
  return ([x, y]) => [(50 + scale * (x - (x0 + x1) / 2)).toFixed(1), (38 - scale * (y - (y0 + y1) / 2)).toFixed(1)];
}
