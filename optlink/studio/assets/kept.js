// The problem at the last release: it outlives the connection to the studio.
import { download, hint } from "./dom.js";
import { embedded } from "./live.js";

const ENDED = "The connection to the studio has ended. Start `optlink studio` again, and open its new address.";
const ELSEWHERE = "This canvas is connected in another view, or its kernel has ended.";
let kept = null; // name, text, changed

export function keep(document) {
  kept = document.text === undefined || embedded ? kept : document;
  return document;
}

// The fields of the request that opens it again, with its changes still to be saved; null before the first problem.
export function again() {
  return kept && { text: kept.text, title: kept.name, ...(kept.changed ? { origin: "" } : {}) };
}

// Says that the connection has ended, until it is back; `why` are the words of a studio that has closed it.
export function lost(connect, why) {
  const save = { text: "Save the problem", run: () => download(`${kept.name}.toml`, "application/toml", kept.text) };
  hint(embedded ? ELSEWHERE : why || ENDED, [{ text: "Reconnect", run: connect }, ...(kept ? [save] : [])], true);
}
