// Handles: what can be dragged on the canvas, by mouse, touch and keyboard.
import { keyed, number, quantity, svg } from "./dom.js";
import { round125 } from "./view.js";

const REST = 450; // pause after the last key before a change by keyboard is released [ms]
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const MANY = 12; // handles above which they are drawn smaller
const SHORTEST = 46; // radius of an angle's arc [px]
const RAD = Math.PI / 180;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1];
const angleOf = ([x, y]) => Math.atan2(y, x) / RAD;
const nearer = (angle, to) => to + (((((angle - to) % 360) + 540) % 360) - 180);
const clamped = (value, handle) => Math.min(Math.max(value, handle.lower ?? -Infinity), handle.upper ?? Infinity);
const placed = (handle) => Boolean(handle.at || handle.centre);
const unit = (handle) => handle.unit || (handle.kind === "angle" ? "deg" : "mm");

export const onCanvas = (handles) => handles.filter(placed);
export const inPanel = (handles) => handles.filter((handle) => !placed(handle));

export class Handles {
  // `actions`: drag(fields, stamp), grab(handle), changed(), blocked(), away(handle): whether its joint is elsewhere at present
  constructor(canvas, view, actions) {
    Object.assign(this, { canvas, view, actions });
    this.node = svg("g", { id: "handles" });
    this.edges = svg("g", { id: "edges", "aria-hidden": "true" });
    canvas.append(this.edges, this.node);
    this.handles = [];
    this.held = null; // the knob that is dragged
    this.keys = null;
    this.infeasible = false;
    this.last = null; // name of the handle that was dragged last: red while no design is feasible
  }

  take(handles) {
    const held = this.held || this.keys;
    this.handles = onCanvas(handles).map((handle) => (held && handle.id === held.handle.id ? { ...handle, ...held.own } : handle));
    if (held) {
      held.handle = this.handles.find((handle) => handle.id === held.handle.id) || held.handle;
    }
    this.draw();
  }

  // Knobs: one of each handle, two of a range.
  get knobs() {
    return this.handles.flatMap((handle) => (handle.kind === "range" ? [0, 1] : [null]).map((part) => ({ handle, part })));
  }

  angle({ handle, part }) {
    return (handle.from || 0) + (part === null ? handle.value : handle.value[part]);
  }

  place(knob) {
    const { handle } = knob;
    if (!handle.centre) {
      return this.view.px(...handle.at);
    }
    if (handle.at && handle.kind !== "angle" && handle.kind !== "range") {
      return this.view.px(...handle.at);
    }
    const [x, y] = this.view.px(...handle.centre);
    const [radius, turn] = [this.radius(handle), this.angle(knob) * RAD];
    return [x + radius * Math.cos(turn), y - radius * Math.sin(turn)];
  }

  radius(handle) {
    return Math.max((handle.radius || 0) * this.view.scale, SHORTEST);
  }

  draw() {
    keyed(
      this.node,
      this.knobs,
      ({ handle, part }) => `${handle.id} ${part}`,
      (knob) => this.make(knob),
      (node, knob) => this.update(node, knob),
      false
    );
    this.node.classList.toggle("many", this.handles.length > MANY);
    this.boundary();
  }

  // Handles of joints that are elsewhere at the present position of the motion.
  fade() {
    for (const node of this.node.children) {
      node.classList.toggle("away", !this.held && this.actions.away(node.knob.handle));
    }
  }

  make(first) {
    const node = svg(
      "g",
      { class: "handle", tabindex: "0", role: "slider", "data-handle": first.handle.id },
      svg("path", { class: "guide" }),
      svg("g", { class: "knob" }, svg("circle", { class: "reach", r: "17" }), svg("path", { class: "ways" }), svg("circle", { class: "ring", r: "7" }), svg("circle", { class: "core", r: "2.6" })),
      svg("text", { class: "tip" })
    );
    node.addEventListener("pointerdown", (event) => this.grab(node.knob, event, node));
    node.addEventListener("keydown", (event) => this.key(node.knob, event));
    node.addEventListener("blur", () => this.release());
    return node;
  }

  update(node, knob) {
    node.knob = knob;
    const { handle, part } = knob;
    const [x, y] = this.place(knob);
    const [guide, body, tip] = node.children;
    body.setAttribute("transform", `translate(${x.toFixed(2)} ${y.toFixed(2)})`);
    const held = (this.held || this.keys)?.handle.id === handle.id;
    const red = this.infeasible && this.last === handle.id;
    const away = !held && this.actions.away(handle);
    const kind = `handle ${handle.kind}${away ? " away" : ""}${held ? " held" : ""}${red ? " red" : ""}${handle.locked ? " locked" : ""}${handle.along ? " along" : ""}`;
    if (node.getAttribute("class") !== kind) {
      node.setAttribute("class", kind);
    }
    body.children[1].setAttribute("d", handle.along ? arrows(handle.along) : "");
    guide.setAttribute("d", this.guide(knob));
    const text = this.text(knob);
    tip.setAttribute("transform", `translate(${x.toFixed(1)} ${(y - 17).toFixed(1)})`);
    const side = x > this.view.width - 130 ? "end" : x < 130 ? "start" : "middle";
    if (tip.getAttribute("text-anchor") !== side) {
      tip.setAttribute("text-anchor", side);
    }
    const shown = `${handle.label}${part === null ? "" : part ? ", upper" : ", lower"}  ${text}`;
    if (tip.textContent !== shown) {
      tip.textContent = shown;
      node.setAttribute("aria-label", handle.label + (part === null ? "" : part ? ", upper limit" : ", lower limit"));
      node.setAttribute("aria-valuetext", text);
      const value = this.plain(knob);
      node.setAttribute("aria-valuenow", String(value));
      node.setAttribute("aria-valuemin", String(handle.lower ?? Math.min(value, -1e6)));
      node.setAttribute("aria-valuemax", String(handle.upper ?? Math.max(value, 1e6)));
    }
  }

  plain({ handle, part }) {
    if (part !== null) {
      return handle.value[part];
    }
    return typeof handle.value === "number" ? handle.value : handle.at[0];
  }

  text({ handle, part }) {
    if (part !== null || handle.kind !== "point" || typeof handle.value === "number") {
      return quantity(this.plain({ handle, part }), unit(handle), 4);
    }
    return `${number(handle.at[0], 4)}, ${number(handle.at[1], 4)} mm`;
  }

  guide(knob) {
    const { handle, part } = knob;
    if (!handle.centre || part === 1) {
      return "";
    }
    const [x, y] = this.view.px(...handle.centre);
    if (handle.at && handle.kind !== "angle" && handle.kind !== "range") {
      const [u, v] = this.view.px(...handle.at);
      return `M${x} ${y}L${u} ${v}`;
    }
    const base = handle.from || 0;
    const [first, last] = handle.kind === "range" ? handle.value.map((value) => base + value) : [base, base + handle.value];
    const radius = this.radius(handle);
    const end = (turn) => `${x + radius * Math.cos(turn * RAD)} ${y - radius * Math.sin(turn * RAD)}`;
    const large = Math.abs(last - first) % 360 > 180 ? 1 : 0;
    return `M${x} ${y}L${end(first)}A${radius} ${radius} 0 ${large} ${last > first ? 0 : 1} ${end(last)}L${x} ${y}`;
  }

  // Where feasibility ends: red bars across the way of a handle.
  boundary() {
    const bars = [];
    for (const handle of this.handles) {
      const value = typeof handle.value === "number" ? handle.value : 0;
      const [low, high] = handle.feasible || [];
      const crossed = value < low ? [low] : value > high ? [high] : []; // the end that an infeasible value has crossed
      for (const edge of crossed) {
        if (handle.centre && (handle.kind === "angle" || !handle.along)) {
          const turn = ((handle.from || 0) + edge) * RAD;
          if (handle.kind === "angle") {
            bars.push({ at: handle.centre, off: this.radius(handle), way: [Math.cos(turn), Math.sin(turn)], radial: true });
          }
        } else if (handle.along && handle.at) {
          const at = [0, 1].map((k) => handle.at[k] + handle.along[k] * (edge - value));
          bars.push({ at, way: handle.along });
        }
      }
      if (handle.boundary) {
        const way = [0, 1].map((k) => (handle.at || handle.centre)[k] - handle.boundary[k]);
        const length = Math.hypot(...way) || 1;
        bars.push({ at: handle.boundary, way: way.map((one) => one / length) });
      }
    }
    keyed(
      this.edges,
      bars,
      (_, k) => k,
      () => svg("path", { class: "edge" }),
      (node, { at, way, off = 0, radial }) => {
        const [x, y] = this.view.px(...at);
        const [dx, dy] = radial ? [way[0], -way[1]] : [way[1], way[0]];
        const [a, b] = radial ? [off - 16, off + 16] : [-22, 22];
        node.setAttribute("d", `M${x + a * dx} ${y + a * dy}L${x + b * dx} ${y + b * dy}`);
      }
    );
  }

  // --- by pointer ------------------------------------------------------------------------------------------------------------

  grab(knob, event, node) {
    if (this.actions.blocked() || (event.button !== 0 && event.pointerType === "mouse")) {
      return;
    }
    event.stopPropagation();
    event.preventDefault();
    node.focus({ preventScroll: true });
    this.release();
    this.canvas.setPointerCapture(event.pointerId); // not the handle: it may vanish while it is dragged
    const from = this.view.of(event);
    this.held = { handle: knob.handle, part: knob.part, from, start: structuredClone(knob.handle), own: {}, moved: false };
    this.last = knob.handle.id;
    this.actions.grab(knob.handle);
    const move = (moving) => {
      if (!this.held || moving.pointerId !== event.pointerId) {
        return;
      }
      this.held.moved = true;
      this.to(this.view.of(moving), moving.timeStamp);
    };
    const raw = "onpointerrawupdate" in window ? "pointerrawupdate" : "pointermove";
    const end = (last) => {
      if (last.pointerId !== event.pointerId) {
        return;
      }
      document.removeEventListener(raw, move);
      document.removeEventListener("pointerup", end);
      document.removeEventListener("pointercancel", end);
      if (this.held) {
        if (last.type === "pointerup" && this.held.moved) {
          this.to(this.view.of(last), last.timeStamp, false);
        } else if (this.held.moved) {
          this.finish(this.held, false);
        }
        this.held = null;
        this.draw();
        this.actions.changed();
      }
    };
    document.addEventListener(raw, move);
    document.addEventListener("pointerup", end);
    document.addEventListener("pointercancel", end);
    this.draw();
  }

  // The value of the handle that is held, for a place of the pointer [mm].
  to(at, stamp, moving = true) {
    const held = this.held;
    const { handle, part, from, start } = held;
    const shift = [at[0] - from[0], at[1] - from[1]];
    if (handle.kind === "point") {
      const way = handle.along;
      const step = way ? way.map((one) => one * dot(shift, way)) : shift;
      held.own = { at: [start.at[0] + step[0], start.at[1] + step[1]] };
      if (way && typeof start.value === "number") {
        held.own.value = start.value + dot(shift, way);
      }
    } else if (handle.centre && handle.kind !== "scalar") {
      const arm = [at[0] - handle.centre[0], at[1] - handle.centre[1]];
      const origin = [from[0] - handle.centre[0], from[1] - handle.centre[1]];
      const own = part === null ? start.value : start.value[part];
      const last = held.turned ?? angleOf(origin);
      held.turned = nearer(angleOf(arm), last);
      const turned = own + held.turned - angleOf(origin);
      const limit = handle.id.startsWith("limits."); // of whole degrees
      held.own = { value: this.within(handle, part, limit ? Math.round(turned) : turned) };
    } else {
      const value = clamped(start.value + dot(shift, handle.along || [1, 0]), handle);
      const gone = value - start.value;
      held.own = { value, at: [0, 1].map((k) => start.at[k] + (handle.along || [1, 0])[k] * gone) };
    }
    Object.assign(handle, held.own);
    this.finish(held, moving, stamp);
    this.actions.changed();
  }

  within(handle, part, value) {
    if (part === null) {
      return clamped(value, handle);
    }
    const pair = [...handle.value];
    pair[part] = clamped(part ? Math.max(value, pair[0]) : Math.min(value, pair[1]), handle);
    return pair;
  }

  finish(held, moving, stamp = performance.now()) {
    const { handle } = held;
    const own = handle.kind === "point" ? { at: handle.at } : { value: handle.value };
    this.actions.drag({ handle: handle.id, ...own, moving }, stamp);
  }

  // --- by keyboard -------------------------------------------------------------------------------------------------------------

  key(knob, event) {
    const way = ARROWS[event.key];
    if (event.key === "Escape" && this.held) {
      Object.assign(this.held.handle, this.held.start);
      this.finish(this.held, false);
      this.held = null;
      this.draw();
      event.stopPropagation();
      return;
    }
    if (!way || event.ctrlKey || event.metaKey || event.altKey) {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
    const { handle, part } = knob;
    if (this.keys?.handle.id !== handle.id) {
      this.release();
      this.actions.grab(handle);
      this.keys = { handle, part, own: {} };
      this.last = handle.id;
    }
    const fine = event.shiftKey ? 0.1 : 1;
    if (handle.kind === "point") {
      const step = fine * round125(12 / this.view.scale);
      const move = handle.along ? handle.along.map((one) => one * step * along(way, handle.along)) : way.map((one) => one * step);
      this.keys.own = { at: [handle.at[0] + move[0], handle.at[1] + move[1]] };
      if (handle.along && typeof handle.value === "number") {
        this.keys.own.value = handle.value + step * along(way, handle.along);
      }
    } else {
      const step = fine * (unit(handle) === "deg" ? 1 : round125(12 / this.view.scale)) * (way[0] + way[1]);
      const value = this.within(handle, part, (part === null ? handle.value : handle.value[part]) + step);
      this.keys.own = { value };
      if (handle.at && handle.along) {
        this.keys.own.at = [0, 1].map((k) => handle.at[k] + handle.along[k] * (value - handle.value));
      }
    }
    Object.assign(handle, this.keys.own);
    this.keys.handle = handle;
    this.finish(this.keys, true);
    clearTimeout(this.resting);
    this.resting = setTimeout(() => this.release(), REST);
    this.actions.changed();
  }

  // Ends a change by keyboard: the ordinary solution and the checks.
  release() {
    clearTimeout(this.resting);
    if (this.keys) {
      this.finish(this.keys, false);
      this.keys = null;
      this.draw();
      this.actions.changed();
    }
  }
}

// Sense of an arrow key along a line: its larger component decides.
function along(way, line) {
  const lead = Math.abs(line[0]) >= Math.abs(line[1]) ? Math.sign(line[0]) : Math.sign(line[1]);
  return lead * (way[0] + way[1]);
}

function arrows([x, y]) {
  const tip = (k) => {
    const [dx, dy] = [k * x, -k * y];
    const at = (a, b) => `${dx * a - dy * b} ${dy * a + dx * b}`;
    return `M${at(12, -4)}L${at(17, 0)}L${at(12, 4)}`;
  };
  return tip(1) + tip(-1);
}
