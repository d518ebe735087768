// The problem and its design at the last release: they outlive the connection to the studio.
import { download, hint } from "./dom.js";
import { embedded } from "./live.js";

const ENDED = "The connection to the studio has ended. Start `optlink studio` again, and open its new address.";
const ELSEWHERE = "This canvas is connected in another view, or its kernel has ended.";
let kept = null; // the state

export function keep(state) {
  kept = state.moving ? kept : structuredClone(state); // a drag moves its handle
  return state.document;
}

// Says that the connection has ended, until it is back; `why` are the words of a studio that has closed it. Returns the state to show.
export function lost(connect, saved, why) {
  const save = () => {
    download(`${kept.document.name}.toml`, "application/toml", kept.document.text);
    kept.document.changed = false;
    saved();
  };
  const actions = [{ text: "Reconnect", run: connect }, ...(kept && !embedded ? [{ text: "Save the problem", run: save }] : [])];
  hint(embedded ? ELSEWHERE : why || ENDED, actions, true);
  return structuredClone(kept);
}
