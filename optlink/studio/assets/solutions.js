// All exact solutions of a problem, usable ones first: each as a small picture, in motion when it is pointed at.
import { thumbnail, candidate } from "./curve.js";
import { $, el, keyed, quantity, setText } from "./dom.js";

export class Solutions {
  // `actions`: ask(fields), choose(number), preview(scene or null, whether it is usable), hint(text), close()
  constructor(actions) {
    this.actions = actions;
    this.wanted = false;
    $("found-by").addEventListener("change", () => this.ask());
    $("found-close").addEventListener("click", () => actions.close());
  }

  open(wanted) {
    if (wanted === this.wanted) {
      return;
    }
    Object.assign(this, { wanted, items: [] });
    if (!wanted && $("found").contains(document.activeElement)) {
      $("tool-solutions").focus();
    }
    $("found").hidden = !wanted;
    if (wanted) {
      $("found-by").value = "";
      this.usual = this.accepted = null;
      this.show({ items: [] });
      setText($("found-title"), "Finding all exact solutions …");
      this.ask();
    } else {
      this.actions.preview(null);
    }
  }

  ask() {
    this.asked = $("found-by").value;
    this.actions.ask({ by: this.asked });
  }

  // The ranking is not one: its field has that of the list again. Returns whether there is a list.
  refused() {
    $("found-by").value = this.accepted ?? "";
    return this.items.length > 0;
  }

  take(message) {
    if (this.wanted) {
      this.accepted = this.asked;
      this.usual ??= message.by;
      this.show(message);
      this.look(0);
      if ([document.body, $("tool-solutions")].includes(document.activeElement)) {
        $("found-items").querySelector("button")?.focus(); // the way by keyboard leads through the list
      }
    }
  }

  show({ items, count = 0, usable = 0, special, sentence = "", unit, by, ways = [] }) {
    Object.assign(this, { items, unit, by });
    $("found-by").placeholder = this.usual ?? "";
    $("found-ways").replaceChildren(...ways.map((value) => el("option", { value })));
    const listed = special ? `The ${count} best of infinitely many exact solutions` : `${usable} usable of ${count} exact solutions`;
    setText($("found-title"), count ? listed : "No exact solutions");
    $("found-title").title = sentence;
    const more = count > items.length ? ` ${count - items.length} more are in the list of the command optlink solve --all --json.` : "";
    this.about = `${sentence.charAt(0).toUpperCase()}${sentence.slice(1)}.${more}`;
    setText($("found-why"), sentence ? this.about : "");
    keyed($("found-items"), items, (_, k) => k, (_, k) => this.item(k), (node, one, k) => this.fill(node, one, k));
  }

  item(k) {
    return candidate(() => this.look(k), () => this.choose(k));
  }

  fill(node, one, k) {
    const button = node.firstChild;
    const [plot, figure, note] = button.children;
    thumbnail(plot, one.scene);
    const words = one.figure === null ? `${k + 1}` : `${k + 1}: ${quantity(one.figure, this.unit, 4)}`;
    setText(figure, words);
    const verdict = one.usable ? "usable" : [...new Set(one.reasons.map((reason) => reason.split(": ")[0]))].join(", ");
    setText(note, verdict);
    button.classList.toggle("bad", !one.usable);
    button.setAttribute("aria-label", `Solution ${k + 1}: ${this.by} ${one.figure === null ? "unknown" : quantity(one.figure, this.unit, 4)}, ${verdict}`);
  }

  look(k) {
    const one = this.items[k];
    if (one) {
      setText($("found-why"), one.usable ? `Choose solution ${k + 1}, and it becomes the design. ${this.about}` : `Solution ${k + 1} is not usable (${one.reasons.join("; ")}). The panel shows the present design.`);
      this.actions.preview(one.scene, one.usable);
      this.actions.hint(`Solution ${k + 1}: ${one.usable ? "usable" : "not usable"}`);
    }
  }

  choose(k) {
    this.look(k);
    if (this.items[k].usable) {
      this.actions.choose(k);
    }
  }
}
