// A photograph or a DXF drawing behind the linkage, to scale: it stays in the browser.
import { readDxf } from "./dxf.js";
import { $, svg, toast } from "./dom.js";
import { pathOf } from "./linkage.js";

const LARGEST = 40e6; // bytes of a file

export class Background {
  // `tool(name)` chooses the tool of the canvas
  constructor(layer, overlay, view, tool) {
    Object.assign(this, { layer, view, tool, picks: [], node: null, busy: false });
    this.scale = 1;
    this.origin = [0, 0];
    this.line = svg("path", { class: "measure" });
    overlay.append(this.line);
    $("back-file").addEventListener("click", () => $("back-input").click());
    $("back-input").addEventListener("change", () => {
      const [file] = $("back-input").files;
      $("back-input").value = "";
      if (file) {
        this.open(file);
      }
    });
    $("back-opacity").addEventListener("input", () => this.look());
    $("back-remove").addEventListener("click", () => this.remove());
    $("back-scale").addEventListener("click", () => this.measure());
    $("back-length").addEventListener("submit", (event) => {
      event.preventDefault();
      this.apply(Number($("back-mm").value));
    });
  }

  async open(file) {
    try {
      if (file.size > LARGEST) {
        throw new Error("The file is larger than 40 MB; use a smaller picture.");
      }
      if (/\.dxf$/i.test(file.name)) {
        this.drawing(readDxf(await file.text()));
      } else {
        await this.picture(file);
      }
      this.tool("back");
      toast(/\.dxf$/i.test(file.name) ? "Drawing placed in its own units." : "Set the scale: two points of known distance.");
    } catch (error) {
      toast(error.message || "The file cannot be shown; use PNG, JPEG, WebP or DXF.", true);
    }
  }

  async picture(file) {
    const address = URL.createObjectURL(file);
    const image = new Image();
    image.src = address;
    try {
      await image.decode();
    } catch {
      URL.revokeObjectURL(address);
      throw new Error("The file cannot be read as a picture; use PNG, JPEG, WebP or DXF.");
    }
    const { naturalWidth: w, naturalHeight: h } = image;
    const { view } = this;
    const scale = Math.min((0.8 * view.width) / w, (0.8 * view.height) / h) / view.scale; // [mm] per pixel of the picture
    const [x, y] = view.mm(view.width / 2, view.height / 2);
    this.put(svg("image", { href: address, width: w, height: h, y: -h, transform: "scale(1 -1)" }), scale, [x - (scale * w) / 2, y - (scale * h) / 2]);
    this.address = address;
  }

  drawing({ lines, box }) {
    this.put(svg("path", { class: "dxf", d: lines.map((line) => pathOf(line)).join("") }), 1, [0, 0]);
    this.view.fit(box);
  }

  put(node, scale, origin) {
    this.remove();
    this.node = svg("g", {}, node);
    Object.assign(this, { scale, origin });
    this.layer.append(this.node);
    for (const name of ["back-scale", "back-opacity", "back-remove"]) {
      $(name).disabled = false;
    }
    this.look();
  }

  look() {
    if (this.node) {
      this.node.setAttribute("transform", `translate(${this.origin}) scale(${this.scale})`);
      this.node.style.opacity = Number($("back-opacity").value) / 100;
    }
  }

  remove() {
    this.node?.remove();
    this.node = null;
    if (this.address) {
      URL.revokeObjectURL(this.address);
      this.address = null;
    }
    for (const name of ["back-scale", "back-opacity", "back-remove"]) {
      $(name).disabled = true;
    }
    this.stop();
  }

  // --- scale: two clicks and a length ------------------------------------------------------------------------------------------

  measure() {
    this.busy = true;
    this.picks = [];
    $("back-length").hidden = true;
    toast("Click two points of known distance.");
    this.draw();
  }

  stop() {
    this.busy = false;
    this.picks = [];
    $("back-length").hidden = true;
    this.draw();
  }

  // A click of the canvas while the scale is set; returns whether it was used.
  click(at) {
    if (!this.busy || this.picks.length > 1) {
      return this.busy;
    }
    this.picks.push(at);
    if (this.picks.length === 2) {
      $("back-length").hidden = false;
      $("back-mm").focus();
    }
    this.draw();
    return true;
  }

  apply(length) {
    const [a, b] = this.picks;
    const shown = Math.hypot(a[0] - b[0], a[1] - b[1]);
    if (!(length > 0) || !(shown > 0)) {
      toast("Choose two different points and a positive length.", true);
      return;
    }
    const share = length / shown;
    this.origin = [0, 1].map((k) => a[k] + share * (this.origin[k] - a[k])); // the first point stays
    this.scale *= share;
    this.look();
    this.stop();
    toast("The background is to scale.");
  }

  // Moves the background by a distance [mm].
  move(dx, dy) {
    if (this.node) {
      this.origin = [this.origin[0] + dx, this.origin[1] + dy];
      this.look();
    }
  }

  draw() {
    const at = this.picks.map((one) => this.view.px(...one));
    this.line.setAttribute("d", at.map(([x, y]) => `M${x - 7} ${y}h14M${x} ${y - 7}v14`).join("") + (at.length > 1 ? `M${at[0]}L${at[1]}` : ""));
  }
}
