"use strict";
(() => {
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const motion = read("motion-data");
  const charts = read("chart-data");
  const cursors = [];

  // --- points of a chart that can be picked: under the pointer, with a click, with a slider ------------------------------------
  function pick(place, picks, number) {
    const slider = document.getElementById("pick-" + number);
    const panel = slider.closest(".picked");
    const told = panel.querySelector("output");
    const cells = [...panel.querySelectorAll("[data-pick]")];
    const mark = place.data.length - 1; // the last curve of such a chart is the mark of the picked point
    let drawn = false;
    let wanted = picks.first;
    const put = () => {
      if (drawn) {
        return; // one drawing at a time, of the latest wish
      }
      drawn = true;
      const index = wanted;
      Plotly.restyle(place, { x: [[picks.x[index]]], y: [[picks.y[index]]] }, [mark]).then(() => {
        drawn = false;
        if (wanted !== index) {
          put();
        }
      });
    };
    const show = (index) => {
      wanted = index;
      cells.forEach((cell, k) => {
        cell.textContent = picks.rows[index][k];
      });
      told.textContent = `${index + 1} of ${picks.rows.length}`;
      slider.value = String(index);
      slider.setAttribute("aria-valuetext", told.textContent);
      put();
    };
    const found = (event) => {
      const point = event.points.find((one) => Number.isInteger(one.customdata));
      if (point && point.customdata !== wanted) {
        show(point.customdata);
      }
    };
    place.on("plotly_hover", found);
    place.on("plotly_click", found);
    slider.addEventListener("input", () => show(Number(slider.value)));
  }

  // --- charts ---------------------------------------------------------------------------------------------------------------
  // these buttons and no others: the library has some that send a chart to its makers
  const buttons = [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]];
  const narrow = matchMedia("(max-width: 600px)").matches; // no room for buttons beside the names of the curves
  const config = { displaylogo: false, responsive: true, modeBarButtons: buttons, displayModeBar: narrow ? false : "hover" };
  const places = charts.map((chart, index) => {
    const place = document.getElementById("chart-" + (index + 1));
    Plotly.newPlot(place, chart.figure.data, chart.figure.layout, config);
    if (chart.picks) {
      pick(place, chart.picks, index + 1);
    }
    if (chart.cranked) {
      const cursor = document.createElement("div");
      cursor.className = "cursor";
      place.appendChild(cursor);
      cursors.push({ place, cursor });
      place.on("plotly_afterplot", () => follow());
    }
    return place;
  });
  // paper has a width of its own: charts are drawn anew for it
  addEventListener("beforeprint", () => places.forEach((place) => Plotly.relayout(place, { width: 680, autosize: false })));
  addEventListener("afterprint", () => places.forEach((place) => Plotly.relayout(place, { width: null, autosize: true })));

  // --- the moving linkage -----------------------------------------------------------------------------------------------------
  const stage = document.querySelector(".stage");
  if (!stage || !motion) {
    return;
  }
  const byName = (selector, key) => {
    const found = new Map();
    for (const node of stage.querySelectorAll(selector)) {
      const name = node.dataset[key];
      found.set(name, [...(found.get(name) || []), node]);
    }
    return found;
  };
  const bodies = byName("[data-body]", "body");
  const points = byName("[data-point]", "point");
  const springs = byName("[data-spring]", "spring");
  const slider = document.getElementById("crank");
  const angle = document.getElementById("crank-angle");
  const play = document.getElementById("play");
  const figures = [...document.querySelectorAll("[data-readout]")];
  const stops = motion.slider;
  const last = stops.values.length - 1;
  let at = 0;

  function follow() {
    const here = stops.values[at];
    for (const { place, cursor } of cursors) {
      const layout = place._fullLayout;
      const axis = layout && layout.xaxis;
      if (!axis || !axis.range) {
        continue;
      }
      const [low, high] = axis.range[0] < axis.range[1] ? axis.range : [axis.range[1], axis.range[0]];
      const shown = stops.turn ? here - stops.turn * Math.floor((here - low) / stops.turn + 1e-9) : here;
      const inside = shown >= low - 1e-6 && shown <= high + 1e-6;
      cursor.style.display = inside ? "block" : "none";
      if (inside) {
        cursor.style.left = axis._offset + axis.d2p(shown) + "px";
        cursor.style.top = layout._size.t + "px";
        cursor.style.height = layout._size.h + "px";
      }
    }
  }

  function show(index) {
    at = index;
    for (const [name, pose] of Object.entries(motion.bodies)) {
      for (const node of bodies.get(name) || []) {
        node.setAttribute("transform", `translate(${pose.x[at]} ${pose.y[at]}) rotate(${pose.a[at]})`);
      }
    }
    for (const [name, place] of Object.entries(motion.points)) {
      for (const node of points.get(name) || []) {
        node.setAttribute("transform", `translate(${place.x[at]} ${place.y[at]})`);
      }
    }
    for (const [name, ends] of Object.entries(motion.springs)) {
      const [x, y, dx, dy] = [ends.x[at], ends.y[at], ends.u[at] - ends.x[at], ends.v[at] - ends.y[at]];
      const length = Math.max(Math.hypot(dx, dy), 1e-30);
      const line = motion.zigzag.map(
        ([share, side]) => `${x + share * dx + (side * dy) / length} ${y + share * dy - (side * dx) / length}`
      );
      for (const node of springs.get(name) || []) {
        node.setAttribute("d", "M" + line.join("L"));
      }
    }
    figures.forEach((node, k) => {
      const value = motion.readouts[k].values[at];
      node.textContent = value === null ? "–" : value.toFixed(motion.readouts[k].decimals).replace("-", "−");
    });
    angle.textContent = stops.values[at].toFixed(stops.decimals).replace("-", "−") + stops.unit;
    slider.value = String(at);
    slider.setAttribute("aria-valuetext", angle.textContent);
    follow();
  }

  let timer = null;
  let way = 1;
  let due = 0;
  const stop = () => {
    cancelAnimationFrame(timer);
    timer = null;
    play.textContent = "▶ Play";
    play.setAttribute("aria-pressed", "false");
  };
  const step = (now) => {
    if (now >= due) {
      due = now + 1000 / 75;
      let next = at + way;
      if (motion.closed) {
        next = (next + last) % last;
      } else if (next < 0 || next > last) {
        way = -way;
        next = at + way;
      }
      show(Math.min(Math.max(next, 0), last));
    }
    timer = requestAnimationFrame(step);
  };
  play.addEventListener("click", () => {
    if (timer === null) {
      play.textContent = "❚❚ Pause";
      play.setAttribute("aria-pressed", "true");
      timer = requestAnimationFrame(step);
    } else {
      stop();
    }
  });
  slider.addEventListener("input", () => {
    if (timer !== null) {
      stop();
    }
    show(Number(slider.value));
  });
  for (const box of document.querySelectorAll("[data-toggle]")) {
    box.addEventListener("change", () => {
      for (const layer of stage.querySelectorAll(`[data-layer="${box.dataset.toggle}"]`)) {
        layer.style.display = box.checked ? "" : "none";
      }
    });
  }
  show(0);
})();
