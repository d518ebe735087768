// A light line chart: axes with a few round numbers, curves, limits as dashed lines, and a cursor at the position of the drive.
import { el, keyed, number, plain, setText, svg, unitText } from "./dom.js";
import { round125 } from "./view.js";

const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [340, 150, 44, 14, 8, 22];
const FINE = 1e-9;
const SLACK = 1e-4; // share of the range of the positions, which are rounded

function ticks(low, high, count) {
  const raw = (high - low) / count;
  const step = round125(raw) * (raw / round125(raw) > 1.5 ? 2 : 1);
  const first = Math.ceil(low / step - FINE);
  return Array.from({ length: Math.floor(high / step + FINE) - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(12)));
}

function angles(low, high) {
  const span = high - low;
  const step = [15, 30, 45, 90, 180, 360].find((one) => span / one <= 5) || 720;
  const first = Math.ceil(low / step - FINE);
  return Array.from({ length: Math.floor(high / step + FINE) - first + 1 }, (_, k) => (first + k) * step);
}

const turning = (chart) => /deg|°/.test(chart.x.unit || "");
const finite = (values) => values.filter((value) => value !== null && Number.isFinite(value));

function build() {
  const plot = svg(
    "svg",
    { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" },
    svg("title"),
    svg("g", { class: "grid" }),
    svg("g", { class: "limits" }),
    svg("g", { class: "series" }),
    svg("line", { class: "cursor", y1: TOP, y2: HEIGHT - BOTTOM, visibility: "hidden" })
  );
  return el("figure", { class: "chart" }, el("figcaption", {}, el("span"), el("small")), plot, el("p", { class: "legend" }));
}

function update(node, chart) {
  const [caption, plot, legend] = node.children;
  const [title, grid, limits, series, cursor] = plot.children;
  const unit = unitText(chart.series[0]?.unit || "");
  setText(caption.firstChild, chart.title + (unit ? ` [${unit}]` : ""));
  setText(caption.lastChild, chart.x.label ? `over ${chart.x.label}${turning(chart) || !chart.x.unit ? "" : ` [${unitText(chart.x.unit)}]`}` : "");
  const x = chart.x.values;
  const marks = (chart.limits || []).filter((one) => Number.isFinite(one.value));
  const every = finite([...chart.series.flatMap((one) => one.values), ...marks.map((one) => one.value)]);
  const [low, high] = every.length ? [Math.min(...every), Math.max(...every)] : [0, 1];
  const most = Math.max(Math.abs(low), Math.abs(high));
  const room = Math.max((high - low) * 0.06, high - low < 1e-4 * most ? 0.02 * most : 0, 1e-12); // of a constant: not its rounding
  const [y0, y1] = [low - room, high + room];
  const [x0, x1] = x.length ? [Math.min(x[0], x.at(-1)), Math.max(x[0], x.at(-1))] : [0, 1];
  const px = (value) => LEFT + ((value - x0) / (x1 - x0 || 1)) * (WIDTH - LEFT - RIGHT);
  const py = (value) => HEIGHT - BOTTOM - ((value - y0) / (y1 - y0)) * (HEIGHT - TOP - BOTTOM);
  const angular = turning(chart);
  const lines = [
    ...ticks(y0, y1, 4).map((value) => ({ value, up: true })),
    ...(angular ? angles(x0, x1) : ticks(x0, x1, 5)).map((value) => ({ value, up: false })),
  ];
  keyed(
    grid,
    lines,
    (one) => `${one.up} ${one.value}`,
    () => svg("g", {}, svg("line"), svg("text")),
    ({ children: [line, text] }, { value, up }) => {
      const at = up ? py(value) : px(value);
      const ends = up ? { x1: LEFT, x2: WIDTH - RIGHT, y1: at, y2: at } : { x1: at, x2: at, y1: TOP, y2: HEIGHT - BOTTOM };
      Object.entries(ends).forEach(([name, end]) => line.setAttribute(name, end.toFixed(1)));
      text.setAttribute("x", up ? LEFT - 5 : at.toFixed(1));
      text.setAttribute("y", up ? (at + 3.5).toFixed(1) : HEIGHT - 8);
      text.setAttribute("text-anchor", up ? "end" : "middle");
      setText(text, short(value) + (!up && angular ? "°" : ""));
    }
  );
  keyed(
    limits,
    marks,
    (one, k) => k,
    () => svg("g", {}, svg("line"), svg("text")),
    ({ children: [line, text] }, { value, label }) => {
      const at = py(value);
      Object.entries({ x1: LEFT, x2: WIDTH - RIGHT, y1: at, y2: at }).forEach(([name, end]) => line.setAttribute(name, end.toFixed(1)));
      text.setAttribute("x", WIDTH - RIGHT - 3);
      text.setAttribute("y", (at > TOP + 14 ? at - 4 : at + 11).toFixed(1));
      text.setAttribute("text-anchor", "end");
      setText(text, `${label || "limit"} ${plain(value)}`);
    }
  );
  keyed(
    series,
    chart.series,
    (one, k) => k,
    (one, k) => svg("path", { class: `s${k}` }),
    (path, one) => {
      let text = "";
      let pen = "M";
      one.values.forEach((value, k) => {
        if (value === null || !Number.isFinite(value)) {
          pen = "M";
        } else {
          text += `${pen}${px(x[k]).toFixed(1)} ${py(value).toFixed(1)}`;
          pen = "L";
        }
      });
      path.setAttribute("d", text);
    }
  );
  legend.hidden = chart.series.length < 2;
  keyed(
    legend,
    legend.hidden ? [] : chart.series,
    (one, k) => k,
    (one, k) => el("span", {}, el("i", { class: `s${k}` }), el("span")),
    (span, one) => setText(span.lastChild, one.label)
  );
  setText(title, `${chart.title}: ${chart.series.map((one) => `${one.label} from ${number(Math.min(...finite(one.values)), 3)} to ${number(Math.max(...finite(one.values)), 3)} ${unitText(one.unit || "")}`).join("; ")}`);
  node.cursor = (position) => {
    const inside = position !== null && x.length > 1;
    const slack = SLACK * (x1 - x0);
    const shown = inside && angular ? x0 + ((((position - x0 + slack) % 360) + 360) % 360) - slack : position;
    const seen = inside && shown >= x0 - slack && shown <= x1 + slack;
    cursor.setAttribute("visibility", seen ? "inherit" : "hidden");
    if (seen) {
      cursor.setAttribute("x1", px(shown).toFixed(1));
      cursor.setAttribute("x2", px(shown).toFixed(1));
    }
  };
}

const short = (value) => (Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3) ? value.toExponential(0) : String(Number(value.toPrecision(6)))).replace("-", "−");

// Charts of a panel; returns a function that moves their cursors to a position of the drive.
export function drawCharts(parent, charts) {
  keyed(parent, charts, (one) => one.title, build, update);
  return (position) => {
    for (const node of parent.children) {
      node.cursor?.(position);
    }
  };
}
