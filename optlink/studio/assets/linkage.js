// Draws a scene: ground, traces, bodies in motion, joints, targets. Bodies live in millimetres, joints and targets in pixels.
import { colour, keyed, svg } from "./dom.js";

const LAYERS = ["slot", "profile", "auxiliary", "plate", "bar", "block", "crank"];
const RAD = Math.PI / 180;
const SIDES = [45, 135, 90, -45, -135, -90, 0, 180]; // of a joint on which its name can stand, best first [deg]
const CLEAR = 40; // between a name and a link [deg]
const ON = 14; // distance from a point at which the pointer is on it [px]
const BESIDE = 36; // distance of joints whose names could be confused [px]
const POINT = 1 / 8; // line width of one point, as a share of the height of a ground pivot

export function pathOf(line, closed = false) {
  let text = "";
  let pen = "M";
  for (const at of line) {
    if (at && at[0] !== null && at[1] !== null) {
      text += `${pen}${at[0]} ${at[1]}`;
      pen = "L";
    } else {
      pen = "M";
    }
  }
  return text + (closed && text ? "Z" : "");
}

const put = (node, name, value) => {
  if (node.getAttribute(name) !== value) {
    node.setAttribute(name, value);
  }
};

export class Linkage {
  constructor(canvas, view) {
    this.view = view;
    this.canvas = canvas;
    this.world = svg("g", { id: "world" });
    this.layers = {};
    for (const name of ["below", "regions", "ground", "traces", "curve", ...LAYERS, "springs", "made"]) {
      this.world.append((this.layers[name] = svg("g", { class: `layer ${name}` })));
    }
    this.world.insertBefore(this.layers.springs, this.layers.bar);
    this.marks = svg("g", { class: "targets", "aria-hidden": "true" });
    this.regions = svg("g", { class: "names", "aria-hidden": "true" });
    this.joints = svg("g", { class: "joints", "aria-hidden": "true" });
    this.names = svg("g", { class: "names", "aria-hidden": "true" });
    canvas.append(this.world, this.regions, this.joints, this.marks, this.names);
    this.scene = null;
    this.at = 0; // position, fraction of the positions allowed
    this.bodies = new Map();
    this.radii = new Map(); // of pins, by joint [mm]
  }

  // A new scene: outlines that were left out are those of the last one.
  take(scene, targets) {
    const old = this.scene;
    for (const body of scene.bodies || []) {
      body.parts ??= old?.bodies?.find((one) => one.name === body.name)?.parts ?? [];
    }
    this.scene = { ...old, ...scene };
    this.targets = targets || {};
    this.unit = null;
    this.made(null); // until the parts of this scene come
    this.build();
    this.place();
  }

  // Parts with their layers in place of lines, the lowest first, and a pin above its uppermost part; null for lines.
  made(parts) {
    if (!parts && !this.layers.made.firstChild) {
      return;
    }
    const frame = { name: "frame", poses: [[0, 0, 0]] };
    const level = ({ layer }) => layer ?? 0;
    const shapes = [...(parts?.parts || []), ...(parts?.pins || []).map((pin, k) => ({ ...pin, pin: k, name: pin.on }))].sort((a, b) => level(a) - level(b) || ("pin" in a) - ("pin" in b));
    for (const key of [...this.bodies.keys()].filter((one) => one.startsWith("made "))) {
      this.bodies.delete(key);
    }
    this.canvas.classList.toggle("made", shapes.length > 0);
    this.canvas.classList.toggle("unstacked", Boolean(parts?.refused));
    this.layers.made.replaceChildren();
    this.radii = new Map((parts?.pins || []).map(({ joint, diameter }) => [joint, diameter / 2]));
    for (const { name, path, pin, at, diameter, layer } of shapes) {
      const body = name === frame.name ? frame : this.scene?.bodies.find((one) => one.name === name);
      if (body) {
        const words = `${name}${layer === null ? "" : `, layer ${layer}`}`;
        const shape = path ? svg("path", { d: path, transform: "scale(1 -1)" }) : svg("circle", { cx: at[0], cy: at[1], r: diameter / 2 });
        const node = svg("g", path ? { "data-part": name } : { class: "pinned" }, shape, ...(path ? [svg("title", { text: words })] : []));
        node.style.setProperty("--own", body === frame ? "var(--c444444, #444444)" : colour(body.colour));
        this.layers.made.append(node);
        this.bodies.set(`made ${path ? name : `pin ${pin}`}`, [node, body]);
      }
    }
    this.pose();
  }

  clear() {
    this.made(null);
    this.scene = null;
    this.bodies.clear();
    for (const layer of [...Object.values(this.layers).slice(1), this.regions, this.joints, this.names, this.marks]) {
      keyed(layer, [], () => "", null, null);
    }
  }

  get last() {
    return this.scene ? this.scene.drive.values.length - 1 : 0;
  }

  get period() {
    return Math.max(this.last, 1);
  }

  build() {
    const scene = this.scene;
    keyed(
      this.layers.ground,
      scene.ground || [],
      (_, k) => k,
      () => svg("path", {}),
      (node, { line, width, filled }) => {
        put(node, "d", pathOf(line));
        put(node, "class", filled ? "filled" : "open");
        node.style.setProperty("--w", width);
      }
    );
    const regions = scene.regions || [];
    keyed(
      this.layers.regions,
      regions.flatMap((region) => region.lines.map((line) => ({ ...line, violated: region.violated }))),
      (_, k) => k,
      () => svg("path", {}),
      (node, { line, width, dashed, violated }) => {
        put(node, "d", pathOf(line));
        put(node, "class", `${dashed ? "dashed" : ""} ${violated ? "violated" : ""}`.trim());
        node.style.setProperty("--w", width);
      }
    );
    keyed(
      this.regions,
      regions.filter((region) => region.at[0] !== null),
      (region) => region.name,
      (region) => svg("text", { text: region.name, "text-anchor": "middle" }),
      (node, region) => put(node, "class", region.violated ? "violated" : "")
    );
    const free = new Set(scene.free || []);
    const colours = new Map(scene.bodies.map((body) => [body.name, body.colour]));
    const owner = scene.owner || {};
    keyed(
      this.layers.traces,
      scene.free || [],
      (name) => name,
      (name) => svg("path", { "data-trace": name }),
      (node, name) => {
        put(node, "d", pathOf(scene.points[name]));
        node.style.stroke = colour(colours.get(owner[name]) || scene.bodies.at(-1)?.colour);
      }
    );
    const curve = this.targets.poses?.length ? null : this.targets.curve;
    keyed(
      this.layers.curve,
      curve?.length ? [curve] : [],
      () => "curve",
      () => svg("path", {}),
      (node, line) => put(node, "d", pathOf(line))
    );
    this.bodies.clear();
    for (const layer of LAYERS) {
      keyed(
        this.layers[layer],
        scene.bodies.filter((body) => body.parts.some((part) => part.kind === layer)),
        (body) => body.name,
        (body) => svg("g", { "data-body": body.name }, svg("title", { text: body.name })),
        (node, body) => {
          const parts = body.parts.filter((part) => part.kind === layer);
          while (node.children.length - 1 > parts.length) {
            node.lastChild.remove();
          }
          while (node.children.length - 1 < parts.length) {
            node.append(svg("path", {}));
          }
          parts.forEach((part, n) => {
            const path = node.children[n + 1];
            put(path, "d", pathOf(part.outline, part.closed));
            put(path, "class", part.kind);
            path.style.setProperty("--w", part.width);
            path.style.setProperty("--own", colour(body.colour));
          });
          this.bodies.set(`${layer} ${body.name}`, [node, body]);
        }
      );
    }
    keyed(
      this.layers.springs,
      Object.keys(scene.springs || {}),
      (name) => name,
      () => svg("path", {}),
      () => {}
    );
    const pins = new Set(scene.pins || []);
    const shown = Object.keys(scene.points || {}).filter((name) => pins.has(name) || free.has(name));
    keyed(
      this.joints,
      shown,
      (name) => name,
      (name) => svg("circle", { "data-point": name }),
      (node, name) => {
        put(node, "class", pins.has(name) ? "pin" : "dot");
        put(node, "r", pins.has(name) ? "4" : "3.6");
        if (!pins.has(name)) {
          node.style.fill = colour(colours.get(owner[name]) || scene.bodies.at(-1)?.colour);
        }
      }
    );
    keyed(
      this.names,
      shown,
      (name) => name,
      (name) => svg("text", { text: scene.captions?.[name] ?? name, "text-anchor": "middle" }),
      () => {} // its side follows the motion
    );
    const { points = [], poses = [] } = this.targets;
    keyed(
      this.marks,
      [...points.map((one) => ({ kind: "point", ...one })), ...poses.map((one) => ({ kind: "pose", ...one }))],
      (one, k) => one.kind + k,
      (one) => (one.kind === "point" ? svg("circle", { class: "point", r: 3.4 }) : svg("path", { class: "pose", d: "M0 -26V0H34M-4 0H0V4" })),
      () => {}
    );
  }

  // Directions in which links leave a joint at a position, and those of the ground below a pivot [deg].
  directions(name, position) {
    const { bodies, points } = this.scene;
    const path = points[name];
    const joint = path.length > position ? path[position] : path[0]; // of a pivot one place is enough
    const found = path.every((at) => at && Math.hypot(at[0] - joint[0], at[1] - joint[1]) < 1e-6) ? [-60, -90, -120] : [];
    for (const { parts, poses } of joint ? bodies : []) {
      if (!poses[position] || poses[position][0] === null) {
        continue;
      }
      const [x, y, turn] = poses[position];
      const [c, s] = [Math.cos(turn * RAD), Math.sin(turn * RAD)];
      for (const { outline, closed } of parts) {
        const line = outline.map(([u, v]) => [x + c * u - s * v - joint[0], y + s * u + c * v - joint[1]]);
        const size = Math.max(...line.map((at) => Math.hypot(...at)));
        line.forEach((at, k) => {
          for (const next of [line[k - 1] ?? (closed ? line.at(-1) : null), line[k + 1] ?? (closed ? line[0] : null)]) {
            if (next && Math.hypot(...at) < 1e-3 * size && Math.hypot(...next) > 1e-3 * size) {
              found.push(Math.atan2(next[1], next[0]) / RAD);
            }
          }
        });
      }
    }
    return found;
  }

  // Everything that depends on the view, and the position of the motion.
  place() {
    const { view, scene } = this;
    put(this.world, "transform", `matrix(${view.scale} 0 0 ${-view.scale} ${view.x} ${view.y})`);
    if (!scene) {
      return;
    }
    const wide = Math.min(Math.max((scene.size || 20) * POINT * view.scale, 0.55), 1.9);
    if (this.unit !== wide) {
      this.unit = wide;
      this.world.style.setProperty("--u", `${wide}px`);
    }
    (scene.regions || [])
      .filter((region) => region.at[0] !== null)
      .forEach((region, k) => {
        const [x, y] = view.px(...region.at);
        put(this.regions.children[k], "transform", `translate(${x.toFixed(2)} ${(y + 4).toFixed(2)})`);
      });
    const { points = [], poses = [] } = this.targets;
    [...points, ...poses].forEach((one, k) => {
      const [x, y] = view.px(...one.at);
      const turn = one.angle === undefined ? "" : ` rotate(${-one.angle})`;
      put(this.marks.children[k], "transform", `translate(${x.toFixed(2)} ${y.toFixed(2)})${turn}`);
    });
    this.pose();
  }

  show(at) {
    this.at = at;
    if (this.scene) {
      this.pose();
    }
  }

  // Index below, index above and share between them of the present position.
  between() {
    const at = Math.min(Math.max(this.at, 0), this.last);
    const low = Math.min(Math.floor(at), Math.max(this.last - 1, 0));
    return [low, Math.min(low + 1, this.last), at - low];
  }

  mixed(a, b, share) {
    if (!a || !b || a[0] === null || b[0] === null) {
      return share < 0.5 ? a : b;
    }
    return [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
  }

  // place of a named point at the present position [mm], or null
  point(name) {
    const [low, high, share] = this.between();
    const path = this.scene?.points?.[name];
    const at = path && this.mixed(path[low], path[high], share);
    return at && at[0] !== null ? at : null;
  }

  // Name of the point that the pointer is on, or of the body.
  named(event) {
    const [x, y] = this.view.of(event);
    const away = (at) => at && Math.hypot(at[0] - x, at[1] - y) * this.view.scale < ON;
    const point = Object.keys(this.scene?.points || {}).find((name) => away(this.point(name)));
    return point ?? event.target.closest?.("[data-body]")?.dataset.body;
  }

  // Position of the motion at which a moving point is at a place [mm]; null if there is none.
  position([x, y]) {
    const { scene } = this;
    const near = 0.004 * Math.hypot(scene.box[2] - scene.box[0], scene.box[3] - scene.box[1]);
    let found = null;
    let least = near;
    for (const path of Object.values(scene.points || {})) {
      const [first] = path;
      if (path.every((at) => at && first && Math.hypot(at[0] - first[0], at[1] - first[1]) < near)) {
        continue; // a point of the frame
      }
      for (let k = 0; k + 1 < path.length; k += 1) {
        const [a, b] = [path[k], path[k + 1]];
        if (!a || !b || a[0] === null || b[0] === null) {
          continue;
        }
        const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        const share = Math.min(Math.max(((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy || 1), 0), 1);
        const away = Math.hypot(a[0] + share * dx - x, a[1] + share * dy - y);
        if (away < least - 1e-9) {
          [least, found] = [away, k + share];
        }
      }
    }
    return found;
  }

  pose() {
    const { scene, view } = this;
    if (!scene) {
      return;
    }
    const [low, high, share] = this.between();
    for (const [node, body] of this.bodies.values()) {
      const [before, after] = [body.poses[low] ?? body.poses[0], body.poses[high] ?? body.poses[0]];
      const at = this.mixed(before, after, share);
      if (!at || at[0] === null) {
        node.setAttribute("visibility", "hidden");
        continue;
      }
      const [a, b] = [before[2], after[2]];
      const turn = a + share * (((((b - a) % 360) + 540) % 360) - 180);
      node.setAttribute("transform", `translate(${at[0]} ${at[1]}) rotate(${turn})`);
      node.setAttribute("visibility", "inherit");
    }
    for (const node of this.layers.springs.children) {
      const name = Object.keys(scene.springs)[[...this.layers.springs.children].indexOf(node)];
      const ends = scene.springs[name];
      const line = this.mixed(ends[low].slice(0, 2), ends[high].slice(0, 2), share);
      const tail = this.mixed(ends[low].slice(2), ends[high].slice(2), share);
      node.setAttribute("d", stretched(scene.zigzag, line, tail));
    }
    const names = [...this.names.children];
    const places = [...this.joints.children].map((node) => this.point(node.dataset.point)).map((at) => at && view.px(...at));
    [...this.joints.children].forEach((node, k) => {
      const at = places[k];
      node.setAttribute("visibility", at ? "inherit" : "hidden");
      names[k].setAttribute("visibility", at ? "inherit" : "hidden");
      if (at) {
        const [x, y] = at;
        node.setAttribute("transform", `translate(${x.toFixed(2)} ${y.toFixed(2)})`);
        const beside = places.filter((other) => other && other !== at && Math.hypot(other[0] - x, other[1] - y) < BESIDE);
        const taken = beside.filter((other) => Math.hypot(other[0] - x, other[1] - y) > 1).map((other) => Math.atan2(y - other[1], other[0] - x) / RAD);
        const joints = taken.flatMap((way) => [way - CLEAR / 2, way + CLEAR / 2]); // a name there would seem to be theirs
        names[k].side = side(names[k].side, [...this.directions(node.dataset.point, low), ...joints]);
        const turn = names[k].side * RAD;
        const pin = (this.radii.get(node.dataset.point) || 0) * view.scale;
        const [dx, dy] = [(9.5 + pin + 3.6 * names[k].textContent.length) * Math.cos(turn), 4 - (18 + pin) * Math.sin(turn)];
        names[k].setAttribute("transform", `translate(${(x + dx).toFixed(2)} ${(y + dy).toFixed(2)})`);
      }
    });
  }
}

// The side of a joint for its name, chosen here because each drag and zoom moves it against letters of fixed size: that before, if it is clear of the links, else the first clear or the clearest one.
function side(before, directions) {
  const room = (turn) => Math.min(180, ...directions.map((way) => Math.abs(((((turn - way) % 360) + 540) % 360) - 180)));
  const clear = (turn) => turn !== undefined && room(turn) >= CLEAR;
  return clear(before) ? before : (SIDES.find(clear) ?? SIDES.reduce((best, turn) => (room(turn) > room(best) ? turn : best)));
}

// A line given in shares of the length of a spring and offsets, between both ends of the spring.
function stretched(line, [x, y], [u, v]) {
  const [dx, dy] = [u - x, v - y];
  const length = Math.max(Math.hypot(dx, dy), 1e-30);
  return pathOf(line.map(([share, side]) => [x + share * dx - (side * dy) / length, y + share * dy + (side * dx) / length]));
}
