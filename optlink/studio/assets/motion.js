// Plays the motion: the position over time, the slider of the crank angle, its text.
import { $, icon } from "./dom.js";

const TURN = 4; // duration of one revolution [s]

export class Motion {
  // `shown(position, angle)` draws a position
  constructor(shown) {
    this.shown = shown;
    this.angles = [0];
    this.at = 0;
    this.way = 1;
    this.frame = null;
    $("play").addEventListener("click", () => this.toggle());
    $("crank").addEventListener("input", () => {
      this.stop();
      this.put(Number($("crank").value));
    });
  }

  take({ angles, closed }) {
    const same = angles.length === this.angles.length && angles[0] === this.angles[0] && angles.at(-1) === this.angles.at(-1);
    const share = this.at / Math.max(this.angles.length - 1, 1);
    this.angles = angles;
    this.closed = closed;
    this.last = angles.length - 1;
    $("transport").hidden = this.last < 1;
    $("crank").max = String(this.last);
    if (!same) {
      this.at = share * this.last;
    }
    this.write();
  }

  // Angle of the crank at a position [deg].
  get angle() {
    const low = Math.min(Math.floor(this.at), this.last - 1);
    return this.last > 0 ? this.angles[low] + (this.at - low) * (this.angles[low + 1] - this.angles[low]) : this.angles[0];
  }

  // Distance of the present position from another one, over the end of a closed motion if that is shorter.
  apart(at) {
    const apart = Math.abs(this.at - at);
    return this.closed ? Math.min(apart, this.last - apart) : apart;
  }

  put(at) {
    this.at = Math.min(Math.max(at, 0), this.last);
    this.write();
    this.shown(this.at, this.angle);
  }

  write() {
    const angle = this.closed ? ((this.angle % 360) + 360) % 360 : this.angle;
    const text = `${angle.toFixed(1).replace("-", "−")}°`;
    if (this.text !== text) {
      this.text = text;
      $("angle").textContent = text;
      $("crank").setAttribute("aria-valuetext", text);
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
      const span = Math.abs(this.angles[this.last] - this.angles[0]) || 360;
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
