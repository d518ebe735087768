"use strict";
// Moves the drawing of a linkage: optlinkPose(stage, motion)(index) puts its bodies, points and springs at a position.
function optlinkPose(stage, motion) {
  const byName = (key) => {
    const found = new Map();
    for (const node of stage.querySelectorAll(`[data-${key}]`)) {
      found.set(node.dataset[key], [...(found.get(node.dataset[key]) || []), node]);
    }
    return found;
  };
  const [bodies, points, springs, names] = ["body", "point", "spring", "name"].map(byName);
  return (at) => {
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
    for (const [name, { x, y, side }] of Object.entries(motion.names)) {
      const k = parseInt(side[at], 36);
      for (const node of names.get(name) || []) {
        node.setAttribute("transform", `translate(${x[k]} ${y[k]})`);
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
  };
}
