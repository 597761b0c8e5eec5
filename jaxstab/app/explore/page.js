// The page: controls that move the state, and what is drawn and said of it.
"use strict";

const QUIET = 150; // ms without a change, until what takes longer is computed
const LOOKS_IN_MOTION = 1; // at a region, while a slider moves; what that leaves open is resolved after
const initial = JSON.parse(document.getElementById("initial").textContent);
const asked = stateOfHash(location.hash.slice(1), initial.state);
let state = isComputable(setupOf(asked)) ? asked : initial.state;
let drawn = null; // setup, loop, region and frame of the picture
let size = { width: 0, height: 0 }; // of the picture
let waiting = 0;

// ----------------------------------------------------------------------------------------- drawing

/** Change the state unless it is refused for a reason, which is shown, and show it. */
function update(changes, moved, refusal = "") {
  const next = { ...state, ...changes }, why = refusal || whyRefused(setupOf(next));
  if (!why) state = next;
  assign(byId("refusal"), "textContent", why && `Not applied: ${why}; the last values that work are kept.`);
  draw(LOOKS_IN_MOTION);
  showState(moved);
  clearTimeout(waiting);
  waiting = setTimeout(sayMore, QUIET);
}

/** Show the state in the controls. */
function showState(moved) {
  for (const quantity of quantitiesOf(state.motion)) showIn(quantity, state[quantity.key], moved);
  for (const quantity of cursorQuantities()) showIn(quantity, state[quantity.key], moved);
  const software = softwareOf(state);
  assign(byId("software"), "value", software < 0 ? "" : String(software));
  const setup = setupOf(state), rate = 1 / state.period;
  const late = `${short(rounded(state.delay * state.period * 1e3, 3))} ms`;
  assign(byId("controller-hint"), "textContent", `${short(rate)} Hz; a delay of ${late}`);
  assign(byId("velocity-hint"), "textContent", estimatorInWords(setup));
  assign(byId("contact-on"), "checked", state.contact === "on");
  assign(byId("contact-controls"), "hidden", state.contact === "off");
  document.querySelectorAll("[name=view]").forEach((one) => {
    assign(one, "checked", one.value === state.view);
    assign(one, "disabled", one.value === "sample" && isPlain(setup));
  });
}

/** How the velocity is estimated, in words. */
function estimatorInWords({ estimator, period }) {
  const { window, cutoff, order, kind, factor, numerator } = estimator;
  if (numerator) return "a transfer function of the scene or the software";
  const time = `${short(rounded(window * period * 1e3, 3))} ms`;
  const parts = [window === 1 ? "the difference over one sample" : `the difference over ${window} samples, ${time}`];
  if (cutoff > 0) parts.push(`a ${kind === "butterworth" ? "Butterworth filter" : "low pass"} at ${short(rounded(cutoff, 3))} Hz of order ${order}`);
  if (factor > 0 && factor < 1) parts.push(`smoothing by ${factor}`);
  return parts.join(", ");
}

/** The outlines of components, in N/m and N s/m. */
function outlinesOf(components, { stiffness, damping }) {
  return components.map(({ points }) => points.map(([a, b]) => [a * stiffness, b * damping]));
}

/** All that is computed of a setup for the picture, with so many looks at its regions. */
function computed(setup, looks) {
  const loop = loopOf(setup), region = regionOf(loop, looks), scale = unitsOf(setup);
  const main = mainOf(region), rest = region.components.filter((one) => one !== main);
  const other = isPlain(setup) ? { isClosed: true, sample: null } : oneSampleOf(setup, looks);
  const best = main && farthest(loop, main, 0), printed = best && printedWall(loop, scale, best, region.isClosed);
  return {
    setup, loop, region, scale, plain: other.sample,
    isRough: looks < LOOKS && !(region.isClosed && other.isClosed),
    main: outlinesOf(main ? [main] : [], scale),
    islands: outlinesOf(rest, scale),
    stiffest: printed && [best[0] * scale.stiffness, best[1] * scale.damping],
    printed,
  };
}

/** The region that the difference over one sample would have. */
function oneSampleOf(setup, looks) {
  const other = withOneSample(setup), loop = loopOf(other), scale = unitsOf(other);
  const region = regionOf(loop, looks), main = mainOf(region), { isClosed } = region;
  if (!main) return { isClosed, sample: null };
  const [alpha] = farthest(loop, main, 0), outline = outlinesOf([main], scale)[0];
  return { isClosed, sample: { outline, stiffness: alpha * scale.stiffness } };
}

/** The points that the axes hold. */
function pointsInView({ main, islands, plain }) {
  const region = state.view === "near" && main.length ? main.flat() : [...main.flat(), ...islands.flat()];
  const sample = state.view === "sample" && plain ? plain.outline : [];
  const points = [...region, ...sample];
  const most = extentOf([...points, [0, 0]]).high.map((end) => FARTHEST_WALL * end);
  const walls = state.walls.map(({ stiffness, damping }) => [stiffness, damping]);
  return [...points, ...walls.filter((wall) => wall.every((gain, axis) => gain <= most[axis]))];
}

/** Compute and draw the picture, and what stands beside it. */
function draw(looks = LOOKS) {
  const now = computed(setupOf(state), looks), { setup, loop, scale, plain } = now;
  const ends = windowAround(pointsInView(now));
  const walls = state.walls.map((wall) => ({ ...wall, ...factsAtOnce(loop, scale, wall) }));
  const rule = linearRule(setup, ends[0]);
  const view = {
    size, ends, rule, walls, units: units(), main: now.main, islands: now.islands,
    passive: passiveWalls(setup), oneSample: plain && plain.outline,
    cursor: [state.cursorStiffness, state.cursorDamping],
    stiffest: now.stiffest, stiffestInWords: now.printed && stiffnessInWords(now.printed[0]),
  };
  view.isMapNeeded = state.view === "near" && Boolean(plain && now.stiffest && plain.stiffness > 1.5 * ends[0][1]);
  const frame = drawPlane(byId("picture"), view);
  drawn = { ...now, frame, walls };
  sayHeadline(now);
  showLegend(now, view);
  showVerdicts(walls);
  showCursorVerdict(factsAtOnce(loop, scale, cursorWall()));
}

function cursorWall() {
  return { stiffness: state.cursorStiffness, damping: state.cursorDamping };
}

/** Verdict and radius of a wall. */
function factsAtOnce(loop, scale, { stiffness, damping }) {
  return verdictAndRadius(loop, stiffness / scale.stiffness, damping / scale.damping);
}

// ----------------------------------------------------------------------------------- after a pause

/** Compute and show what takes longer: margins, settling, the link, the scene. */
function sayMore() {
  if (drawn.isRough) draw();
  const { setup, loop, region } = drawn, facts = wallFacts(setup, loop, region, cursorWall());
  showFacts(facts);
  if (state.contact === "on") showContact();
  else showResponse(facts);
  const hash = `#${hashOf(state)}`;
  byId("link").href = hash;
  if (location.hash !== hash) history.replaceState(null, "", hash);
  byId("scene").textContent = sceneOf(state);
  const stable = drawn.walls.filter(({ code }) => code === STABLE).length;
  byId("status").textContent =
    `${byId("headline").textContent} ${stable} of ${drawn.walls.length} walls are stable. Cursor: ${byId("cursor-verdict").textContent}. ${byId("contact-verdict").textContent}`;
}

/** Show margins and settling of the cursor. */
function showFacts(facts) {
  const rows = facts.code === STABLE ? rowsOfFacts(facts) : [["margins", "none: the wall is not stable"]];
  byId("cursor-facts").replaceChildren(...rows.flatMap(([term, text]) =>
    [html("dt", { textContent: term }), html("dd", { textContent: text })]));
}

function rowsOfFacts({ stiffness, damping, extraDelay, settling, island }) {
  const range = (limits, unit) => (Number.isFinite(limits[1]) ? rangeInWords(limits, unit) : "not found");
  const factor = (high, own) => (own > 0 && high > own ? ` (× ${inDigits(rounded(high / own, 3, -1))})` : "");
  const late = Number.isFinite(extraDelay)
    ? `${inDigits(rounded(extraDelay * 1e3, 3, -1))} ms`
    : `more than ${MOST_DELAY} samples`;
  const settled = Number.isFinite(settling) ? `${short(rounded(settling * 1e3, 4))} ms` : "longer than is looked at";
  const rows = [
    ["stable for K", range(stiffness, units().stiffness) + factor(stiffness[1], state.cursorStiffness)],
    ["stable for B", range(damping, units().damping) + factor(damping[1], state.cursorDamping)],
    ["extra delay", late],
    ["settles to 2 % in", settled],
  ];
  if (island) rows.push(["note", "on an island: turning gains up from 0 leads through unstable walls"]);
  return rows;
}

/** Draw how the device moves at the cursor. */
function showResponse({ code, settling }) {
  const { setup, scale } = drawn;
  const alpha = state.cursorStiffness / scale.stiffness, beta = state.cursorDamping / scale.damping;
  const wanted = code === STABLE && settling > 0 ? (1.5 * settling) / setup.period : RESPONSE_SAMPLES;
  const samples = Math.round(Math.min(4000, Math.max(40, wanted)));
  drawResponse(byId("response"), responseOf(setup, alpha, beta, samples), setup.period);
  byId("response-title").textContent = code === STABLE ? "The response to a push comes to rest." : "The response to a push.";
  byId("response-caption").textContent = "Position after a constant push, as a share of its final value, with the 2 % band.";
  byId("contact-verdict").textContent = "";
}

/** Simulate the contact with the cursor's wall; draw it, and say how it ends. */
function showContact() {
  const { setup } = drawn, wall = cursorWall(), { friction, push, encoder, speed } = state;
  const conditions = { friction, push, encoder }, why = whyNoContact(setup, wall, conditions);
  const contact = why ? null : worstContactOf(setup, wall, conditions, [...new Set([0, speed])]);
  const words = why || contactInWords(contact);
  drawContact(byId("response"), contact ? startOf(contact, setup, wall) : [], setup.period);
  byId("contact-verdict").textContent = words;
  byId("response-title").textContent = words;
  byId("response-caption").textContent =
    `Simulated position in ${smallUnit()} over time, pushed from the wall's surface, which is at 0; simulated for ${DURATION} s.`;
}

/** The positions that are drawn: a little beyond rest, and what grows while it is small. */
function startOf({ kind, timeToRest, positions }, { handStiffness, period }, { stiffness }) {
  if (kind === "rests") return positions.slice(0, Math.max(40, Math.round((1.5 * timeToRest) / period)));
  const most = LARGEST_SHARE * Math.abs(state.push / (stiffness + handStiffness));
  const beyond = positions.findIndex((position) => !(Math.abs(position) < most));
  return beyond < 0 ? positions : positions.slice(0, Math.max(2, beyond));
}

// ------------------------------------------------------------------------------------------- start

/** Put the cursor where the picture is touched. */
function pointAt(event) {
  const { box, ends } = drawn.frame, frame = byId("picture").getBoundingClientRect();
  const across = (event.clientX - frame.left - box.x) / box.width;
  const up = 1 - (event.clientY - frame.top - box.y) / box.height;
  if (across < 0 || across > 1 || up < 0 || up > 1) return;
  const gain = ([low, high], share) => rounded(low + share * (high - low), 4);
  update({ cursorStiffness: gain(ends[0], across), cursorDamping: gain(ends[1], up) });
}

/** Take the size of the picture; return whether it has changed. */
function measure() {
  const { width, height } = byId("picture").getBoundingClientRect(), before = size;
  size = { width, height };
  return width !== before.width || height !== before.height;
}

/** Compute pictures that are not drawn, while nothing else is to do: so the scripts are compiled. */
function warmUp() {
  for (const factor of [0.5, 0.7, 0.9, 1.1, 1.4, 2]) {
    for (const key of ["mass", "period", "delay", "window"]) {
      const value = acceptable(key, state[key] * factor);
      const other = setupOf({ ...state, [key]: value });
      whenIdle(() => Number.isFinite(value) && isComputable(other) && computed(other, LOOKS_IN_MOTION));
    }
  }
}

function whenIdle(work) {
  if (window.requestIdleCallback) window.requestIdleCallback(work);
}

function start() {
  byId("source").textContent = initial.notes.join(" ");
  document.querySelectorAll(".stiffness-unit").forEach((one) => (one.textContent = `(${units().stiffness})`));
  document.querySelectorAll(".damping-unit").forEach((one) => (one.textContent = `(${units().damping})`));
  buildControls();
  buildCursor();
  buildContact();
  const picture = byId("picture");
  picture.addEventListener("pointerdown", pointAt);
  picture.addEventListener("pointermove", (event) => event.buttons & 1 && pointAt(event));
  for (const form of document.forms) form.addEventListener("submit", (event) => event.preventDefault());
  byId("wall-form").addEventListener("submit", () => {
    const name = nameOf(byId("wall-name").value.trim());
    const walls = state.walls.filter((wall) => wall.name !== name);
    update({ walls: [...walls, { name, ...cursorWall() }] });
  });
  byId("views").addEventListener("change", (event) => update({ view: event.target.value }));
  new ResizeObserver(() => measure() && update({})).observe(picture);
  window.addEventListener("hashchange", () => update(stateOfHash(location.hash.slice(1), initial.state)));
  document.documentElement.classList.toggle("framed", window !== window.top);
  measure();
  update(asked);
  warmUp();
}

start();
