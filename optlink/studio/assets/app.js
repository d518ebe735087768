// The studio: connects the page with the server, and the parts of the page with each other.
import { Background } from "./background.js";
import { dropDown, keyboard, takeFiles } from "./commands.js";
import { Curve } from "./curve.js";
import { $, bytes, download, hint, sentence, setText, settled, svg, toast } from "./dom.js";
import { Dyads } from "./dyads.js";
import { Elements } from "./elements.js";
import { Handles } from "./handles.js";
import { keep, lost } from "./kept.js";
import { Linkage } from "./linkage.js";
import { embedded, keptToken, Live } from "./live.js";
import { Motion } from "./motion.js";
import { Panel, verdictOf } from "./panel.js";
import { Parts } from "./parts.js";
import { Region } from "./region.js";
import { guide, Search } from "./search.js";
import { Solutions } from "./solutions.js";
import { Start } from "./start.js";
import "./theme.js";
import { extent, round125, View } from "./view.js";

const EMPTY = [-120, -80, 320, 200]; // box of an empty canvas [mm]
const root = document.documentElement;
const SLOW = 300; // after which a change that takes longer shows that it is computed [ms]

// --- canvas ---------------------------------------------------------------------------------------------------------------------

const canvas = $("canvas");
const grid = svg("path", { class: "gridlines" });
canvas.append(grid);
let state = null;
let handles = [];
let stale = false; // something is to be drawn
const references = new Map(); // positions at which handles lie on their joints
const view = new View(canvas, () => redraw());
view.covered = () => Math.max($("tray").offsetHeight, $("found").offsetHeight);
const linkage = new Linkage(canvas, view);
const overlay = svg("g", { id: "overlay" });

function redraw() {
  if (!stale) {
    stale = true;
    requestAnimationFrame(() => {
      early = false;
      if (stale) {
        frame();
      }
    });
  }
}

// The first answer of a frame is drawn at once, so that the frame is ready early; later ones wait for the next frame.
let early = false;
function redrawNow() {
  redraw();
  if (!early && !document.hidden) {
    early = true;
    frame();
  }
}

let fresh = null; // the newest state that is not drawn yet
function frame() {
  stale = false;
  const shown = fresh;
  if (shown) {
    fresh = null;
    take(shown);
  }
  lines();
  linkage.place();
  knobs.draw();
  curve.draw();
  dyads.draw();
  region.draw();
  background.draw();
  if (shown) {
    live.mark(shown.id, "drawn");
    canvas.dataset.shown = String(shown.id);
  }
}

function lines() {
  const step = round125(90 / view.scale);
  const [x0, y1] = view.mm(0, 0);
  const [x1, y0] = view.mm(view.width, view.height);
  let path = "";
  for (let k = Math.ceil(x0 / step); k * step <= x1; k += 1) {
    path += `M${view.px(k * step, 0)[0].toFixed(1)} 0v${view.height}`;
  }
  for (let k = Math.ceil(y0 / step); k * step <= y1; k += 1) {
    path += `M0 ${view.px(0, k * step)[1].toFixed(1)}h${view.width}`;
  }
  grid.setAttribute("d", path);
  const [text, bar] = $("scale").children;
  setText(text, `${Number(step.toPrecision(3))} mm`);
  bar.style.width = `${step * view.scale}px`;
}

const knobs = new Handles(canvas, view, {
  blocked: () => tool !== "select",
  grab: (handle) => {
    motion.stop();
    guide.done();
    const at = reference(handle);
    if (at !== null) {
      motion.put(at);
    }
  },
  away: (handle) => {
    const at = handle.id.startsWith("requirement.") ? null : reference(handle); // targets stay where they are
    return at !== null && motion.apart(at) > 0.05;
  },
  drag,
  changed: redraw,
});
canvas.append(overlay);
const curve = new Curve(overlay, view, {
  draw: (points, closed) => live.send("draw", { points, closed }),
  choose: (candidate, done) => start.unless(() => ((refit = true), live.send("choose", { candidate }), done())),
  preview,
  fit: (points) => {
    const box = extent({ box: [...points[0], ...points[0]] }, { points: points.map((at) => ({ at })) });
    if (!view.touched && !view.holds(box)) {
      view.fit(box);
    }
  },
  hint,
});
const dyads = new Dyads(overlay, view, { ask: (fields) => ask("dyads", fields), hint });
const solutions = new Solutions({
  ask: (fields) => ask("solutions", fields),
  choose: (chosen) => ask("solutions", { chosen }),
  preview: (scene, usable) => {
    preview(scene, usable);
    if (!scene) {
      motion.stop();
    }
    if (linkage.scene) {
      view.fit(extent(linkage.scene, linkage.targets));
    }
  },
  hint,
  close: () => choose("select"),
});
const region = new Region(overlay, view, (box) => ask("region", { box }));
const background = new Background(linkage.layers.below, overlay, view, choose);
const motion = new Motion((at, position) => {
  linkage.show(at);
  knobs.fade();
  panel.cursor(position);
});
const panel = new Panel({
  lock: (size, locked) => live.send("lock", { size, locked }),
  set: (key, value) => live.send("set", { key, value }),
  drag: (fields) => drag(fields, performance.now()),
});

const elements = new Elements((tables) => ask("edit", { tables }), (old, name) => ask("rename", { old, new: name }));
const parts = new Parts({
  ask: () => live.send("parts"),
  edit: (tables) => ask("edit", { tables }),
  section: () => elements.groups.find(({ key }) => key === "parts")?.value,
  file: (format) => ask("export", { format }),
  colour: (name) => linkage.scene?.bodies.find((one) => one.name === name)?.colour ?? "#444444",
  at: (angle) => {
    motion.stop();
    motion.put(motion.nearest(angle));
  },
  drawn: (message) => linkage.made(message),
});

// What is drawn is not verified from the first movement on, also where the answer takes its time.
function drag(fields, stamp) {
  if (state?.status === "verified") {
    state.status = "not verified";
    verdict(state.status);
    panel.verdict({ ...state, moving: true, conclusion: `The ${state.kind === "analysis" ? "motion" : "optimum"} is being computed.` });
  }
  live.drag(fields, stamp);
}

function verdict(status) {
  canvas.dataset.status = status.replaceAll(" ", "-");
  const [sign, words, look] = verdictOf(status);
  $("badge").hidden = look === "good";
  $("badge").className = look;
  setText($("badge"), `${sign} ${words}`);
}

// Position of the motion at which a joint lies where its handle is; null for a handle that does not move with it.
function reference({ at, centre, id }) {
  const { scene } = linkage;
  if (!scene || !(at || centre)) {
    return null;
  }
  if (references.scene !== scene) {
    references.clear();
    references.scene = scene;
  }
  if (!references.has(id)) {
    references.set(id, linkage.position(centre || at));
  }
  return references.get(id);
}

// A four-bar for a drawn curve, or the design again; one that the validator has passed is drawn like a verified design.
function preview(scene, valid = false) {
  canvas.classList.toggle("preview", Boolean(scene));
  canvas.classList.toggle("valid", valid);
  if (scene) {
    linkage.take(scene, tool === "solutions" ? state.targets : {});
    motion.take(scene);
    motion.play();
  } else if (state?.scene) {
    linkage.take(state.scene, state.targets);
    motion.take(state.scene);
    parts.state(state);
  } else {
    motion.stop();
    linkage.clear();
    $("transport").hidden = true;
  }
}

// --- what the server says -------------------------------------------------------------------------------------------------------
let refit = true; // the next state is another problem
let entering = true; // its first design is still to come

function take(next) {
  const scene = next.scene ? { ...next.scene } : null;
  handles = next.handles || handles;
  state = { ...next, scene: scene || state?.scene || null };
  if (scene) {
    linkage.take(scene, next.targets);
    state.scene = linkage.scene;
    motion.take(scene);
  } else if (refit) {
    linkage.clear();
    $("transport").hidden = true;
  }
  const draft = next.searching && !Number.isFinite(next.objective?.value); // the starting point of the first search
  if (scene && !refit && !next.moving && !view.touched && ((entering && !draft) || !view.holds(extent(scene, next.targets)))) {
    view.fit(extent(scene, next.targets));
  }
  canvas.toggleAttribute("data-draft", Boolean(draft));
  canvas.classList.remove("preview");
  if (refit) {
    entering = true;
    panel.begin();
  }
  if (refit && scene) {
    view.fit(extent(scene, next.targets));
    motion.put(0);
  }
  if (entering && scene && !draft) {
    entering = false;
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) {
      motion.play();
    }
  }
  refit = false;
  if (!next.moving && !next.searching && scene) {
    guide.show(handles, next.kind);
  }
  if (!next.moving) {
    $("tool-dyads").hidden = !next.dyads;
    $("tool-solutions").hidden = !next.solutions;
    $("tool-region").hidden = !next.pivots;
    region.take(next.pivots);
    if (["dyads", "solutions", "region"].includes(tool)) {
      choose("select");
    }
  }
  parts.state(next);
  knobs.infeasible = next.status === "infeasible" || next.status === "failed";
  knobs.take(handles);
  panel.take(state, handles);
  panel.cursor(motion.position);
  verdict(next.status);
  const { can_undo: undo, can_redo: redo } = next.document;
  titled(keep(next));
  $("undo").disabled = !undo;
  $("redo").disabled = !redo;
  for (const name of ["save", "export", "share", "search", "view-parts"]) {
    $(name).disabled = false;
  }
  root.dataset.open = "";
}

function saved() {
  state.document.changed = false;
  titled(state.document);
}

function titled({ title, changed }) {
  setText($("title"), title);
  document.title = `${changed ? "• " : ""}${title} – optlink studio`;
  $("title").classList.toggle("changed", Boolean(changed));
}

let computing = 0;
const busy = (on) => {
  clearTimeout(computing);
  if (on) {
    computing = setTimeout(() => root.setAttribute("data-busy", ""), SLOW);
  } else {
    root.removeAttribute("data-busy");
  }
};

let link = "";
let refused = 0; // number of the last request that was refused
const live = new Live(keptToken(), {
  hello(message) {
    start.take(message);
    root.dataset.ready = "";
    hint(null, [], true);
    const fragment = location.hash.slice(1);
    if (fragment && !message.opened) {
      ask("open", { fragment });
      history.replaceState(null, "", location.pathname);
    } else if (message.opened) {
      start.hide();
      refit = true;
    } else if (!state) {
      start.show(false);
    }
  },
  state(message) {
    busy(false);
    if (message.id > refused) {
      settled();
    }
    search.state(message);
    if (message.tables) {
      if (refit) {
        elements.discard();
      }
      elements.take(message.id, message.tables, message.names, message.renamable);
    }
    fresh = fresh && !message.handles ? { ...message, handles: fresh.handles, scene: merged(message.scene, fresh.scene) } : message;
    redrawNow();
  },
  progress: ({ fraction, text }) => search.take(fraction, text),
  dyads: (message) => (busy(false), dyads.take(message)),
  solutions: (message) => (busy(false), solutions.take(message)),
  parts: (message) => parts.take(message),
  candidates: (message) => (busy(false), curve.candidates(message)),
  file({ name, media, text, data, files, changed_on_disk: stale }) {
    busy(false);
    download(name, media, data ? bytes(data) : text);
    toast(`${name} saved in your downloads.${files?.length ? ` It reads ${files.join(", ")}: keep the files together.` : ""}${stale ? ` ${name} has changed on disk since it was opened: the saved file does not contain that change.` : ""}`, stale);
    if (media === "application/toml" && state) {
      saved();
    }
  },
  link({ fragment }) {
    busy(false);
    link = `${embedded ? "" : `${location.origin}/`}#${fragment}`; // a frame of a notebook has no address
    $("link-text").value = link;
    $("link").showModal();
    $("link-text").select();
  },
  fault({ id, message, faults }) {
    busy(false);
    refused = id ?? refused;
    search.take(null);
    if (elements.refused(id, faults || [])) {
      return;
    }
    toast(sentence(message), true);
    state && panel.take(state, handles); // what was typed and refused is in the message
    state && parts.state(state);
    elements.named();
    if (tool === "solutions") {
      solutions.refused() || choose("select");
    } else if (linkage.canvas.classList.contains("preview")) {
      preview(null);
    }
    if (!state && !start.open && tool !== "draw") {
      start.show(false);
    }
  },
  closed(why) {
    busy(false);
    start.hide(); // it would cover the message
    knobs.held = null;
    fresh = lost(() => live.connect(), saved, why);
    redraw();
  },
});

// A state that was overtaken before it was drawn may hold outlines that its follower leaves out.
function merged(scene, before) {
  for (const body of scene?.bodies || []) {
    body.parts ??= before?.bodies?.find((one) => one.name === body.name)?.parts;
  }
  return scene || before;
}

const AFTER_SEARCH = { export: "The file follows when the search has ended.", link: "The link follows when the search has ended." };
function ask(type, fields) {
  busy(true);
  if (search.running && AFTER_SEARCH[type]) {
    toast(`${AFTER_SEARCH[type]} Stop ends it.`);
  }
  if (type === "undo" || type === "redo") {
    elements.discard();
  }
  if (type === "open" || type === "new") {
    refit = true;
    curve.close();
    motion.stop();
  }
  return live.send(type, fields);
}

const search = new Search({
  send: (type) => (type === "stop" ? live.send(type) : ask(type)),
  objective: () => state?.objective?.value,
});

// --- tools ------------------------------------------------------------------------------------------------------------------------

let tool = "select";
const TOOLS = ["select", "draw", "dyads", "solutions", "region", "back"];
const HINTS = { draw: "Draw a curve in one stroke: end at its start to close it.", region: "Draw a box: all ground pivots will stay inside.", back: "Drag to move the background. Set its scale by two clicks and a length." };
function choose(name) {
  guide.done();
  tool = name;
  for (const one of TOOLS) {
    $(`tool-${one}`).setAttribute("aria-pressed", String(one === name));
  }
  canvas.dataset.tool = name;
  $("backing").hidden = name !== "back";
  if (name !== "back") {
    background.stop();
  }
  hint(HINTS[name] || null);
  dyads.open(name === "dyads");
  solutions.open(name === "solutions");
}
for (const name of TOOLS) {
  $(`tool-${name}`).addEventListener("click", () => choose(tool === name ? "select" : name));
}
canvas.addEventListener("dblclick", (event) => tool === "select" && elements.edit(linkage.named(event)));
canvas.addEventListener("pointermove", (event) => tool === "dyads" && dyads.move(event));
view.follow((event) => tool === "draw" || tool === "region" || (tool === "dyads" && dyads.near(event) !== null) || (tool === "back" && (background.busy || background.node)) || event.target.closest?.(".handle"));
canvas.addEventListener("pointerdown", (event) => {
  if (tool === "draw" || tool === "region") {
    const drawn = tool === "draw" ? curve : region;
    canvas.setPointerCapture(event.pointerId);
    drawn.begin(event);
    const move = (moving) => moving.getCoalescedEvents().forEach((one) => drawn.move(one)) || drawn.move(moving);
    document.addEventListener("pointermove", move);
    document.addEventListener("pointerup", () => {
      document.removeEventListener("pointermove", move);
      if (drawn.end()) {
        choose("select");
      }
    }, { once: true });
  } else if (tool === "dyads") {
    dyads.pick(event);
  } else if (tool === "back" && background.busy) {
    background.click(view.of(event));
    event.preventDefault();
  } else if (tool === "back" && background.node) {
    canvas.setPointerCapture(event.pointerId);
    let last = view.of(event);
    const move = (moving) => {
      const at = view.of(moving);
      background.move(at[0] - last[0], at[1] - last[1]);
      last = at;
    };
    document.addEventListener("pointermove", move);
    document.addEventListener("pointerup", () => document.removeEventListener("pointermove", move), { once: true });
  }
});

const start = new Start({
  draw: () => choose("draw"),
  open: (fields) => ask("open", fields),
  fresh: (template) => ask("new", { template }),
  save: () => ask("save"),
  changed: () => (state?.document.changed ? state.document.title : null),
});

// --- commands -----------------------------------------------------------------------------------------------------------------------

$("open").addEventListener("click", () => start.show(true));
$("save").addEventListener("click", () => ask("save"));
$("share").addEventListener("click", () => ask("link"));
$("undo").addEventListener("click", () => ask("undo"));
$("redo").addEventListener("click", () => ask("redo"));
$("zoom-in").addEventListener("click", () => view.zoom(1.4));
$("zoom-out").addEventListener("click", () => view.zoom(1 / 1.4));
$("zoom-fit").addEventListener("click", () => view.fit(linkage.scene ? extent(linkage.scene, linkage.targets) : EMPTY));
$("link-copy").addEventListener("click", async () => {
  try {
    await navigator.clipboard.writeText(link);
  } catch {
    $("link-text").select(); // no clipboard for this page: the text can be copied by hand
    document.execCommand("copy");
  }
  toast("Link copied.");
});

const formats = dropDown($("export"), $("formats"));
for (const item of $("formats").children) {
  item.addEventListener("click", () => {
    formats(false);
    ask("export", { format: item.dataset.format });
  });
}
keyboard({
  before: () => knobs.release(),
  single: () => !start.open,
  escape: () => tool !== "select" && choose("select"),
});
takeFiles((file) => {
  if (/\.(dxf|png|jpe?g|webp|gif)$/i.test(file.name)) {
    start.hide();
    background.open(file);
  } else {
    start.file(file);
  }
});
addEventListener("hashchange", () => {
  if (location.hash.length > 1) {
    ask("open", { fragment: location.hash.slice(1) });
    history.replaceState(null, "", location.pathname);
  }
});
addEventListener("beforeunload", (event) => !embedded && state?.document.changed && event.preventDefault());

view.fit(EMPTY);
live.connect();
