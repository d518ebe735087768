// Sliders of the linkages in a notebook: each finds its own drawing and data, so that several results share a page.
for (const place of document.querySelectorAll(".optlink-motion:not([data-ready])")) {
  place.dataset.ready = "";
  const motion = JSON.parse(place.dataset.motion);
  const pose = optlinkPose(place, motion);
  const slider = place.querySelector("input");
  const [angle, ...figures] = place.querySelectorAll("output");
  const text = (value, decimals) => {
    if (value === null) return "–";
    const shown = value.toFixed(decimals);
    return Number(shown) === 0 ? shown.replace("-", "") : shown.replace("-", "−");
  };
  slider.addEventListener("input", () => {
    const at = Number(slider.value);
    pose(at);
    angle.textContent = text(motion.slider.values[at], motion.slider.decimals) + motion.slider.unit;
    figures.forEach((node, k) => {
      node.textContent = text(motion.readouts[k].values[at], motion.readouts[k].decimals);
    });
  });
  place.querySelector(".optlink-controls").hidden = false;
}
