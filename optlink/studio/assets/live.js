// The connection: requests with rising ids; of drags one in flight and the newest waiting; answers older than what is shown are dropped.
// studioTimings is for measurements: of every movement when it happened, when its drag or a later one was sent, answered and drawn.
export const timings = (window.studioTimings = []);
const KEPT = 4000;
const PATIENCE = 15000; // after which a drag without an answer no longer blocks the next [ms]
const NO_TOKEN = "This address lacks its token. Open the address that `optlink studio` printed.";
export const embedded = "embedded" in document.documentElement.dataset; // in a notebook

// The token of the address: out of the address bar, kept for this tab alone.
export function keptToken() {
  const given = new URLSearchParams(location.search).get("token");
  try {
    if (given) {
      sessionStorage.setItem("optlink-token", given);
      history.replaceState(null, "", location.pathname + location.hash);
    }
    return given || sessionStorage.getItem("optlink-token");
  } catch {
    return given;
  }
}

// In a notebook the page is a frame: its messages go through the notebook to the kernel.
class FrameSocket extends EventTarget {
  constructor() {
    super();
    this.readyState = WebSocket.OPEN;
    addEventListener("message", (event) => event.source === parent && event.data?.studio && this.take(event.data));
    parent.postMessage({ studio: "connect" }, "*");
  }

  take({ studio, text }) {
    if (studio === "answer") {
      this.dispatchEvent(new MessageEvent("message", { data: text }));
    } else if (studio === "close" && this.readyState === WebSocket.OPEN) {
      this.readyState = WebSocket.CLOSED;
      this.dispatchEvent(new Event("close"));
    }
  }

  send(text) {
    parent.postMessage({ studio: "request", text }, "*");
  }
}

export class Live {
  constructor(token, listeners) {
    this.token = token;
    this.listeners = listeners;
    this.id = 0;
    this.shown = 0;
    this.dropped = 0;
    this.flying = null;
    this.waiting = null;
    this.moves = []; // not drawn yet
  }

  connect() {
    if (!embedded && !this.token) {
      this.listeners.closed(NO_TOKEN);
      return;
    }
    const socket = (this.socket = embedded ? new FrameSocket() : this.opened());
    this.flying = this.waiting = null;
    this.shown = 0;
    socket.addEventListener("message", (event) => socket === this.socket && this.receive(JSON.parse(event.data)));
    socket.addEventListener("close", (event) => {
      if (socket === this.socket) {
        this.flying = this.waiting = null;
        this.listeners.closed(event.reason);
      }
    });
  }

  opened() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const query = new URLSearchParams({ ...(this.token && { token: this.token }), ...(this.page && { page: this.page }) });
    return new WebSocket(`${scheme}://${location.host}/live?${query}`);
  }

  get open() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  send(type, fields = {}) {
    if (!this.open) {
      this.listeners.closed();
      return null;
    }
    const before = this.waiting;
    if (before && type !== "drag") {
      this.waiting = null;
      this.fly(before);
    }
    const id = ++this.id;
    this.socket.send(JSON.stringify({ type, id, ...fields }));
    return id;
  }

  // `fields`: handle, at or value, moving; `event`: time stamp of the movement
  drag(fields, event) {
    const next = { fields, timing: { event, moving: fields.moving } };
    this.moves.push(next.timing);
    if (this.flying !== null && performance.now() - this.flying.sent < PATIENCE) {
      this.waiting = next;
    } else {
      this.fly(next);
    }
  }

  fly({ fields, timing }) {
    const id = this.send("drag", fields);
    const sent = performance.now();
    this.flying = id === null ? null : { id, sent };
    for (const one of this.moves.slice(0, this.moves.indexOf(timing) + 1)) {
      one.id ??= id;
      one.sent ??= sent;
    }
  }

  receive(message) {
    const { id, type } = message;
    if (type === "state" && id !== undefined && id !== null) {
      if (id < this.shown) {
        this.dropped += 1;
      } else {
        this.shown = id;
        this.mark(id, "answered");
        this.listeners.state(message);
      }
    } else if (type === "hello") {
      this.page = message.page; // by which the studio opens the problem again, with its history
      this.listeners.hello(message);
    } else {
      this.listeners[type]?.(message);
    }
    if ((type === "state" || type === "fault") && this.flying && id >= this.flying.id) {
      this.flying = null;
      const next = this.waiting;
      this.waiting = null;
      if (next) {
        this.fly(next);
      }
    }
  }

  // The answer to a drag has arrived, or is drawn: so are the movements before it.
  mark(id, what) {
    for (const one of this.moves) {
      if (one.id <= id) {
        one[what] ??= performance.now();
      }
    }
    if (what === "drawn") {
      timings.push(...this.moves.filter((one) => one.drawn));
      this.moves = this.moves.filter((one) => !one.drawn);
      if (timings.length > KEPT) {
        timings.splice(0, KEPT / 4);
      }
    }
  }
}
