// Reads the lines of a DXF drawing for the background: LINE, LWPOLYLINE, ARC and CIRCLE, in millimetres.
const MILLIMETRES = { 1: 25.4, 2: 304.8, 4: 1, 5: 10, 6: 1000 }; // $INSUNITS
const STEP = Math.PI / 36;
const MOST = 20000; // entities

// Points of an arc; angles [rad], counter-clockwise.
function arc(x, y, radius, from, to) {
  const count = Math.max(2, Math.ceil(Math.abs(to - from) / STEP) + 1);
  return Array.from({ length: count }, (_, k) => {
    const turn = from + ((to - from) * k) / (count - 1);
    return [x + radius * Math.cos(turn), y + radius * Math.sin(turn)];
  });
}

// A segment of a polyline whose bulge is the tangent of a quarter of its angle.
function bulged([x, y], [u, v], bulge) {
  if (!bulge) {
    return [[u, v]];
  }
  const angle = 4 * Math.atan(bulge);
  const chord = Math.hypot(u - x, v - y);
  const radius = chord / (2 * Math.sin(Math.abs(angle) / 2));
  const off = ((1 - bulge * bulge) / (4 * bulge)) * chord;
  const [cx, cy] = [(x + u) / 2 - (off * (v - y)) / chord, (y + v) / 2 + (off * (u - x)) / chord];
  const from = Math.atan2(y - cy, x - cx);
  return arc(cx, cy, radius, from, from + angle).slice(1);
}

function polyline(pairs) {
  const corners = [];
  let closed = false;
  for (const [code, text] of pairs) {
    const value = Number(text);
    if (code === 10) {
      corners.push({ x: value, y: 0, bulge: 0 });
    } else if (code === 20 && corners.length) {
      corners.at(-1).y = value;
    } else if (code === 42 && corners.length) {
      corners.at(-1).bulge = value;
    } else if (code === 70) {
      closed = (value & 1) === 1;
    }
  }
  const line = corners.length ? [[corners[0].x, corners[0].y]] : [];
  const count = closed ? corners.length : corners.length - 1;
  for (let k = 0; k < count; k += 1) {
    const [a, b] = [corners[k], corners[(k + 1) % corners.length]];
    line.push(...bulged([a.x, a.y], [b.x, b.y], a.bulge));
  }
  return line;
}

function entity(kind, pairs) {
  const value = (code) => Number(pairs.find(([one]) => one === code)?.[1] ?? NaN);
  if (kind === "LINE") {
    return [[value(10), value(20)], [value(11), value(21)]];
  }
  if (kind === "CIRCLE") {
    return arc(value(10), value(20), value(40), 0, 2 * Math.PI);
  }
  if (kind === "ARC") {
    const [from, to] = [value(50), value(51)].map((turn) => (turn * Math.PI) / 180);
    return arc(value(10), value(20), value(40), from, to > from ? to : to + 2 * Math.PI);
  }
  return kind === "LWPOLYLINE" ? polyline(pairs) : null;
}

// Returns { lines: [[[x, y], ...], ...], box: [x0, y0, x1, y1] } in millimetres; throws a sentence if nothing can be drawn.
export function readDxf(text) {
  const rows = text.split(/\r?\n/);
  const lines = [];
  let factor = 1;
  let [section, kind, pairs, heading] = ["", null, [], ""];
  const finish = () => {
    const line = section === "ENTITIES" && kind && lines.length < MOST ? entity(kind, pairs) : null;
    if (line && line.length > 1 && line.flat().every(Number.isFinite)) {
      lines.push(line);
    }
    [kind, pairs] = [null, []];
  };
  for (let k = 0; k + 1 < rows.length; k += 2) {
    const [code, value] = [Number(rows[k].trim()), rows[k + 1].trim()];
    if (code === 0) {
      finish();
      kind = value;
      section = value === "ENDSEC" ? "" : section;
    } else if (code === 2 && kind === "SECTION") {
      [section, kind] = [value, null];
    } else if (code === 9) {
      heading = value;
    } else if (code === 70 && heading === "$INSUNITS" && section === "HEADER") {
      factor = MILLIMETRES[Number(value)] || 1;
      heading = "";
    } else {
      pairs.push([code, value]);
    }
  }
  finish();
  if (!lines.length) {
    throw new Error("The DXF file has no LINE, LWPOLYLINE, ARC or CIRCLE that could be drawn; export it as an ASCII drawing with these.");
  }
  const scaled = lines.map((line) => line.map(([x, y]) => [x * factor, y * factor]));
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of scaled.flat()) {
    box[0] = Math.min(box[0], x);
    box[1] = Math.min(box[1], y);
    box[2] = Math.max(box[2], x);
    box[3] = Math.max(box[3], y);
  }
  return { lines: scaled, box };
}
