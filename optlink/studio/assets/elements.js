// The elements and drives of the machine: forms that the server describes, one for each table of the problem file.
//
// A form says what a value `is`: "text", "flag", "list", "table", "names" or a "choice" of these. What is typed is a draft of its
// table; all drafts are sent together, and those that the server refuses stay, with its sentence at the field.
import { $, el, icon, keyed, setText } from "./dom.js";

const FEW = 3; // entries of a group that are listed at once
const words = (key) => key.replaceAll("_", " ");
const title = (key) => words(key)[0].toUpperCase() + words(key).slice(1);
const within = (key, above) => key === above || key.startsWith(`${above}.`);
const plainNumber = (text) => /^[-+−]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$/.test(text);
const isTable = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
const copy = (value) => (value === undefined ? undefined : JSON.parse(JSON.stringify(value)));
const FITS = { list: Array.isArray, table: isTable, names: isTable, flag: (value) => typeof value === "boolean", text: (value) => typeof value !== "object" };
const EMPTY = { list: () => [], table: () => ({}), names: () => ({}), text: () => "", flag: () => false };

// What a draft states: without empty texts, and tables and rows without anything.
function stated(value) {
  if (Array.isArray(value)) {
    return value.map(stated).filter((one) => !isTable(one) || Object.keys(one).length);
  }
  if (!isTable(value)) {
    return value;
  }
  const entries = Object.entries(value).map(([key, one]) => [key, stated(one)]);
  const nothing = (one) => one === "" || (Array.isArray(one) ? one.every((part) => part === "") : isTable(one) && !Object.keys(one).length);
  return Object.fromEntries(entries.filter(([, one]) => !nothing(one)));
}

// Whether nothing is missing that the form requires, so that a draft can be sent.
const whole = (form, value) => (form.required || []).every((key) => key in value) && !/\[[^[\]]*""/.test(JSON.stringify(value));

// A value in short, for the line of a closed entry.
function gist(value) {
  if (Array.isArray(value)) {
    return value.every(isTable) ? `${value.length} segments` : value.map(gist).join(", ");
  }
  if (isTable(value)) {
    return value.start ?? value.equals ?? (value.bounds ? gist(value.bounds) : Object.keys(value).join(", "));
  }
  return typeof value === "string" ? value.replace(/(\d) ?deg\b/g, "$1°").replace("-", "−") : String(value);
}

export class Elements {
  // `send(tables)` asks for a change and returns the number of the request, `rename(old, name)` for another name of a part
  constructor(send, rename) {
    Object.assign(this, { send, rename });
    this.groups = [];
    this.own = [];
    this.discard();
    const bar = el("p", { class: "unapplied", hidden: true }, el("span"), el("button", { text: "Discard", onclick: () => (this.discard(), this.render()) }));
    const add = el("select", { id: "add", "aria-label": "Add an element, a drive or parts", onchange: () => this.add(add.value) });
    $("elements").append(el("div", { class: "head" }, el("h2", { text: "Elements, drives and parts" }), add), bar, el("div"), el("details", { class: "group", id: "renaming", hidden: true }, el("summary", {}, el("b", { text: "Names" }), el("small")), el("div", { class: "fields" })), el("datalist", { id: "names" }));
  }

  discard() {
    this.drafts = new Map(); // tables by key, null for a removed one
    this.shown = new Set(); // keys of fields that are shown though they are empty
    this.faults = [];
    this.sent = null;
  }

  // A state with the tables of the problem; an answer to what was sent makes the drafts part of it.
  take(id, groups, names, own) {
    if (this.sent !== null && id >= this.sent) {
      this.discard();
    }
    this.groups = groups;
    $("names").replaceChildren(...Object.entries(names).map(([name, kind]) => el("option", { value: name, label: `${name}: ${kind}` })));
    this.own = own.map((name) => [name, names[name]]);
    this.render();
  }

  // Names of the parts of the linkage, each in a field; one that was refused is as before.
  named() {
    const [head, list] = $("renaming").children;
    $("renaming").hidden = !this.own.length;
    setText(head.lastChild, String(this.own.length));
    const make = () => {
      const field = el("input", { type: "text", spellcheck: "false", autocomplete: "off" });
      field.addEventListener("input", () => (field.typing = true));
      field.addEventListener("change", () => ((field.typing = false), field.value.trim() === field.name ? this.named() : this.rename(field.name, field.value.trim())));
      field.addEventListener("keydown", (event) => event.key === "Escape" && ((field.typing = false), this.named(), field.blur()));
      return el("div", { class: "field" }, el("label"), field);
    };
    keyed(list, this.own, (_, k) => k, make, ({ firstChild: label, lastChild: field }, [name, kind]) => {
      setText(label, kind);
      label.htmlFor = field.id = `name-${name}`;
      field.ariaLabel = `Name of the ${kind} ${name}`;
      field.name = name;
      field.value = field.typing ? field.value : name;
    });
  }

  // Show the field of a name, if the part has one.
  edit(name) {
    const field = document.getElementById(`name-${name}`);
    if (field) {
      $("renaming").open = true;
      field.scrollIntoView({ block: "nearest" });
      field.select();
    }
  }

  // The server refuses the drafts; returns whether these faults are about them.
  refused(id, faults) {
    if (id !== this.sent) {
      return false;
    }
    this.sent = null;
    this.faults = faults.map(({ key, text }) => ({ key: (key || "").replace(/\[(\d+)\]/g, ".$1"), text }));
    for (const { key } of this.faults) {
      key.split(".").reduce((above, step) => (this.shown.add(`${above}.${step}`), `${above}.${step}`)); // the field is shown
    }
    this.render();
    document.querySelector("#elements .fault")?.scrollIntoView({ block: "nearest" });
    return true;
  }

  // Tables that are shown, each with its form: [{ key, name, group, form, value }].
  entries({ key, form, value }) {
    const several = form.is === "names" && form.of.is === "table";
    const drafted = [...this.drafts.keys()].filter((one) => one.startsWith(`${key}.`)).map((one) => one.slice(key.length + 1));
    const names = several ? [...new Set([...Object.keys(value || {}), ...drafted])] : value || this.drafts.has(key) ? [null] : [];
    return names.map((name) => ({ key: name ? `${key}.${name}` : key, name: name ?? title(key.split(".").at(-1)), form: several ? form.of : form, value: name ? value?.[name] : value }));
  }

  render() {
    this.named();
    const listed = this.groups.map((group) => ({ group, entries: this.entries(group) }));
    const names = this.groups.filter((one) => one.form.of?.is === "table" || !this.entries(one).length);
    const add = $("add");
    add.replaceChildren(el("option", { value: "", text: "Add…" }), ...names.map(({ key }) => el("option", { value: key, text: title(this.one(key)) })));
    const [, bar, list] = $("elements").children;
    const others = this.faults.filter(({ key }) => ![...this.drafts.keys()].some((one) => within(key, one))).map(({ key, text }) => (key ? `${key}: ${text}` : text));
    bar.hidden = !this.drafts.size;
    bar.classList.toggle("alert", this.faults.length > 0);
    setText(bar.firstChild, [this.faults.length ? "Not applied yet." : this.sent === null ? "Applied when all fields are filled in." : "The change is being applied.", ...others].join(" "));
    keyed(
      list,
      listed.filter(({ entries }) => entries.length),
      ({ group }) => group.key,
      ({ entries }) => el("details", { class: "group", open: entries.length <= FEW }, el("summary", {}, el("b"), el("small")), el("div")),
      (node, { group, entries }) => {
        const [head, body] = node.children;
        setText(head.firstChild, title(group.key.split(".").at(-1)));
        setText(head.lastChild, entries.length > 1 ? String(entries.length) : "");
        head.title = group.form.about || "";
        head.hidden = entries[0].key === group.key; // a table without others of its kind has its name
        node.open ||= head.hidden;
        keyed(body, entries, (one) => one.key, (one) => this.entry(one), (line, one) => this.fill(line, one));
        node.open ||= entries.some((one) => this.drafts.has(one.key) || this.faults.some(({ key }) => within(key, one.key)));
      }
    );
  }

  one(key) {
    const name = key.split(".").at(-1);
    return this.groups.find((group) => group.key === key).form.of?.is === "table" ? name.replace(/s$/, "") : name;
  }

  add(key) {
    if (!key) {
      return;
    }
    const group = this.groups.find((one) => one.key === key);
    let entry = key;
    const form = group.form.of ?? group.form;
    if (group.form.of?.is === "table") {
      const taken = new Set(Object.keys(Object.fromEntries([...$("names").children].map((one) => [one.value, 1]))));
      this.entries(group).forEach((one) => taken.add(one.name));
      let count = 1;
      while (taken.has(`${this.one(key)}${count}`)) {
        count += 1;
      }
      entry = `${key}.${this.one(key)}${count}`;
    }
    for (const name of form.required?.length ? [] : Object.keys(form.fields || {}).slice(0, FEW)) {
      this.shown.add(`${entry}.${name}`);
    }
    this.drafts.set(entry, {});
    this.render();
    const node = document.querySelector(`[data-entry="${entry}"]`);
    node.open = true;
    node.scrollIntoView({ block: "nearest" });
    node.querySelector("input, select")?.focus();
  }

  entry({ key }) {
    return el("details", { class: "entry", "data-entry": key }, el("summary", {}, el("span"), el("small")), el("div", { class: "form" }));
  }

  fill(node, entry) {
    const removed = this.drafts.get(entry.key) === null;
    const value = copy(this.drafts.get(entry.key) ?? entry.value ?? {});
    const faults = this.faults.filter(({ key }) => within(key, entry.key));
    const [head, body] = node.children;
    setText(head.firstChild, entry.name);
    setText(head.lastChild, removed ? "removed" : Object.entries(value).map(([key, one]) => (one === true ? words(key) : entry.form.is === "names" ? key : gist(one))).join(" · "));
    node.classList.toggle("draft", this.drafts.has(entry.key));
    node.classList.toggle("removed", removed);
    node.open ||= faults.length > 0;
    const looks = JSON.stringify([value, removed, faults, [...this.shown].filter((one) => one.startsWith(entry.key))]);
    if (node.looks === looks) {
      return;
    }
    node.looks = looks;
    const held = body.contains(document.activeElement) ? document.activeElement : null;
    const own = { entry, value, root: entry.key };
    const about = entry.form.about ? [el("p", { class: "about", text: entry.form.about.replaceAll("`", "") })] : [];
    const act = removed
      ? el("button", { text: "Keep", onclick: () => this.draft(entry, undefined) })
      : el("button", { text: "Remove", onclick: () => this.draft(entry, entry.value === undefined || entry.value === null ? undefined : null) });
    body.replaceChildren(...about, ...(removed ? [] : [this.control(entry.form, value, entry.key, entry.name, own, (next) => this.draft(entry, next))]), el("p", { class: "acts" }, act));
    for (const { key, text } of faults) {
      const fields = [...body.querySelectorAll("[data-key]")].filter(({ dataset }) => within(key, dataset.key));
      const field = fields.sort((a, b) => b.dataset.key.length - a.dataset.key.length)[0];
      (field || body).append(el("p", { class: "fault", role: "alert", text }));
      field?.classList.add("wrong");
    }
    if (held?.id) {
      const again = document.getElementById(held.id);
      if (again && again !== held) {
        if (held.typing) {
          again.value = held.value;
        }
        again.focus();
      }
    }
  }

  // A table is changed, removed (null) or as the file has it (undefined); everything that is whole is sent.
  draft(entry, value) {
    if (value === undefined) {
      this.drafts.delete(entry.key);
    } else {
      this.drafts.set(entry.key, value);
    }
    this.faults = [];
    const entries = this.groups.flatMap((group) => this.entries(group));
    const [forms, present] = ["form", "value"].map((what) => new Map(entries.map((one) => [one.key, one[what]])));
    const tables = [...this.drafts].map(([key, one]) => [key, one === null ? null : stated(one)]);
    const changed = tables.some(([key, one]) => JSON.stringify(one) !== JSON.stringify(present.get(key) ?? null));
    const ready = changed && tables.every(([key, one]) => one === null || whole(forms.get(key), one));
    this.sent = ready ? this.send(Object.fromEntries(tables)) : null;
    this.render();
  }

  // --- controls of a value: `change(next)` takes the new one ---------------------------------------------------------------------

  control(form, value, key, label, own, change) {
    return this[form.is](form, value, key, label, own, change);
  }

  text(form, value, key, label, own, change) {
    const shown = value === undefined || value === null ? "" : typeof value === "object" ? JSON.stringify(value) : String(value);
    const id = `field-${key}`;
    const [, unit] = /^[-+−\d.eE]+\s*(\D.*)$/.exec(shown) || [];
    if (form.only) {
      const options = [...new Set(["", ...form.options])].map((one) => el("option", { value: one, text: one || (form.default ? `${form.default} (default)` : "–"), selected: one === shown }));
      return el("select", { id, "aria-label": label, onchange: ({ target }) => change(target.value) }, ...options);
    }
    const example = form.examples[0];
    const list = form.options.length ? `options-${key}` : example || /\.\d+\.\w+$/.test(key) ? null : "names"; // no names in rows
    const node = el("input", { type: "text", id, list, "aria-label": label, spellcheck: "false", autocomplete: "off", placeholder: form.default ?? example ?? "" });
    node.value = shown;
    node.addEventListener("input", () => (node.typing = true));
    node.addEventListener("change", () => {
      const text = node.value.trim();
      node.typing = false;
      change(plainNumber(text) && unit ? `${text.replace("−", "-")} ${unit}` : text);
    });
    node.addEventListener("keydown", (event) => event.key === "Escape" && ((node.value = shown), node.blur()));
    return form.options.length ? el("span", {}, node, el("datalist", { id: list }, ...form.options.map((one) => el("option", { value: one })))) : node;
  }

  flag(form, value, key, label, own, change) {
    return el("input", { type: "checkbox", id: `field-${key}`, "aria-label": label, checked: value === true, onchange: ({ target }) => change(target.checked) });
  }

  // Two values beside each other; rows of any number of them below each other.
  list(form, value, key, label, own, change) {
    const items = Array.isArray(value) ? value : [];
    const set = (k, next) => change(Object.assign([...items], { [k]: next }));
    const item = (one, k) => this.control(form.of, one, `${key}.${k}`, `${label} ${k + 1}`, own, (next) => set(k, next));
    if (form.most) {
      const both = Array.from({ length: form.most }, (_, k) => items[k] ?? "");
      return el("span", { class: "pair" }, ...both.map((one, k) => el("span", { "data-key": `${key}.${k}` }, this.control(form.of, one, `${key}.${k}`, `${label} ${k + 1}`, own, (next) => change(Object.assign([...both], { [k]: next }))))));
    }
    const heads = form.of.is === "table" ? [el("p", { class: "row heads", "aria-hidden": "true" }, ...Object.entries(form.of.fields).map(([name, of]) => el("small", { class: of.only && "wide", text: words(name) })), el("i", { class: "less" }))] : [];
    const rows = items.map((one, k) => {
      const cells = form.of.is === "table" ? Object.entries(form.of.fields).map(([name, of]) => el("span", { class: of.only && "wide", "data-key": `${key}.${k}.${name}` }, this.control({ ...of, default: undefined, examples: [] }, one[name], `${key}.${k}.${name}`, `${label} ${k + 1}, ${words(name)}`, own, (next) => set(k, { ...one, [name]: next })))) : [item(one, k)];
      return el("div", { class: "row", "data-key": `${key}.${k}` }, ...cells, this.less(`Remove ${label} ${k + 1}`, () => change(items.filter((_, at) => at !== k))));
    });
    const last = items.at(-1);
    return el("div", { class: "rows" }, ...heads, ...rows, el("button", { class: "inline", text: "Add a row", onclick: () => change([...items, isTable(last) ? { ...last } : last ?? EMPTY[form.of.is]()]) }));
  }

  // The required and the stated fields, and a list of the others.
  table(form, value, key, label, own, change) {
    const inner = isTable(value) ? value : {};
    const listed = Object.keys(form.fields).filter((name) => name in inner || form.required.includes(name) || this.shown.has(`${key}.${name}`));
    const without = (name) => Object.fromEntries(Object.entries(inner).filter(([one]) => one !== name));
    const fields = listed.map((name) => {
      const of = form.fields[name];
      const path = `${key}.${name}`;
      const need = form.required.includes(name);
      const set = (next) => change(next === "" ? without(name) : { ...inner, [name]: next });
      const drop = () => (this.shown.delete(path), name in inner ? change(without(name)) : this.render());
      return el("div", { class: `field of-${of.is}${need && !(name in inner) ? " missing" : ""}`, "data-key": path }, el("label", { for: `field-${path}`, text: words(name), title: of.about }), this.control(of, inner[name], path, words(name), own, set), need ? el("i") : this.less(`Remove ${words(name)}`, drop), ...(of.about ? [el("p", { class: "about", text: of.about.replaceAll("`", "") })] : []));
    });
    const rest = Object.keys(form.fields).filter((name) => !listed.includes(name));
    const more = el("select", { class: "more", "aria-label": `Further fields of ${label}` }, el("option", { value: "", text: "More…" }), ...rest.map((name) => el("option", { value: name, text: words(name), title: form.fields[name].about })));
    more.addEventListener("change", () => {
      const path = `${key}.${more.value}`;
      this.shown.add(path);
      this.render();
      document.querySelector(`#elements [data-key="${path}"]`)?.querySelector("input, select")?.focus();
    });
    return el("div", { class: "fields" }, ...fields, ...(rest.length ? [more] : []));
  }

  names(form, value, key, label, own, change) {
    const inner = isTable(value) ? value : {};
    const rows = Object.entries(inner).map(([name, one]) => {
      const without = () => Object.fromEntries(Object.entries(inner).filter(([other]) => other !== name));
      return el("div", { class: `field of-${form.of.is}`, "data-key": `${key}.${name}` }, el("label", { for: `field-${key}.${name}`, text: name }), this.control(form.of, one, `${key}.${name}`, name, own, (next) => change({ ...inner, [name]: next })), this.less(`Remove ${name}`, () => change(without())));
    });
    const fresh = el("input", { type: "text", id: `field-${key}+`, placeholder: "new name", "aria-label": `New name in ${label}`, autocomplete: "off" });
    fresh.addEventListener("change", () => fresh.value.trim() && change({ ...inner, [fresh.value.trim()]: form.of.is === "list" ? Array(form.of.most || 0).fill("") : EMPTY[form.of.is]() }));
    return el("div", { class: "fields" }, ...rows, fresh);
  }

  choice(form, value, key, label, own, change) {
    const present = Math.max(0, form.of.findIndex((one) => value !== undefined && FITS[one.is](value)));
    const called = (one) => (one.is === "table" ? Object.keys(one.fields).slice(0, 3).join(", ") : one.is === "list" ? (one.most ? "two values" : "segments") : "value");
    const forms = el("select", { "aria-label": `Form of ${label}`, title: "Form of the value" }, ...form.of.map((one, k) => el("option", { value: String(k), text: called(one), selected: k === present })));
    forms.addEventListener("change", () => {
      this.shown.add(key);
      const next = form.of[Number(forms.value)];
      change(next.is === "list" && !next.most ? [{}] : next.is === "list" ? Array(next.most).fill("") : EMPTY[next.is]());
    });
    return el("span", { class: "choice" }, this.control({ default: form.default, ...form.of[present] }, value, key, label, own, change), el("span", { class: "as" }, icon("menu"), forms));
  }

  less(label, onclick) {
    return el("button", { class: "icon less", type: "button", "aria-label": label, title: label, onclick }, icon("close"));
  }
}
