// Small helpers: elements, numbers as text, colours that follow light and dark.
const SVG = "http://www.w3.org/2000/svg";

export const $ = (id) => document.getElementById(id);

function filled(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name === "text") {
      node.textContent = value;
    } else if (name.startsWith("on")) {
      node.addEventListener(name.slice(2), value);
    } else if (value === true) {
      node.setAttribute(name, "");
    } else if (value !== null && value !== undefined && value !== false) {
      node.setAttribute(name, value);
    }
  }
  node.append(...(children || []));
  return node;
}

export const el = (tag, attributes, ...children) => filled(document.createElement(tag), attributes, children);
export const svg = (tag, attributes, ...children) => filled(document.createElementNS(SVG, tag), attributes, children);
export const icon = (name) => svg("svg", { "aria-hidden": "true" }, svg("use", { href: `#i-${name}` }));

// A colour of a drawing: the style sheet holds its dark counterpart under --c and its digits.
export const colour = (hex) => (/^#[0-9a-f]{6}$/i.test(hex || "") ? `var(--c${hex.slice(1).toLowerCase()}, ${hex})` : "currentColor");

export function number(value, digits = 5) {
  if (value === null || value === undefined || !Number.isFinite(value)) {
    return "–";
  }
  const size = Math.abs(value);
  if (size === 0) {
    return "0";
  }
  if (size < 1e-4 || size >= 1e7) {
    const [mantissa, power] = value.toExponential(digits - 2).split("e");
    return `${mantissa.replace("-", "−")}e${String(Number(power)).replace("-", "−")}`;
  }
  const decimals = Math.max(0, Math.min(7, digits - 1 - Math.floor(Math.log10(size))));
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

// A number of a problem file, without zeros at its end.
export const plain = (value, digits = 4) => (Number.isFinite(value) && Math.abs(value) < 1e7 ? String(Number(value.toPrecision(digits))).replace("-", "−") : number(value, digits));

const UNITS = { deg: "°", "": "", 1: "" };
export const unitText = (unit) =>
  UNITS[unit] ?? String(unit).replace(/\^2/g, "²").replace(/\^3/g, "³").replace(/\^(-?\d)/g, "^$1").replace(/ ?\* ?/g, "·").replace(/N m\b/g, "N·m");
export function quantity(value, unit, digits, write = number) {
  const shown = unitText(unit || "");
  return write(value, digits) + (shown === "°" || shown === "" ? shown : " " + shown);
}

// Children of a node, one per item, kept from one call to the next: `make(item)` returns a node, `update(node, item)` writes it.
// Without `ordered` no node is moved: one that is moved would lose the focus.
export function keyed(parent, items, key, make, update, ordered = true) {
  const old = parent.keyed || new Map();
  const now = new Map();
  items.forEach((item, k) => {
    const name = key(item, k);
    const node = old.get(name) || make(item, k);
    now.set(name, node);
    update(node, item, k);
    if (!ordered) {
      if (!node.parentNode) {
        parent.append(node);
      }
    } else if (parent.children[k] !== node) {
      parent.insertBefore(node, parent.children[k] || null);
    }
  });
  for (const [name, node] of old) {
    if (now.get(name) !== node) {
      node.remove();
    }
  }
  parent.keyed = now;
}

export const setText = (node, text) => {
  if (node.textContent !== text) {
    node.textContent = text;
  }
};

export const bytes = (text) => Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0)); // of base 64

export function download(name, media, content) {
  const address = URL.createObjectURL(new Blob([content], { type: media }));
  const anchor = el("a", { href: address, download: name });
  document.body.append(anchor);
  anchor.click();
  anchor.remove();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}

let lasting = false;
// A line above the canvas; one that lasts is replaced by another one that lasts only.
export function hint(text, actions = [], lasts = false) {
  if (lasting && !lasts) {
    return;
  }
  lasting = lasts && Boolean(text);
  const node = $("hint");
  node.hidden = !text;
  node.classList.toggle("lasting", lasting);
  node.replaceChildren(text || "", ...actions.flatMap(({ text: words, run }) => [" ", el("button", { text: words, class: "inline", onclick: run })]));
}

// A message as a sentence; one that begins with a name, a key or a file keeps it.
export const sentence = (text) => text.replace(/^(the|a|an|no|there|this|what|unknown) /, (word) => word[0].toUpperCase() + word.slice(1)).replace(/[^.!?]$/, "$&.");

let hiding = 0;
const close = () => ($("toast").hidden = true);
// What was refused does not matter any longer: a later change was accepted.
export const settled = () => $("toast").classList.contains("bad") && close();
export function toast(text, bad = false) {
  const node = $("toast");
  node.replaceChildren(text, ...(bad ? [el("button", { class: "icon", "aria-label": "Close", onclick: close }, icon("close"))] : []));
  node.classList.toggle("bad", bad);
  node.hidden = false;
  clearTimeout(hiding);
  hiding = setTimeout(close, bad ? 12000 : 4000);
}
