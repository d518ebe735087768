// The view of the canvas: millimetres to pixels, zoom and pan by wheel, buttons, keys, one finger and two.
const LEAST = 1e-4;
const MOST = 1e5; // scale [px/mm]
const SMALL = 0.35; // share of the view below which a linkage is shown larger

// Box of a linkage and its targets.
export function extent({ box }, targets) {
  const places = [...(targets?.points || []), ...(targets?.poses || [])].map((one) => one.at);
  const [xs, ys] = [0, 1].map((k) => [box[k], box[k + 2], ...places.map((at) => at[k])]);
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}

export class View {
  constructor(node, changed) {
    this.node = node;
    this.changed = changed;
    this.scale = 2;
    this.x = 0; // of the origin [px]
    this.y = 0;
    this.box = null;
    this.touched = false; // the user has zoomed or panned
    this.covered = () => 0; // height that is covered at the lower end [px]
    this.measure();
    new ResizeObserver(() => this.resized()).observe(node);
  }

  measure() {
    const { width, height, left, top } = this.node.getBoundingClientRect();
    Object.assign(this, { width: width || 1, height: height || 1, left, top });
  }

  resized() {
    const [oldWidth, oldHeight] = [this.width, this.height];
    this.measure();
    if (this.box && !this.touched) {
      this.fit(this.box);
    } else {
      this.x += (this.width - oldWidth) / 2;
      this.y += (this.height - oldHeight) / 2;
      this.changed();
    }
  }

  // box: [x0, y0, x1, y1] [mm]
  fit(box) {
    const [x0, y0, x1, y1] = box;
    const [w, h] = [Math.max(x1 - x0, 1e-6), Math.max(y1 - y0, 1e-6)];
    const narrow = this.width < 600;
    const [left, right, top, bottom] = narrow ? [46, 46, 40, 64] : [76, 76, 64, 84];
    const below = Math.max(bottom, this.covered() + 24);
    const [free, tall] = [Math.max(this.width - left - right, 60), Math.max(this.height - top - below, 60)];
    this.scale = Math.min(Math.max(Math.min(free / w, tall / h), LEAST), MOST);
    this.x = left + free / 2 - (this.scale * (x0 + x1)) / 2;
    this.y = top + tall / 2 + (this.scale * (y0 + y1)) / 2;
    this.box = box;
    this.touched = false;
    this.changed();
  }

  // Whether a box is in view and not much smaller than it.
  holds([x0, y0, x1, y1]) {
    const [left, top] = this.px(x0, y1);
    const [right, bottom] = this.px(x1, y0);
    const inside = left >= 0 && top >= 0 && right <= this.width && bottom <= this.height - this.covered();
    return inside && Math.max((right - left) / this.width, (bottom - top) / this.height) > SMALL;
  }

  px(x, y) {
    return [this.x + this.scale * x, this.y - this.scale * y];
  }

  mm(px, py) {
    return [(px - this.x) / this.scale, (this.y - py) / this.scale];
  }

  // place of a pointer event [mm]
  of(event) {
    const { left, top } = this.node.getBoundingClientRect();
    return this.mm(event.clientX - left, event.clientY - top);
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const wanted = Math.min(Math.max(this.scale * factor, LEAST), MOST);
    const share = wanted / this.scale;
    this.x = px - share * (px - this.x);
    this.y = py - share * (py - this.y);
    this.scale = wanted;
    this.touched = true;
    this.changed();
  }

  pan(dx, dy) {
    this.x += dx;
    this.y += dy;
    this.touched = true;
    this.changed();
  }

  // Pan and zoom by pointers that begin on the background; `busy()` says whether another tool has them.
  follow(busy) {
    const pointers = new Map();
    let last = null;
    const spread = () => {
      const [a, b] = [...pointers.values()];
      return b ? { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, d: Math.hypot(a.x - b.x, a.y - b.y) } : { ...a, d: 0 };
    };
    this.node.addEventListener("pointerdown", (event) => {
      if (busy(event)) {
        return;
      }
      this.node.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
      last = spread();
    });
    document.addEventListener("pointermove", (event) => {
      if (!pointers.has(event.pointerId)) {
        return;
      }
      const { left, top } = this.node.getBoundingClientRect();
      pointers.set(event.pointerId, { x: event.clientX - left, y: event.clientY - top });
      const now = spread();
      this.pan(now.x - last.x, now.y - last.y);
      if (now.d && last.d) {
        this.zoom(now.d / last.d, now.x, now.y);
      }
      last = now;
    });
    const end = (event) => {
      pointers.delete(event.pointerId);
      last = pointers.size ? spread() : null;
    };
    document.addEventListener("pointerup", end);
    document.addEventListener("pointercancel", end);
    this.node.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const { left, top } = this.node.getBoundingClientRect();
        const lines = event.deltaMode === 1 ? 16 : 1;
        this.zoom(Math.exp(-event.deltaY * lines * (event.ctrlKey ? 0.01 : 0.0015)), event.clientX - left, event.clientY - top);
      },
      { passive: false }
    );
  }
}

// 1, 2 or 5 times a power of ten, not above the value
export function round125(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const lead = value / power;
  return power * (lead >= 5 ? 5 : lead >= 2 ? 2 : 1);
}
