// The picture: regions and walls in the plane of K and B as SVG, whose colours are the page's.
"use strict";

const SVG = "http://www.w3.org/2000/svg";
const MARGINS = { left: 62, right: 30, top: 14, bottom: 42 };
const NICE_ENDS = [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10];
const NICE_STEPS = [1, 2, 2.5, 5, 10];
const LARGEST_SHARE = 1e3; // of a final position
const FARTHEST = 2000; // times the frame: a pixel still has its place in float32
const FARTHEST_WALL = 4; // times the region: walls beyond are drawn at the edge
const IN_DIGITS = new Intl.NumberFormat("en", { maximumSignificantDigits: 4 }); // made once: making one takes longer than a picture

/** A new element of SVG with attributes. */
function element(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

/** The next round number away from 0, so that axes stay while a slider moves a little. */
function niceEnd(value) {
  if (!(Math.abs(value) > 0) || !Number.isFinite(value)) return 0;
  const power = 10 ** Math.floor(Math.log10(Math.abs(value)));
  const end = NICE_ENDS.find((one) => one * power >= Math.abs(value) * 0.999999) * power;
  return Math.sign(value) * end;
}

/** Places of ticks from low to high, about so many. */
function ticksOf(low, high, about) {
  const rough = (high - low) / about, power = 10 ** Math.floor(Math.log10(rough));
  const step = NICE_STEPS.find((one) => one * power >= rough) * power, ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) ticks.push(k * step);
  return ticks;
}

/** The ends of both axes around some points (K, B) and the origin. */
function windowAround(points) {
  const { low, high } = extentOf([...points, [0, 0]]);
  return [0, 1].map((axis) => {
    const end = niceEnd(high[axis] * 1.06) || 1, start = niceEnd(low[axis] * 1.06);
    return start < -0.04 * end ? [start, end] : [-0.04 * end, end];
  });
}

/** How points (K, B) become pixels of a frame. */
function frameOf(ends, box) {
  const [[left, right], [bottom, top]] = ends;
  const x = (stiffness) => box.x + (box.width * (stiffness - left)) / (right - left);
  const y = (damping) => box.y + (box.height * (top - damping)) / (top - bottom);
  return { ends, box, x, y };
}

/** The outline of points (K, B) in a frame, as SVG has it. */
function pathOf(frame, points, isClosed = true) {
  const finite = points.filter(([stiffness, damping]) => Number.isFinite(stiffness + damping));
  const parts = finite.map(([stiffness, damping]) =>
    `${near(frame.x(stiffness), frame.box.x, frame.box.width)} ${near(frame.y(damping), frame.box.y, frame.box.height)}`);
  return parts.length ? `M${parts.join("L")}${isClosed ? "Z" : ""}` : "";
}

/** A pixel, not so far away that the browser's own numbers end. */
function near(pixel, start, size) {
  return Math.min(start + FARTHEST * size, Math.max(start - FARTHEST * size, pixel)).toFixed(1);
}

/** Draw the plane: see picture() of page.js for what is in a scene. */
function drawPlane(svg, view) {
  const { width, height } = view.size;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const box = {
    x: MARGINS.left, y: MARGINS.top,
    width: width - MARGINS.left - MARGINS.right, height: height - MARGINS.top - MARGINS.bottom,
  };
  const frame = frameOf(view.ends, box);
  const inner = element("g", { "clip-path": "url(#frame)", "aria-hidden": "true" });
  const clip = element("clipPath", { id: "frame" });
  clip.append(element("rect", box));
  drawParts(inner, frame, view);
  const parts = [clip, axesOf(frame, view), inner, cursorOf(frame, view), wallsOf(frame, view)];
  if (view.stiffest) parts.push(peakOf(frame, view));
  if (view.isMapNeeded) parts.push(mapOf(frame, view));
  svg.replaceChildren(svg.querySelector("title"), ...parts);
  return frame;
}

/** Regions and rules, the largest first. */
function drawParts(group, frame, view) {
  if (view.oneSample) group.append(element("path", { class: "ghost", d: pathOf(frame, view.oneSample) }));
  for (const points of view.islands) group.append(element("path", { class: "island", d: pathOf(frame, points) }));
  for (const points of view.main) group.append(element("path", { class: "stable", d: pathOf(frame, points) }));
  if (view.passive.length) group.append(element("path", { class: "passive", d: pathOf(frame, view.passive) }));
  group.append(element("path", { class: "rule", d: pathOf(frame, view.rule, false) }));
}

let axes = { key: "", group: null }; // as they were last drawn

/** The axes; the same element as before where nothing of them has moved: text takes longest to lay out. */
function axesOf(frame, view) {
  const key = JSON.stringify([frame.box, frame.ends, view.units]);
  if (axes.key !== key) axes = { key, group: drawnAxes(frame, view) };
  return axes.group;
}

/** Grid, ticks, their numbers and the names of the axes. */
function drawnAxes(frame, view) {
  const { box, ends } = frame, group = element("g", { "aria-hidden": "true" });
  const bottom = box.y + box.height;
  for (const tick of ticksOf(...ends[0], box.width / 90)) {
    const x = frame.x(tick);
    group.append(element("path", { class: tick === 0 ? "axis" : "grid", d: `M${x} ${box.y}V${bottom}` }));
    group.append(element("text", { class: "quiet", x, y: bottom + 17, "text-anchor": "middle" }, short(tick)));
  }
  for (const tick of ticksOf(...ends[1], box.height / 55)) {
    const y = frame.y(tick);
    group.append(element("path", { class: tick === 0 ? "axis" : "grid", d: `M${box.x} ${y}H${box.x + box.width}` }));
    group.append(element("text", { class: "quiet", x: box.x - 7, y: y + 4, "text-anchor": "end" }, short(tick)));
  }
  group.append(element("text", { x: box.x + box.width, y: bottom + 36, "text-anchor": "end" }, `stiffness K (${view.units.stiffness})`));
  const turned = { transform: `translate(14 ${box.y}) rotate(-90)`, "text-anchor": "end" };
  group.append(element("text", turned, `damping B (${view.units.damping})`));
  return group;
}

/** A number as people write it. */
function short(value) {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-3) return Number(value.toPrecision(4)).toExponential(); // its zeros would not fit beside an axis
  return IN_DIGITS.format(value);
}

/** The pixel of a wall's mark, which stays within the frame. */
function markOf({ box, x, y }, [stiffness, damping]) {
  return [
    Math.min(box.x + box.width - 8, Math.max(box.x + 8, x(stiffness))),
    Math.min(box.y + box.height - 8, Math.max(box.y + 8, y(damping))),
  ];
}

/** The user's walls: a disc where stable, a cross where not, a square where that is undecided. */
function wallsOf(frame, view) {
  const group = element("g", { "aria-hidden": "true" }), { box } = frame;
  for (const { name, stiffness, damping, code } of view.walls) {
    const [x, y] = markOf(frame, [stiffness, damping]);
    const isBeyond = Math.abs(x - frame.x(stiffness)) + Math.abs(y - frame.y(damping)) > 1;
    if (code === STABLE) group.append(element("circle", { class: "wall-good", cx: x, cy: y, r: 6 }));
    else if (code === UNSTABLE) group.append(element("path", { class: "wall-bad", d: `M${x - 5} ${y - 5}l10 10m0 -10l-10 10` }));
    else group.append(element("rect", { class: "cursor", x: x - 5, y: y - 5, width: 10, height: 10 }));
    const isRight = x > box.x + 0.7 * box.width;
    const at = { class: "halo", x: isRight ? x - 10 : x + 10, y: y - 7, "text-anchor": isRight ? "end" : "start" };
    group.append(element("text", at, isBeyond ? `${name} (beyond)` : name));
  }
  return group;
}

/** The stiffest stable wall, with its number. */
function peakOf(frame, { stiffest, stiffestInWords }) {
  const x = frame.x(stiffest[0]), y = frame.y(stiffest[1]);
  const group = element("g", { "aria-hidden": "true" });
  group.append(element("path", { class: "peak", d: `M${x} ${y}l-9 -6v12Z` }));
  const isRight = x > frame.box.x + 0.75 * frame.box.width;
  const at = { class: "halo", x: isRight ? x - 14 : x + 6, y: y + 4, "text-anchor": isRight ? "end" : "start" };
  group.append(element("text", at, stiffestInWords));
  return group;
}

/** Cross hairs at the cursor. */
function cursorOf(frame, view) {
  const { box } = frame, [stiffness, damping] = view.cursor;
  const x = frame.x(stiffness), y = frame.y(damping);
  const group = element("g", { class: "cursor", "clip-path": "url(#frame)", "aria-hidden": "true" });
  group.append(element("path", { "stroke-dasharray": "2 4", d: `M${x} ${box.y}V${box.y + box.height}M${box.x} ${y}H${box.x + box.width}` }));
  group.append(element("circle", { cx: x, cy: y, r: 5 }));
  return group;
}

/** A small map at one scale: the region beside that of the difference over one sample, where it hides no wall. */
function mapOf(frame, view) {
  const width = Math.min(190, 0.42 * frame.box.width), height = 0.62 * width;
  const group = element("g", { "aria-hidden": "true" }), left = frame.box.x + frame.box.width - width - 8;
  const marks = [view.stiffest, ...view.walls.map(({ stiffness, damping }) => [stiffness, damping])].map((wall) => markOf(frame, wall));
  const isFree = (top) => !marks.some(([x, y]) => x > left - 10 && y > top - 10 && y < top + height + 24);
  const y = [frame.box.y + 8, frame.box.y + frame.box.height - height - 8].find(isFree);
  if (y === undefined) return group;
  const box = { x: left, y, width, height };
  group.append(element("rect", { class: "back", ...box, rx: 4 }));
  const inner = { x: box.x + 8, y: box.y + 22, width: width - 16, height: height - 30 };
  const map = frameOf(windowAround([...view.oneSample, ...view.main.flat()]), inner);
  group.append(element("path", { class: "ghost", d: pathOf(map, view.oneSample) }));
  for (const points of view.main) group.append(element("path", { class: "stable", d: pathOf(map, points) }));
  group.append(element("text", { x: box.x + 8, y: box.y + 16 }, "same scale"));
  return group;
}

/** Draw shares of a final position beside the band of 2 %; what grows is drawn while it is small. */
function drawResponse(svg, every, period) {
  const beyond = every.findIndex((share) => !(Math.abs(share) < LARGEST_SHARE));
  const shares = every.slice(0, beyond < 0 ? every.length : Math.max(2, beyond)).map((one) => one || 0);
  const { width, height } = svg.getBoundingClientRect();
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const box = { x: 30, y: 8, width: width - 38, height: height - 28 };
  const largest = shares.reduce((most, share) => Math.max(most, Math.abs(share)), 1.2);
  const end = Math.min(largest * 1.05, 3);
  const frame = frameOf([[0, shares.length - 1], [Math.min(0, Math.max(-1, Math.min(...shares))), end]], box);
  const points = Array.from(shares, (share, k) => [k, share]);
  const band = { class: "band", x: box.x, y: frame.y(1 + LEVEL), width: box.width, height: frame.y(1 - LEVEL) - frame.y(1 + LEVEL) };
  const parts = [element("rect", band), element("path", { class: "trace", d: pathOf(frame, points, false) })];
  for (const share of [0, 1]) {
    parts.push(besideAxis(box, frame.y(share), String(share)));
  }
  parts.push(belowEnd(box, height, `${short(rounded((shares.length - 1) * period * 1e3, 3))} ms`));
  svg.replaceChildren(svg.querySelector("title"), ...parts);
}

/** A number beside the vertical axis. */
function besideAxis(box, y, words) {
  return element("text", { class: "quiet", x: box.x - 6, y: y + 4, "text-anchor": "end" }, words);
}

/** The last time, below the end of the horizontal axis. */
function belowEnd(box, height, words) {
  return element("text", { class: "quiet", x: box.x + box.width, y: height - 6, "text-anchor": "end" }, words);
}

/** Draw positions at samples over time: the lowest and the highest of each pixel's width. */
function drawContact(svg, positions, period) {
  const { width, height } = svg.getBoundingClientRect(), title = svg.querySelector("title");
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  if (!positions.length) return svg.replaceChildren(title);
  const box = { x: 52, y: 8, width: width - 60, height: height - 28 };
  const points = thinned(positions, Math.ceil(box.width)).map(([k, position]) => [k * period, position * 1e3]);
  const { low, high } = extentOf([...points, [0, 0]]), room = 0.06 * (high[1] - low[1]) || 1;
  const frame = frameOf([[0, (positions.length - 1) * period], [low[1] - room, high[1] + room]], box);
  const parts = ticksOf(...frame.ends[1], 3).flatMap((tick) => {
    const y = frame.y(tick), line = { class: tick === 0 ? "axis" : "grid", d: `M${box.x} ${y}H${box.x + box.width}` };
    return [element("path", line), besideAxis(box, y, short(tick))];
  });
  parts.push(element("path", { class: "trace", d: pathOf(frame, points, false) }));
  parts.push(belowEnd(box, height, `${short(rounded(frame.ends[0][1], 3))} s`));
  return svg.replaceChildren(title, ...parts);
}

/** Samples with their positions; where they are many, the lowest and highest of so many columns. */
function thinned(positions, columns) {
  const all = Array.from(positions, (position, k) => [k, position]), most = Math.ceil(all.length / columns);
  if (most <= 2) return all;
  return Array.from({ length: Math.ceil(all.length / most) }, (_, column) => {
    const own = all.slice(column * most, (column + 1) * most);
    const low = own.reduce((a, b) => (b[1] < a[1] ? b : a)), high = own.reduce((a, b) => (b[1] > a[1] ? b : a));
    return low[0] < high[0] ? [low, high] : [high, low];
  }).flat();
}
