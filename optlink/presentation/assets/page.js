(() => {
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const motion = read("motion-data");
  const { charts, dark: colours } = read("chart-data");
  const cursors = [];
  const places = [];
  let follow = () => {};

  // --- light and dark -------------------------------------------------------------------------------------------------------
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");
  const toggle = document.getElementById("theme");
  const remembered = (value) => {
    try {
      return value ? localStorage.setItem("optlink-theme", value) : localStorage.getItem("optlink-theme");
    } catch {
      return null; // no storage for this page
    }
  };
  const isDark = () => root.dataset.theme === "dark";
  const swapped = (part, dark) => JSON.parse(JSON.stringify(part).replace(/#[0-9a-fA-F]{6}/g, (one) => (dark && colours[one]) || one));
  const paint = (dark) =>
    places.forEach((place, k) => {
      const { data, layout } = swapped(charts[k].figure, dark);
      if (charts[k].picks) {
        Object.assign(data[data.length - 1], { x: place.data[data.length - 1].x, y: place.data[data.length - 1].y });
      }
      Plotly.react(place, data, layout, config);
    });
  const use = (theme) => {
    root.dataset.theme = theme;
    toggle.textContent = isDark() ? "Light" : "Dark";
    toggle.setAttribute("aria-label", `Use ${toggle.textContent.toLowerCase()} colours`);
    paint(isDark());
  };
  const preferred = () => remembered() || (system.matches ? "dark" : "light");
  toggle.hidden = false;
  toggle.addEventListener("click", () => {
    remembered(isDark() ? "light" : "dark");
    use(preferred());
  });
  system.addEventListener("change", () => use(preferred()));

  // --- points of a chart that can be picked: under the pointer, with a click, with a slider ------------------------------------
  function pick(place, picks, number, drawings) {
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
    const stage = document.getElementById("drawing-" + number);
    const numbers = Object.keys(drawings).map(Number);
    const show = (index) => {
      wanted = index;
      if (stage) {
        // of many points some have a drawing: the nearest of them is shown, and its description says which it is
        const near = numbers.reduce((one, other) => (Math.abs(other - index) < Math.abs(one - index) ? other : one));
        stage.innerHTML = drawings[near].replace(/#([0-9a-fA-F]{6})/g, "var(--c$1, #$1)");
      }
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
  // of labels that would overlap the first is shown; the others appear where their points are pointed at
  const clear = (place) => {
    const kept = [];
    for (const label of place.querySelectorAll(".textpoint text")) {
      const own = label.getBoundingClientRect();
      const covered = kept.some((one) => own.left < one.right && one.left < own.right && own.top + 2 < one.bottom && one.top + 2 < own.bottom);
      label.style.visibility = covered ? "hidden" : "";
      if (!covered) {
        kept.push(own);
      }
    }
  };
  const plot = (chart, index) => {
    const place = document.getElementById("chart-" + (index + 1));
    const { layout: own } = chart.figure;
    if (narrow && own.yaxis.scaleanchor) {
      own.height = Math.min(own.height, place.clientWidth); // no empty bands above and below equal scales
      place.style.minHeight = own.height + "px";
    }
    const { data, layout } = swapped(chart.figure, isDark());
    Plotly.newPlot(place, data, layout, config);
    const name = place.querySelector(".xtitle");
    if (name && name.getBoundingClientRect().right > place.getBoundingClientRect().right) {
      const words = own.xaxis.title.text.split(" "); // centred below an axis much shorter than the chart: two lines
      const half = Math.ceil(words.length / 2);
      own.xaxis.title.text = words.slice(0, half).join(" ") + "<br>" + words.slice(half).join(" ");
      Plotly.react(place, data, { ...layout, xaxis: { ...layout.xaxis, title: own.xaxis.title } }, config);
    }
    place.on("plotly_afterplot", () => clear(place));
    clear(place);
    if (chart.picks) {
      pick(place, chart.picks, index + 1, chart.drawings);
    }
    if (chart.cranked) {
      const cursor = document.createElement("div");
      cursor.className = "cursor";
      place.appendChild(cursor);
      cursors.push({ place, cursor });
      place.on("plotly_afterplot", () => follow());
    }
    place.querySelectorAll(".main-svg").forEach((drawn) => drawn.setAttribute("aria-hidden", "true")); // its label says it in words
    places.push(place);
  };
  // the library is packed in the page; the policy of the page knows its text by a hash
  const unpacked = async () => {
    if (charts.length) {
      const bytes = Uint8Array.from(atob(document.getElementById("plotly").textContent), (one) => one.charCodeAt(0));
      const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
      const library = document.createElement("script");
      library.textContent = await new Response(stream).text();
      document.head.append(library);
      library.remove();
      charts.forEach(plot);
    }
    root.dataset.ready = "";
  };
  use(preferred());
  unpacked();
  // paper is white and has a width of its own: charts are drawn anew for it
  addEventListener("beforeprint", () => {
    paint(false);
    places.forEach((place) => {
      const panels = Object.keys(place.layout).filter((key) => key.startsWith("yaxis")).length;
      const rows = place.layout.yaxis.tickvals?.length ?? 0;
      const room = rows > 8 ? 900 : panels > 2 ? 600 : 420; // two to a sheet, unless the names of the axes or rows would overlap
      Plotly.relayout(place, { width: 680, height: Math.min(place.layout.height, room), autosize: false });
    });
  });
  addEventListener("afterprint", () => {
    paint(isDark());
    places.forEach((place) => Plotly.relayout(place, { width: null, autosize: true }));
  });
  // a table that is wider than its place can be scrolled with the keys
  const reach = () => {
    for (const box of document.querySelectorAll(".scroll")) {
      const wide = box.scrollWidth > box.clientWidth + 1;
      box.toggleAttribute("tabindex", false);
      if (wide) {
        box.tabIndex = 0;
        box.setAttribute("role", "group");
        box.setAttribute("aria-label", box.querySelector("caption")?.textContent || "Table");
      }
    }
  };
  addEventListener("resize", reach);
  reach();

  // --- exact solutions as small moving pictures, one of which is chosen --------------------------------------------------------
  // the next position, and the way to it: round a closed motion, there and back through another one
  const onward = (at, way, last, closed) => {
    if (closed) {
      return [(at + way + last) % last, way];
    }
    const turned = at + way < 0 || at + way > last ? -way : way;
    return [Math.min(Math.max(at + turned, 0), last), turned];
  };
  const mover = (stage, motion) => {
    const pose = motion ? optlinkPose(stage, motion) : () => {};
    let [at, way] = [0, 1];
    return () => {
      [at, way] = motion ? onward(at, way, motion.angles_deg.length - 1, motion.closed) : [at, way];
      pose(at);
    };
  };
  for (const gallery of document.querySelectorAll(".gallery")) {
    const motions = JSON.parse(gallery.querySelector("script").textContent);
    const cards = [...gallery.querySelectorAll("li")];
    const movers = cards.map((card, k) => mover(card.querySelector(".stage"), motions[k]));
    const chosen = gallery.querySelector(".chosen");
    const large = chosen.querySelector(".stage");
    const choose = (k) => {
      cards.forEach((card, n) => card.firstElementChild.setAttribute("aria-pressed", String(n === k)));
      large.innerHTML = cards[k].querySelector(".stage").innerHTML;
      chosen.querySelector(".told").innerHTML = cards[k].lastElementChild.innerHTML;
      movers[cards.length] = mover(large, motions[k]);
    };
    cards.forEach((card, k) => card.firstElementChild.addEventListener("click", () => choose(k)));
    choose(0);
    chosen.hidden = false;
    const controls = gallery.querySelector(".controls");
    const button = controls.firstElementChild;
    controls.hidden = false;
    let [moving, visible, due] = [false, false, 0];
    const step = (now) => {
      if (moving && visible && now >= due) {
        due = now + 50;
        movers.forEach((move) => move());
      }
      requestAnimationFrame(step);
    };
    const play = (wanted) => {
      moving = wanted;
      button.textContent = moving ? "❚❚ Pause" : "▶ Play";
      button.setAttribute("aria-pressed", String(moving));
    };
    button.addEventListener("click", () => play(!moving));
    new IntersectionObserver(([entry]) => {
      visible = entry.isIntersecting;
    }).observe(gallery);
    play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
    requestAnimationFrame(step);
  }

  // --- the moving linkage -----------------------------------------------------------------------------------------------------
  const stage = document.querySelector(".linkage .stage");
  if (!stage || !motion) {
    return;
  }
  const pose = optlinkPose(stage, motion); // of motion.js
  const slider = document.getElementById("crank");
  const angle = document.getElementById("crank-angle");
  const play = document.getElementById("play");
  const figures = [...document.querySelectorAll("[data-readout]")];
  const stops = motion.slider;
  const last = stops.values.length - 1;
  let at = 0;

  follow = () => {
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
  };

  function fixed(value, decimals) {
    const text = value.toFixed(decimals);
    return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
  }

  function show(index) {
    at = index;
    pose(at);
    figures.forEach((node, k) => {
      const value = motion.readouts[k].values[at];
      node.textContent = value === null ? "–" : fixed(value, motion.readouts[k].decimals);
    });
    angle.textContent = fixed(stops.values[at], stops.decimals) + stops.unit;
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
      let next;
      [next, way] = onward(at, way, last, motion.closed);
      show(next);
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
