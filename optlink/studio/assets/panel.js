// The side panel: verdict, conclusion, design variables, limits, charts, checks.
import { drawCharts } from "./chart.js";
import { inPanel } from "./handles.js";
import { $, el, icon, keyed, plain, quantity, number, setText, unitText } from "./dom.js";

const VERDICTS = {
  verified: ["✓", "Verified", "good"],
  "not verified": ["○", "Not verified", "open"],
  "not valid": ["✗", "Not valid", "bad"],
  infeasible: ["✗", "No feasible design found", "bad"],
  failed: ["✗", "No solution", "bad"],
};

const FINE = 1e-4; // a size below this is written with fewer digits
const NOUGHT = 1e-7; // and below this as zero [mm, deg or 1]
const NOTHING = 1e-12; // an objective below this is written as such

export const verdictOf = (status) => VERDICTS[status] || ["○", status, "open"];

// The design variables, and the fixed sizes that can be freed: those have handles.
function sizes(variables, handles) {
  const known = new Set(variables.map((one) => one.name));
  const fixed = handles.filter(({ size, locked, value }) => size && locked && typeof value === "number" && !known.has(size));
  return [...variables, ...fixed.map(({ size, value, unit, id }) => ({ name: size, value, unit, key: id, lower: null, upper: null, locked: true }))];
}

const STEPS = { deg: 1, mm: 1, cm: 0.1, m: 0.001, in: 0.05 };
const ANY_STEP = 0.01; // of other units, and of ratios

// The step of a slider: one of its unit, or less where its range is short.
const stepOf = (unit, range) => Math.min(STEPS[unit] ?? ANY_STEP, 10 ** Math.floor(Math.log10(range / 20)));

// A field in which a value is typed, with or without its unit; `entered(text)` takes it. What is being typed is kept until then.
function field(label, entered) {
  const node = el("input", { type: "text", inputmode: "decimal", "aria-label": label, spellcheck: "false" });
  const reset = () => (node.value = node.shown);
  node.addEventListener("input", () => (node.typing = true));
  for (const end of ["change", "blur"]) {
    node.addEventListener(end, () => (node.typing = false));
  }
  node.addEventListener("change", () => {
    const text = node.value.trim().replace("−", "-");
    if (text && !node.readOnly) {
      entered(/^[-+.\deE]+$/.test(text) && node.unit ? `${text} ${node.unit}` : text);
    } else {
      reset();
    }
  });
  node.addEventListener("keydown", (event) => event.key === "Escape" && (reset(), node.blur()));
  return node;
}

function fill(node, text, unit) {
  Object.assign(node, { shown: text, unit });
  if ((!node.typing || node.readOnly) && node.value !== text) {
    node.value = text;
  }
}

function table(parent, title, heads) {
  if (!parent.firstChild) {
    const head = el("tr", {}, ...heads.map((text) => el("th", { scope: "col", text })));
    parent.append(el("h2", { text: title }), el("div", { class: "rows" }, el("table", {}, el("thead", {}, head), el("tbody"))));
  }
  return parent.querySelector("tbody");
}

// Whether a handle has a line of its own in the panel: points have places, bounds and sizes on the canvas are in the table.
function listed({ id, kind, size, at, centre }) {
  return size ? !at && !centre && kind !== "range" : kind !== "point" && !id.startsWith("requirement.points.");
}

export class Panel {
  // `actions`: lock(name, locked), set(key, value), drag(fields)
  constructor(actions) {
    this.actions = actions;
    this.cursor = () => {};
    $("result").append(
      el("div", { class: "head" }, el("p", { class: "verdict", id: "verdict" }, el("span", { class: "sign", "aria-hidden": "true" }), el("span")), el("small", { id: "took" })),
      el("p", { class: "conclusion", id: "conclusion" }),
      el("p", { class: "objective", id: "objective" }, el("span"), el("b"))
    );
  }

  take(state, handles) {
    const sliders = inPanel(handles);
    this.verdict(state);
    const said = state.conclusion || ""; // a conflict that the conclusion states is not repeated
    $("conclusion").classList.toggle("alert", state.status === "infeasible");
    this.conflicts((state.conflicts || []).filter((sentence) => !said.includes(sentence.replace(/\.$/, ""))));
    this.variables(sizes(state.variables || [], handles), sliders);
    this.sliders(handles.filter(listed));
    this.active(state.active || []);
    this.checks(state);
    $("charts").hidden = !state.charts?.length;
    this.cursor = drawCharts($("charts"), state.charts || []);
  }

  // Another problem begins.
  begin() {
    for (const node of $("sliders").lastChild?.children || []) {
      node.range = null;
    }
  }

  verdict(state) {
    const [sign, words, look] = verdictOf(state.status);
    const node = $("verdict");
    if (state.moving !== this.moving) {
      this.moving = state.moving; // what lies below does not jump in a drag
      $("result").style.minHeight = state.moving ? `${$("result").offsetHeight}px` : "";
    }
    node.className = `verdict ${look}`;
    setText(node.children[0], sign);
    setText(node.children[1], words);
    const said = $("conclusion");
    setText(said, (state.conclusion || "").replace(/(\d) (?=[%µmN°])/g, "$1\u00a0"));
    const [label, value] = $("objective").children;
    const known = Number.isFinite(state.objective?.value) && state.status !== "infeasible";
    $("objective").hidden = !known && (!state.moving || !state.objective || state.status === "infeasible");
    if (state.objective) {
      setText(label, state.objective.label);
      const tiny = state.objective.value !== 0 && Math.abs(state.objective.value) < NOTHING;
      setText(value, `${tiny ? "< " : ""}${quantity(tiny ? NOTHING : state.objective.value, state.objective.unit, tiny ? 2 : 6).replace(/^(−?\d{2,})(\d{3})(?=\D|$)/, "$1,$2")}`);
    }
    const seconds = state.seconds?.solve;
    setText($("took"), Number.isFinite(seconds) && state.status !== "infeasible" && !state.searching ? `${state.kind === "analysis" ? "computed" : "solved"} in ${seconds < 1 ? `${number(1e3 * seconds, 2)} ms` : `${number(seconds, 2)} s`}` : "");
  }

  conflicts(sentences) {
    const node = $("conflicts");
    node.hidden = !sentences.length;
    keyed(node, sentences, (_, k) => k, () => el("p"), (line, text) => setText(line, text));
  }

  variables(variables, sliders) {
    const parent = $("variables");
    parent.hidden = !variables.length;
    if (!variables.length) {
      return;
    }
    const body = table(parent, "Design variables", ["Name", "Value", "Bounds", "Lock"]);
    setText(parent.firstChild, variables.some((one) => !one.locked) ? "Design variables" : "Dimensions");
    const bounds = new Map(sliders.filter((one) => one.kind === "range" && one.size).map((one) => [one.size, one]));
    keyed(body, variables, (one) => one.name, (one) => this.row(one), (node, one) => this.fill(node, one, bounds.get(one.name)));
  }

  row(variable) {
    const name = variable.name;
    const value = field(`Value of ${name}`, (text) => this.actions.set(row.variable.key, text));
    const unit = el("span", { class: "unit" });
    const track = el("div", { class: "track" }, el("i"), el("b"));
    const lock = el("button", { class: "icon lock", "aria-pressed": "false" }, icon("unlock"));
    const row = el("tr", { "data-variable": name }, el("th", { scope: "row" }, ...name.split(/(?<=\.)/).flatMap((part) => [part, el("wbr")])), el("td", { class: "num" }, value, unit), el("td", { class: "bounds" }, track, el("small"), el("p", {}, this.bound(name, 0, () => row), this.bound(name, 1, () => row))), el("td", {}, lock));
    lock.addEventListener("click", () => this.actions.lock(name, !row.variable.locked));
    for (const part of [0, 1]) {
      track.append(this.knob(row, part));
    }
    return row;
  }

  fill(row, variable, handle) {
    row.variable = variable;
    row.handle = row.holding === undefined ? handle : row.handle;
    const [, cell, bounds, last] = row.children;
    const [value, unit] = cell.children;
    value.readOnly = !variable.key;
    const size = Math.abs(variable.value);
    fill(value, size < NOUGHT ? "0" : number(variable.value, size < FINE ? 4 : 6), variable.unit);
    setText(unit, unitText(variable.unit || ""));
    const [low, high] = [variable.lower, variable.upper];
    row.classList.toggle("locked", Boolean(variable.locked));
    row.classList.toggle("bound", Boolean(variable.at_bound));
    const limited = Number.isFinite(low) && Number.isFinite(high) && high > low && !variable.locked;
    const [track, small, typed] = bounds.children;
    track.hidden = !limited;
    typed.hidden = !limited || !handle;
    small.hidden = !typed.hidden;
    setText(small, variable.equals ? `= ${variable.equals}` : variable.locked ? "fixed" : limited ? `${plain(low)} … ${plain(high)}` : "free");
    [low, high].forEach((edge, part) => fill(typed.children[part], plain(edge), variable.unit));
    if (limited) {
      const place = (at) => `${(100 * Math.min(Math.max((at - low) / (high - low), 0), 1)).toFixed(2)}%`;
      const [, mark, ...knobs] = track.children;
      mark.style.left = place(variable.value);
      knobs.forEach((knob, part) => {
        knob.hidden = !handle;
        const edge = part ? high : low;
        knob.setAttribute("aria-label", `${part ? "upper" : "lower"} bound of ${variable.name}, dragged`);
        knob.setAttribute("aria-valuenow", String(edge));
        knob.setAttribute("aria-valuetext", quantity(edge, variable.unit, 4));
      });
    }
    const lock = last.firstChild;
    const pressed = String(Boolean(variable.locked));
    if (lock.getAttribute("aria-pressed") !== pressed || !lock.hasAttribute("aria-label")) {
      lock.setAttribute("aria-pressed", pressed);
      lock.setAttribute("aria-label", `${variable.locked ? "Free" : "Lock"} ${variable.name}`);
      lock.title = variable.locked ? "Free this variable again" : "Lock at the present value";
      lock.replaceChildren(icon(variable.locked ? "lock" : "unlock"));
    }
  }

  // A bound of a variable, typed.
  bound(name, part, row) {
    return field(`${part ? "upper" : "lower"} bound of ${name}`, (text) => {
      const { variable, handle } = row();
      const [value, pair] = [Number.parseFloat(text), [variable.lower, variable.upper]];
      if (Number.isFinite(value) && text.endsWith(variable.unit)) {
        pair[part] = value;
      } // else the answer shows the present bound again
      this.actions.drag({ handle: handle.id, value: pair, moving: false });
    });
  }

  // The end of the bounds of a variable: dragged along its track, or moved with the arrow keys.
  knob(row, part) {
    const name = part ? "upper" : "lower";
    const node = el("span", { class: `end ${name}`, role: "slider", tabindex: "0", "aria-label": `${name} bound`, "aria-valuemin": "-1000000", "aria-valuemax": "1000000" });
    const send = (value, moving) => {
      const pair = [row.variable.lower, row.variable.upper];
      pair[part] = part ? Math.max(value, pair[0]) : Math.min(value, pair[1]);
      this.actions.drag({ handle: row.handle.id, value: pair, moving });
    };
    node.addEventListener("pointerdown", (event) => {
      if (!row.handle) {
        return;
      }
      event.preventDefault();
      node.focus();
      node.setPointerCapture(event.pointerId);
      const { lower, upper } = row.variable;
      const wide = node.parentElement.getBoundingClientRect().width;
      const [from, edge] = [event.clientX, part ? upper : lower];
      let value = edge;
      row.holding = part;
      const move = (moving) => {
        value = edge + ((moving.clientX - from) / wide) * (upper - lower);
        send(value, true);
      };
      const end = () => {
        document.removeEventListener("pointermove", move);
        row.holding = undefined;
        send(value, false);
      };
      document.addEventListener("pointermove", move);
      document.addEventListener("pointerup", end, { once: true });
      document.addEventListener("pointercancel", end, { once: true });
    });
    let resting = 0;
    node.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
      if (way && row.handle) {
        event.preventDefault();
        const { lower, upper } = row.variable;
        const value = (part ? upper : lower) + way * (upper - lower) * (event.shiftKey ? 0.001 : 0.01);
        send(value, true);
        clearTimeout(resting);
        resting = setTimeout(() => send(value, false), 450);
      }
    });
    return node;
  }

  // Numbers of the requirement and the limits, and sizes that have no place on the canvas.
  sliders(handles) {
    const parent = $("sliders");
    parent.hidden = !handles.length;
    if (!handles.length) {
      return;
    }
    if (!parent.firstChild) {
      parent.append(el("h2", { text: "Requirement and limits" }), el("div", { class: "list" }));
    }
    const sizes = handles.filter((one) => one.size).length;
    setText(parent.firstChild, sizes === handles.length ? "Sizes" : sizes ? "Dimensions, requirement and limits" : "Requirement and limits");
    keyed(parent.lastChild, handles, (one) => `${one.id} ${one.kind}`, (one) => this.slider(one), (node, one) => this.fillSlider(node, one));
  }

  slider(first) {
    const count = first.kind === "range" ? 2 : 1;
    const names = count > 1 ? [`${first.label}, lower`, `${first.label}, upper`] : [first.label];
    const inputs = names.map((name) => el("input", { type: "range", "aria-label": name }));
    const fields = names.map((name, k) =>
      field(`Value of ${name}`, (text) => {
        if (count === 1) {
          this.actions.set(node.handle.id, text);
        } else {
          const pair = [...node.handle.value];
          pair[k] = Number.isFinite(Number(text)) ? Number(text) : pair[k];
          this.actions.drag({ handle: node.handle.id, value: pair, moving: false });
        }
      })
    );
    const node = el("div", { class: "slider", "data-handle": first.id }, el("p", {}, el("span"), ...fields, el("span", { class: "unit" })), ...inputs);
    const send = (moving) => {
      const values = inputs.map((one) => Number(one.value));
      this.actions.drag({ handle: node.handle.id, value: count > 1 ? [Math.min(...values), Math.max(...values)] : values[0], moving });
    };
    for (const input of inputs) {
      input.addEventListener("input", () => ((node.holding = true), send(true)));
      input.addEventListener("change", () => ((node.holding = false), send(false)));
    }
    return node;
  }

  fillSlider(node, handle) {
    node.handle = handle;
    const [head, ...inputs] = node.children;
    const values = handle.kind === "range" ? handle.value : [handle.value];
    const [least, most] = [Math.min(...values), Math.max(...values)];
    const edge = node.range ? 0.02 * (node.range[1] - node.range[0]) : 0;
    if (!node.range || least < node.range[0] + edge || most > node.range[1] - edge) {
      node.range = [least - Math.abs(values[0] || 1), most + Math.abs(values[0] || 1)]; // kept until a value comes to its end
    }
    const [low, high] = [handle.lower ?? node.range[0], handle.upper ?? node.range[1]];
    const [label, ...fields] = head.children;
    setText(label, handle.label);
    setText(fields.pop(), unitText(handle.unit || ""));
    const step = stepOf(handle.unit || "", high - low);
    inputs.forEach((input, k) => {
      fill(fields[k], plain(values[k], 6), handle.unit);
      if (!node.holding) {
        input.step = step;
        input.min = Number((Math.floor(low / step) * step).toPrecision(9)); // steps count from there
        input.max = high;
        input.value = values[k];
      }
      input.setAttribute("aria-valuetext", quantity(values[k], handle.unit, 4));
    });
  }

  active(limits) {
    const parent = $("active");
    parent.hidden = !limits.length;
    if (!limits.length) {
      return;
    }
    const body = table(parent, "Active limits", ["Limit", "Shadow price"]);
    keyed(
      body,
      limits,
      (one) => one.limit,
      () => el("tr", {}, el("th", { scope: "row" }), el("td", { class: "num" })),
      ({ children: [name, price] }, one) => {
        const sides = one.limit.replace("<=", "≤").replace(">=", "≥");
        setText(name, sides + (Number.isFinite(one.value) ? ` ${quantity(one.value, one.unit, 4, plain)}` : ""));
        const shown = (value) => quantity(/[<>]/.test(one.limit) ? Math.abs(value) : value, one.price_unit?.replace(/^1 per/, "per").replace(/\bdeg\b/g, "°"), 4).replace(" °", "°");
        const joint = one.joint_price ? `; all together ${shown(one.joint_price)}` : "";
        setText(price, one.price === null ? "–" : joint ? `alone ${shown(one.price)}${joint}` : shown(one.price));
      }
    );
  }

  checks(state) {
    const parent = $("checks");
    const checks = state.checks;
    if (!parent.firstChild) {
      parent.append(el("h2", { text: "Validation" }), el("p"), el("details", {}, el("summary", { text: "All checks" }), el("ul")));
    }
    const [, line, details] = parent.children;
    details.hidden = !checks;
    if (!checks) {
      setText(line, state.moving ? "Checked when you release." : state.unchecked);
      return;
    }
    const passed = checks.filter((one) => one.ok).length;
    setText(line, `${passed} of ${checks.length} checks passed`);
    keyed(
      details.lastChild,
      [...checks].sort((a, b) => Number(a.ok) - Number(b.ok)),
      (one, k) => one.name + k,
      () => el("li", {}, el("span", { class: "sign" }), el("span"), el("small")),
      ({ children: [sign, name, measured], classList }, one) => {
        classList.toggle("bad", !one.ok);
        setText(sign, one.ok ? "✓" : "✗");
        setText(name, one.name);
        const limit = one.limit === null || one.limit === undefined ? "" : ` (limit ${typeof one.limit === "number" ? number(one.limit, 4) : one.limit})`;
        setText(measured, typeof one.measured === "number" ? quantity(one.measured, one.unit, 4) + limit : String(one.measured ?? ""));
      }
    );
    if (passed < checks.length) {
      details.open = true;
    }
  }
}
