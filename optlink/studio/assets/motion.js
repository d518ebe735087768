// Plays the motion: the position over time, the slider of the drive or of the time, its text.
import { $, icon, quantity } from "./dom.js";

const TURN = 4; // duration of one revolution, or of one motion forth and back [s]

export class Motion {
  // `shown(at, position)` draws a position, whose angle, length or time in its unit is the second one
  constructor(shown) {
    this.shown = shown;
    this.drive = { unit: "deg", values: [0] };
    this.at = 0;
    this.way = 1;
    this.frame = null;
    $("play").addEventListener("click", () => this.toggle());
    $("crank").addEventListener("input", () => {
      this.stop();
      this.put(Number($("crank").value));
    });
  }

  take({ drive, closed }) {
    const [values, before] = [drive.values, this.drive.values];
    const same = values.length === before.length && values[0] === before[0] && values.at(-1) === before.at(-1);
    const share = this.at / Math.max(before.length - 1, 1);
    this.drive = drive;
    this.closed = closed;
    this.turns = closed && drive.unit === "deg";
    this.last = values.length - 1;
    $("transport").hidden = this.last < 1;
    $("crank").max = String(this.last);
    if (!same) {
      this.at = share * this.last;
    }
    this.write();
  }

  // Angle, length or time at the present position, in its unit.
  get position() {
    const { values } = this.drive;
    const low = Math.min(Math.floor(this.at), this.last - 1);
    return this.last > 0 ? values[low] + (this.at - low) * (values[low + 1] - values[low]) : values[0];
  }

  // Distance of the present position from another one, over the end of a closed motion if that is shorter.
  apart(at) {
    const apart = Math.abs(this.at - at);
    return this.closed ? Math.min(apart, this.last - apart) : apart;
  }

  // Position nearest to a crank angle [deg].
  nearest(angle) {
    const away = this.drive.values.map((value) => Math.abs(((((value - angle) % 360) + 540) % 360) - 180));
    return away.indexOf(Math.min(...away));
  }

  put(at) {
    this.at = Math.min(Math.max(at, 0), this.last);
    this.write();
    this.shown(this.at, this.position);
  }

  write() {
    const { label, unit, values } = this.drive;
    const position = this.turns ? ((this.position % 360) + 360) % 360 : this.position;
    const decimals = unit === "s" ? Math.max(0, 3 - Math.ceil(Math.log10(Math.abs(values.at(-1) - values[0]) || 1))) : 1;
    const text = quantity(position, unit, decimals, (value) => value.toFixed(decimals).replace("-", "−"));
    if (this.text !== text || this.label !== label) {
      Object.assign(this, { text, label });
      $("angle").textContent = text;
      $("what").textContent = label;
      $("crank").setAttribute("aria-valuetext", text);
      $("crank").setAttribute("aria-label", label);
    }
    $("crank").value = String(this.at);
  }

  get playing() {
    return this.frame !== null;
  }

  toggle() {
    if (this.playing) {
      this.stop();
    } else {
      this.play();
    }
  }

  play() {
    if (this.last < 1 || this.playing) {
      return;
    }
    let before = null;
    const step = (now) => {
      const { unit, values } = this.drive;
      const span = unit === "deg" ? Math.abs(values[this.last] - values[0]) || 360 : this.closed ? 360 : 180;
      const gone = before === null ? 0 : Math.min((now - before) / 1000, 0.1);
      before = now;
      let at = this.at + (this.way * gone * 360 * this.last) / (TURN * span);
      if (this.closed) {
        at = ((at % this.last) + this.last) % this.last;
      } else if (at >= this.last || at <= 0) {
        this.way = at <= 0 ? 1 : -1;
      }
      this.put(at);
      this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
    this.button("pause", "Pause");
  }

  stop() {
    if (this.playing) {
      cancelAnimationFrame(this.frame);
      this.frame = null;
      this.way = 1;
      this.button("play", "Play");
    }
  }

  button(name, label) {
    $("play").replaceChildren(icon(name));
    $("play").setAttribute("aria-label", label);
  }
}
