// The state of the page: what the controls say, as numbers in SI units, and as a link.
"use strict";

const LONGEST_WINDOW = 200; // samples, as in jaxstab
const MOST_SLIDER_WINDOW = 40;
const LONGEST_DELAY = 200; // samples
const MOST_SLIDER_DELAY = 40;
const HIGHEST_ORDER = 40; // of a low pass, as in jaxstab
const LONGEST_NAME = 64; // of a wall, as in jaxstab
const LIMIT_DIGITS = 4; // that are printed of a limit
const MOST_DIGITS = 12; // of any number
const NOTHING = 1e-9; // of another number: rounding
const TRUE = 1e-11; // 2999.9999999999 is 3000 but for rounding

/**
 * What can be moved. scale: how many of the shown units are one SI unit. map: how the place of a
 * slider gives the value: "log" from low to high, with 0 at its beginning if hasZero, "square"
 * from 0 to high, "linear" from low to high, "whole" the same in whole numbers.
 */
function quantitiesOf(motion) {
  const turns = motion === "rotation";
  const [kilogram, stiffness, damping] = turns
    ? ["kg m²", "N m/rad", "N m s/rad"]
    : ["kg", "N/m", "N s/m"];
  const moved = turns ? "inertia" : "mass";
  const ofMass = turns ? [1e-6, 0.1] : [0.01, 10];
  const ofDamping = turns ? [1e-5, 1] : [0.01, 100];
  const ofStiffness = turns ? [0.01, 1e4] : [1, 1e6];
  const [force, length] = turns ? ["N m", "rad"] : ["N", "m"];
  const ofPush = turns ? [1e-3, 10] : [0.01, 100], ofSpeed = turns ? [0.01, 100] : [1e-3, 10];
  const log = (low, high, hasZero) => ({ map: "log", low, high, hasZero, scale: 1 });
  return [
    { key: "mass", group: "device", label: moved, unit: kilogram, ...log(...ofMass, false) },
    { key: "damping", group: "device", label: "damping", unit: damping, ...log(...ofDamping, true) },
    { key: "handMass", group: "hand", label: moved, unit: kilogram, ...log(...ofMass, true) },
    { key: "handStiffness", group: "hand", label: "stiffness", unit: stiffness, ...log(...ofStiffness, true) },
    { key: "handDamping", group: "hand", label: "damping", unit: damping, ...log(...ofDamping, true) },
    { key: "period", group: "controller", label: "sampling period", unit: "ms", map: "log", low: 1e-4, high: 1e-2, scale: 1e3 },
    { key: "delay", group: "controller", label: "delay", unit: "samples", map: "square", low: 0, high: MOST_SLIDER_DELAY, scale: 1 },
    { key: "window", group: "velocity", label: "window", unit: "samples", map: "whole", low: 1, high: MOST_SLIDER_WINDOW, scale: 1 },
    { key: "cutoff", group: "velocity", label: "low pass at", unit: "Hz", map: "log", low: 5, high: 5e3, hasZero: true, isInverse: true, scale: 1 },
    { key: "friction", group: "contact", label: "friction", unit: force, ...log(...ofPush, true) },
    { key: "push", group: "contact", label: "push", unit: force, ...log(...ofPush, false) },
    { key: "speed", group: "contact", label: "speed (0: from rest only)", unit: `${length}/s`, ...log(...ofSpeed, true) },
    { key: "encoder", group: "contact", label: "encoder (0: none)", unit: length, ...log(1e-7, 1e-2, true) },
  ];
}

/** The value at a place of a slider, between 0 and 1. */
function valueAtPlace(quantity, place) {
  const { map, low, high, hasZero, isInverse } = quantity;
  const share = isInverse ? 1 - place : place; // the least effect is at the left
  if (map === "whole") return Math.round(low + share * (high - low));
  if (map === "linear") return rounded(low + share * (high - low), 4);
  if (map === "square") return Math.round(20 * high * share * share) / 20;
  if (hasZero && place === 0) return 0;
  return rounded(low * (high / low) ** share, 3);
}

/** The place of a slider for a value. */
function placeOfValue(quantity, value) {
  const { map, low, high, hasZero, isInverse } = quantity;
  let share;
  if (map === "whole" || map === "linear") share = (value - low) / (high - low);
  else if (map === "square") share = Math.sqrt(value / high);
  else if (hasZero && !(value > 0)) return 0;
  else share = Math.log(value / low) / Math.log(high / low);
  share = Math.min(1, Math.max(0, share));
  return isInverse ? 1 - share : share;
}

/** A number with so many digits: the nearest one or, with a way of 1 or -1, one not below or not above. */
function rounded(value, digits, way = 0) {
  const nearest = Number(value.toPrecision(digits)), aside = way * (value - nearest);
  if (!way || aside <= TRUE * Math.abs(value)) return nearest;
  return Number((nearest + way * unitOf(value, digits)).toPrecision(digits));
}

/** The unit of the last of so many digits. */
function unitOf(value, digits) {
  return 10 ** (Math.floor(Math.log10(Math.abs(value) || 1)) + 1 - digits);
}

/** The gains by which the stiffest wall (alpha, beta) is printed: of a stable one, as stable_pair of shown.py; null where none is. Of a region that is not closed rounding may tell nothing: discs do. */
function printedWall(loop, scale, [alpha, beta], isClosed) {
  const limit = alpha * scale.stiffness, other = Math.abs(beta) > NOTHING * alpha ? beta * scale.damping : 0;
  for (const digits of [3, 5, 7, 9, MOST_DIGITS]) {
    for (const count of [0, 1, 2, 5]) {
      const first = rounded(limit - count * unitOf(limit, LIMIT_DIGITS), LIMIT_DIGITS, -1);
      for (const way of [0, -1, 1]) {
        const wall = [first, rounded(other, digits, way)];
        const gains = [wall[0] / scale.stiffness, wall[1] / scale.damping];
        if (isClosed ? isStable(loop, ...gains) : verdictAndRadius(loop, ...gains).code === STABLE) return wall;
      }
    }
  }
  return null;
}

/** The values of a quantity that can be computed: the least, the largest and, in words, both. */
function boundsOf(key) {
  if (key === "mass" || key === "period") return [Number.MIN_VALUE, 1e12, "above 0 to 1e12"];
  if (key === "window") return [1, LONGEST_WINDOW, `from 1 to ${LONGEST_WINDOW}`];
  const most = key === "delay" ? LONGEST_DELAY : 1e12;
  return [0, most, `from 0 to ${most === 1e12 ? "1e12" : most}`];
}

/** A value within what can be computed, or NaN for what is no such number. */
function acceptable(key, value) {
  const [least, most] = boundsOf(key), taken = key === "window" ? Math.round(value) : value;
  return taken >= least && taken <= most ? taken : NaN;
}

/** The setup of a state: what loopOf takes. A low pass ends below half of the sampling rate. */
function setupOf(state) {
  const { mass, damping, handMass, handStiffness, handDamping, period, delay } = state;
  const { cutoff, order, kind, factor, numerator, denominator } = state;
  const most = 0.499 / period;
  const estimator = {
    window: state.window,
    cutoff: cutoff > 0 ? Math.min(cutoff, kind === "butterworth" ? most : 200 * most) : 0,
    order, kind, factor, numerator, denominator,
  };
  return { mass, damping, handMass, handStiffness, handDamping, period, delay, estimator };
}

// ------------------------------------------------------------------------------- as a link, as TOML

const NUMBERS = [
  "mass", "damping", "handMass", "handStiffness", "handDamping", "period", "delay", "window",
  "cutoff", "order", "factor", "friction", "push", "speed", "encoder", "cursorStiffness", "cursorDamping",
];
const WORDS = {
  motion: ["line", "rotation"], kind: ["low-pass", "butterworth"], view: ["near", "all", "sample"],
  contact: ["off", "on"],
};
const LISTS = ["numerator", "denominator"];

/** The state as what stands behind # of a link. */
function hashOf(state) {
  const parts = new URLSearchParams();
  for (const key of [...NUMBERS, ...Object.keys(WORDS)]) parts.set(key, String(state[key]));
  for (const key of LISTS) if (state[key]) parts.set(key, state[key].join(" "));
  for (const { name, stiffness, damping } of state.walls) {
    parts.append("wall", [stiffness, damping, name].join(" "));
  }
  return parts.toString();
}

/** The state of a link; what it does not say, or says wrongly, is that of another state. It may be refused. */
function stateOfHash(hash, state) {
  const parts = new URLSearchParams(hash), next = { ...state };
  if (!parts.has("mass")) return next;
  for (const key of NUMBERS) {
    const value = parts.has(key) ? acceptable(key, Number(parts.get(key))) : NaN;
    const free = key.startsWith("cursor") ? Number(parts.get(key)) : value;
    if (Number.isFinite(free)) next[key] = free;
  }
  next.order = Math.min(HIGHEST_ORDER, Math.max(1, Math.round(next.order)));
  for (const [key, words] of Object.entries(WORDS)) {
    if (words.includes(parts.get(key))) next[key] = parts.get(key);
  }
  const [above, below] = LISTS.map((key) => (parts.get(key) || "").split(" ").map(Number));
  const isFilter = LISTS.every((key) => parts.get(key)) && [...above, ...below].every(Number.isFinite)
    && below[0] !== 0 && above.length <= below.length;
  [next.numerator, next.denominator] = isFilter ? [above, below] : [null, null];
  const walls = parts.getAll("wall").map(wallOfWords).filter(Boolean);
  next.walls = [...new Map(walls.map((wall) => [wall.name, wall])).values()];
  return next;
}

/** A wall of "K B name"; null where there are no such numbers. */
function wallOfWords(words) {
  const [stiffness, damping, ...name] = words.split(" ");
  const wall = { name: nameOf(name.join(" ")), stiffness: Number(stiffness), damping: Number(damping) };
  return Math.abs(wall.stiffness) + Math.abs(wall.damping) < 1e12 ? wall : null;
}

/** The name of a wall as jaxstab takes it: printable, and first a letter or a digit. */
function nameOf(words) {
  const name = words.replace(/[^\p{L}\p{M}\p{N}\p{P}\p{S} ]/gu, "").replace(/^[^\p{L}\p{N}]+/u, "");
  return [...name].slice(0, LONGEST_NAME).join("") || "wall";
}

/** The state as a scene, which `jaxstab check` takes. */
function sceneOf(state) {
  const mass = state.motion === "rotation" ? "inertia" : "mass";
  const isSimulated = state.contact === "on" && state.push > 0; // only such scenes have friction
  const lines = [
    "[device]", `${mass} = ${state.mass}`, `damping = ${state.damping}`,
    ...(isSimulated ? [`friction = ${state.friction}`] : []), "",
    ...(state.encoder > 0 ? ["[device.encoder]", `resolution = ${state.encoder}`, ""] : []),
    "[hand]", `${mass} = ${state.handMass}`, `stiffness = ${state.handStiffness}`,
    `damping = ${state.handDamping}`, "",
    "[controller]", `sample_time = ${state.period}`, `delay_samples = ${state.delay}`, "",
    "[controller.velocity]", ...velocityLines(setupOf(state).estimator),
    ...(isSimulated ? ["", "[contact]", `push = ${state.push}`, `speed = ${state.speed}`] : []),
  ];
  state.walls.forEach(({ name, stiffness, damping }) => {
    lines.push("", `[walls.${JSON.stringify(name)}]`, `stiffness = ${stiffness}`, `damping = ${damping}`);
  });
  return `${lines.join("\n")}\n`;
}

function velocityLines({ window, cutoff, order, kind, factor, numerator, denominator }) {
  const list = (numbers) => `[${numbers.join(", ")}]`;
  if (numerator) return [`numerator = ${list(numerator)}`, `denominator = ${list(denominator)}`];
  const lines = [`window_samples = ${window}`];
  if (cutoff > 0) lines.push(`cutoff = ${cutoff}`, `order = ${order}`, `kind = "${kind}"`);
  if (factor > 0 && factor < 1) lines.push(`factor = ${factor}`);
  return lines;
}
