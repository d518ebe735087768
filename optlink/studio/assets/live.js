// The connection: requests with rising ids; of drags one in flight and the newest waiting; answers older than what is shown are dropped.
export const timings = (window.studioTimings = []);
const KEPT = 4000;
const PATIENCE = 15000; // after which a drag without an answer no longer blocks the next [ms]

export class Live {
  constructor(token, listeners) {
    this.token = token;
    this.listeners = listeners;
    this.id = 0;
    this.shown = 0;
    this.dropped = 0;
    this.flying = null;
    this.waiting = null;
    this.sent = new Map();
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const query = this.token ? `?token=${encodeURIComponent(this.token)}` : "";
    const socket = (this.socket = new WebSocket(`${scheme}://${location.host}/live${query}`));
    this.flying = this.waiting = null;
    this.shown = this.id; // answers to an earlier connection no longer count
    socket.addEventListener("message", (event) => this.receive(JSON.parse(event.data)));
    socket.addEventListener("close", () => {
      if (socket === this.socket) {
        this.listeners.closed();
      }
    });
  }

  get open() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  send(type, fields = {}) {
    if (!this.open) {
      this.listeners.closed();
      return null;
    }
    const id = ++this.id;
    this.socket.send(JSON.stringify({ type, id, ...fields }));
    return id;
  }

  // `fields`: handle, at or value, moving; `event`: time stamp of the movement
  drag(fields, event) {
    const next = { fields, event };
    if (this.flying !== null && performance.now() - this.flying.sent < PATIENCE) {
      this.waiting = next;
    } else {
      this.fly(next);
    }
  }

  fly({ fields, event }) {
    const id = this.send("drag", fields);
    this.flying = id === null ? null : { id, sent: performance.now() };
    if (id !== null) {
      this.sent.set(id, { id, event, sent: this.flying.sent, moving: fields.moving });
    }
  }

  receive(message) {
    const { id, type } = message;
    if (type === "state" && id !== undefined && id !== null) {
      if (id < this.shown) {
        this.dropped += 1;
      } else {
        this.shown = id;
        message.timing = this.timed(id);
        this.listeners.state(message);
      }
    } else if (type === "hello") {
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

  timed(id) {
    const timing = this.sent.get(id) || null;
    for (const known of this.sent.keys()) {
      if (known <= id) {
        this.sent.delete(known);
      }
    }
    if (timing) {
      timing.answered = performance.now();
      timings.push(timing);
      if (timings.length > KEPT) {
        timings.splice(0, KEPT / 4);
      }
    }
    return timing;
  }
}
