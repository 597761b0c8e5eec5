// Contact as it is felt: one wall with friction, an encoder and one side, simulated, not proved.
//
// The algorithm is that of jaxstab/motion/contact.py, step for step, for one mass with T = m = 1: its
// theory stands there. Between arrivals of forces the motion is exact, and cut into pieces in which
// the velocity passes through 0 at most once.
"use strict";

const DURATION = 4; // s of a contact, as in jaxstab
const FASTEST = 64; // largest max(delta, sqrt(gamma)) that is simulated
const FEWEST_SAMPLES = 16;
const MOST_STEPS = 1e6; // between samples, of a contact: they take about 0.1 s, for which the page stands still
const GIVEN_UP = 1e6; // of position and velocity
const REST = 1e-6; // m, within which a device rests
const GROWTH = 1.5; // of the amplitude, from one quarter of a run to the next
const WORST_LAST = ["rests", "decays", "oscillates", "bounces", "outside", "grows"]; // of what is pushed
const SMALLEST_TERM = 1e-18; // of a series
const ARCTAN = Array.from({ length: 14 }, (_, k) => (-1) ** (13 - k) / (2 * (13 - k) + 1));

/**
 * How the device meets the wall, in SI units.
 * @typedef {object} Conditions
 * @property {number} friction Coulomb's
 * @property {number} [staticFriction] as friction where it is not given
 * @property {number} push of the hand
 * @property {number} encoder its resolution, 0 for none
 * @property {number} [speed] at the start, at which the device touches the wall
 * @property {boolean} [oneSided] whether the wall only pushes, and only where it is entered
 */

/** Why contacts of a setup with a wall are not simulated, in a sentence; "" where they are. */
function whyNoContact(setup, wall, { push, speed = 0 }) {
  const { gamma, delta } = handOf(setup), samples = DURATION / setup.period;
  const fastest = Math.max(delta, Math.sqrt(gamma));
  if (fastest > FASTEST) return "Not simulated: the device without a wall moves too fast for the sampling period.";
  if (samples < FEWEST_SAMPLES) return `Not simulated: the sampling period is too long for a contact of ${DURATION} s; give 250 ms at most.`;
  if (samples * Math.max(1, fastest) > MOST_STEPS) return "Not simulated: it takes too long in a browser; jaxstab.contact of Python simulates it.";
  if (push === 0 && speed === 0) return "Not simulated: give a push, without which nothing moves.";
  if (push !== 0 && gamma === 0 && wall.stiffness === 0) return "Not simulated: without stiffness nothing holds the device against the push.";
  return "";
}

/**
 * Simulate a contact that begins at the surface of the wall.
 * @param {Conditions} conditions
 * @returns {{kind: string, amplitude: number, frequency: number, timeToRest: number, positions: Float64Array}}
 *   amplitude in m, infinite where the motion was given up; frequency in Hz, NaN where there is none;
 *   the positions at the samples, as far as the motion was not given up
 */
function contactOf(setup, wall, conditions) {
  const { period } = setup, body = bodyOf(setup), run = runOf(setup, wall, conditions);
  const samples = roundedToEven(DURATION / period);
  const control = controllerOf(setup, run, samples), forces = new Float64Array(samples);
  const positions = new Float64Array(samples), summary = newSummary(samples);
  let x = 0, v = run.speed;
  for (let k = 0; k < samples; k++) {
    positions[k] = x;
    forces[k] = control(k, x);
    beginSample(summary, k);
    let low = x, high = x, begin = k;
    for (const { age, flow } of body.pieces) {
      const acting = k < age ? 0 : forces[k - age];
      const { way, speed, turn } = movedBy(body, run, flow, x, v, acting);
      if (turn) {
        low = Math.min(low, turn.x);
        high = Math.max(high, turn.x);
        if (turn.isMaximum) noteMaximum(summary, begin + turn.time);
      }
      x += way;
      v = speed;
      begin += flow.length;
      low = Math.min(low, x);
      high = Math.max(high, x);
    }
    if (!(Math.abs(x) < GIVEN_UP && Math.abs(v) < GIVEN_UP)) {
      return { kind: "grows", amplitude: Infinity, frequency: NaN, timeToRest: Infinity, positions: positions.slice(0, k + 1) };
    }
    endSample(summary, k, x, low, high);
  }
  return { ...answerOf(summary, run, period), positions };
}

/** The worst of the contacts that begin with some speeds, with its speed. */
function worstContactOf(setup, wall, conditions, speeds) {
  const isWorse = (one, other) => { // by the first of these that differ
    const pairs = [WORST_LAST.indexOf(one.kind) - WORST_LAST.indexOf(other.kind), one.amplitude - other.amplitude, one.timeToRest - other.timeToRest];
    return pairs.find((difference) => difference) > 0;
  };
  return speeds
    .map((speed) => ({ speed, ...contactOf(setup, wall, { ...conditions, speed }) }))
    .reduce((worst, contact) => (isWorse(contact, worst) ? contact : worst));
}

/** A wall and its conditions for T = m = 1. */
function runOf(setup, wall, { friction, staticFriction = friction, push, encoder, speed = 0, oneSided = true }) {
  const units = unitsOf(setup), unit = units.stiffness; // of forces, too: positions stay in m
  return {
    alpha: wall.stiffness / unit, beta: wall.damping / units.damping, friction: friction / unit,
    staticFriction: staticFriction / unit, push: push / unit, encoder, speed: speed * setup.period, oneSided,
  };
}

// ------------------------------------------------------------------------------------ the controller

/** The force of the wall at one sample after the other, as a function of sample and position. */
function controllerOf({ estimator, period }, run, samples) {
  const { window, stages } = velocityOf(estimator, period), readings = new Float64Array(samples);
  const filters = stages.map(filterOf);
  return (k, x) => {
    const position = run.encoder > 0 ? run.encoder * roundedToEven(x / run.encoder) : x;
    readings[k] = position;
    const before = k < window ? 0 : readings[k - window];
    const velocity = filters.reduce((value, filter) => filter(value), (position - before) / window);
    const force = -(run.alpha * position + run.beta * velocity);
    if (!run.oneSided) return force;
    return position > 0 ? Math.min(force, 0) : 0;
  };
}

/** A stage as a function of sample after sample: transposed direct form II, from rest at 0. */
function filterOf({ numerator, denominator }) {
  const order = denominator.length - 1, above = paddedTo(order + 1, numerator);
  const memory = new Array(order + 1).fill(0); // its last entry stays 0
  return (value) => {
    const output = memory[0] + above[0] * value;
    for (let j = 0; j < order; j++) memory[j] = memory[j + 1] + above[j + 1] * value - denominator[j + 1] * output;
    return output;
  };
}

/** The nearest whole number, the even one of two. */
function roundedToEven(value) {
  const below = Math.floor(value), rest = value - below;
  if (rest === 0.5) return below % 2 === 0 ? below : below + 1;
  return rest < 0.5 ? below : below + 1;
}

// ------------------------------------------------------------------------------- between the samples

/** The mass: its equation of motion, the pieces of a sample, and series of S(t) / t and Y(t) / t^2. */
function bodyOf(setup) {
  const { gamma, delta } = handOf(setup), fastest = Math.max(delta, Math.sqrt(gamma));
  const whole = Math.floor(setup.delay), fraction = setup.delay - whole;
  const parts = fraction === 0 ? [[whole, 1]] : [[whole + 1, fraction], [whole, 1 - fraction]];
  const pieces = parts.flatMap(([age, length]) => {
    const count = Math.max(1, Math.ceil(length * fastest));
    return new Array(count).fill({ age, flow: flowOf(gamma, delta, length / count) });
  });
  const square = gamma - 0.25 * delta * delta;
  return { gamma, halfDamping: 0.5 * delta, square, pieces, ...seriesOf(gamma, delta, 1 / Math.max(fastest, 1)) };
}

/** A piece of a sample: its length, and S, S' and Y at its end. */
function flowOf(gamma, delta, length) {
  const { decay, even, odd } = hold(gamma, delta, length), a = (length * delta) / 2;
  const { kappa, sigma } = entireFunctions(a * a, a * a - length * length * gamma);
  const impulse = length * decay * sigma.y;
  return { length, impulse, slope: decay * kappa.y - 0.5 * delta * impulse, step: length * length * decay * (even + odd) };
}

/** The coefficients of S(t) / t and Y(t) / t^2, the highest power first, for times up to the longest. */
function seriesOf(gamma, delta, longest) {
  const terms = [0, 1];
  for (let power = 1; ; power *= longest) {
    const order = terms.length - 1, [before, last] = terms.slice(-2);
    const isSmall = Math.abs(last) + Math.abs(before) * longest <= SMALLEST_TERM / power;
    if (terms.length % 4 === 1 && isSmall) break;
    terms.push(-(delta * order * last + gamma * before) / (order * (order + 1)));
  }
  const impulse = terms.slice(1), step = impulse.map((term, order) => term / (order + 2));
  return { impulse: impulse.reverse(), step: step.reverse() };
}

/** The direction in which the mass moves, 0 if it sticks, and the constant force in this piece. */
function pushed(run, v, others) {
  const slips = Math.abs(others) > run.staticFriction ? Math.sign(others) : 0;
  const sign = v === 0 ? slips : Math.sign(v);
  return { sign, b: sign === 0 ? 0 : others - sign * run.friction };
}

/** The way of the mass in a piece, its speed afterwards, and where it turns round or stops, or null. */
function movedBy(body, run, flow, x, v, acting) {
  const others = acting + run.push - body.gamma * x, { sign, b } = pushed(run, v, others);
  const way = flow.impulse * v + flow.step * b, speed = flow.slope * v + flow.impulse * b;
  if (!(sign * speed < 0)) return { way, speed, turn: null };
  const time = Math.min(timeToTurn(body, v, b), flow.length), rest = flow.length - time;
  const there = time * (v * valueAt(body.impulse, time)) + time * time * (b * valueAt(body.step, time));
  const back = pushed(run, 0, others - body.gamma * there).b;
  return {
    way: there + rest * rest * (back * valueAt(body.step, rest)),
    speed: rest * (back * valueAt(body.impulse, rest)),
    turn: { time, x: x + there, isMaximum: sign > 0 },
  };
}

/** When the velocity reaches 0: the arc tangent after its angle is halved twice. */
function timeToTurn({ halfDamping, square }, v, b) {
  let time = v / (halfDamping * v - b);
  for (let k = 0; k < 2; k++) time /= 1 + Math.sqrt(1 + square * time * time);
  return 4 * time * valueAt(ARCTAN, square * time * time);
}

// ------------------------------------------------------------------------------------- how it ends

/** What is kept of a run: its last two quarters, and since when it is within REST of one place. */
function newSummary(samples) {
  const quarter = Math.floor(samples / 4);
  return {
    samples, quarter, low: 0, high: 0, earlierLow: 0, earlierHigh: 0, place: 0, since: 0,
    maxima: 0, firstMaximum: 0, lastMaximum: 0, isNew: false,
  };
}

/** Begin anew where a quarter of the run begins. */
function beginSample(summary, k) {
  const { samples, quarter } = summary;
  summary.isNew = k === samples - 2 * quarter || k === samples - quarter;
  if (!summary.isNew) return;
  summary.earlierLow = summary.low;
  summary.earlierHigh = summary.high;
  summary.maxima = 0;
}

function noteMaximum(summary, time) {
  summary.lastMaximum = time;
  if (summary.maxima === 0) summary.firstMaximum = time;
  summary.maxima++;
}

/** Take over the extremes of a sample, and its last position. */
function endSample(summary, k, x, low, high) {
  if (Math.max(high - summary.place, summary.place - low) > REST) {
    summary.place = x;
    summary.since = k + 1;
  }
  summary.low = summary.isNew ? low : Math.min(summary.low, low);
  summary.high = summary.isNew ? high : Math.max(summary.high, high);
}

/** Kind, amplitude, frequency and time to rest of a run that was not given up. */
function answerOf(summary, run, period) {
  const { samples, quarter, high, low, since, maxima, firstMaximum, lastMaximum } = summary;
  const kind = kindOf(summary, run), isRest = since <= samples - quarter, duration = period * (lastMaximum - firstMaximum);
  return {
    kind, amplitude: 0.5 * (high - low),
    frequency: isRest || maxima < 2 ? NaN : (maxima - 1) / duration,
    timeToRest: isRest ? period * since : Infinity,
  };
}

/** How a run ends: the names are those of jaxstab.results.ContactKind. */
function kindOf({ samples, quarter, low, high, earlierLow, earlierHigh, since }, { oneSided, encoder }) {
  const surface = -REST - 0.5 * encoder; // further outside nothing acts
  const size = high - low, earlier = earlierHigh - earlierLow;
  if (oneSided && high < surface) return "outside";
  if (since <= samples - quarter) return "rests";
  if (size > GROWTH * earlier) return "grows";
  if (earlier > GROWTH * size) return "decays";
  return oneSided && low <= 0 ? "bounces" : "oscillates";
}
