// One wall: how much may change before it is unstable, and how it responds to a push.
"use strict";

const LEVEL = 0.02; // of the final position: what settled means
const HORIZON = 1 << 15; // samples that are looked at
const RESPONSE_SAMPLES = 240; // of the picture
const DELAY_STEP = 1 / 8; // samples, of the search for the delay that is too much
const MOST_DELAY = 64; // samples of further delay that are looked at
const GAIN_HALVINGS = 50;

/** A condition that holds at low and not at high: the last number at which it holds. */
function lastThatHolds(condition, low, high) {
  for (let k = 0; k < GAIN_HALVINGS; k++) {
    const middle = 0.5 * (low + high);
    if (condition(middle)) low = middle;
    else high = middle;
  }
  return low;
}

/** Where a straight line from a point along an axis leaves the loop of points, to one side. */
function exitsAlong(points, point, axis, sign) {
  const across = 1 - axis, found = [];
  points.forEach((a, k) => {
    const b = points[(k + 1) % points.length];
    if (a[across] > point[across] === b[across] > point[across]) return;
    const share = (point[across] - a[across]) / (b[across] - a[across]);
    const value = a[axis] + share * (b[axis] - a[axis]);
    if ((value - point[axis]) * sign > 0) found.push(value);
  });
  return sign > 0 ? Math.min(...found) : Math.max(...found);
}

/**
 * The gain up to which a stable wall stays stable when it alone changes; NaN where none is found.
 * @param {0|1} axis 0 for alpha, 1 for beta
 * @param {1|-1} sign of the change
 */
function limitFrom(loop, region, point, axis, sign) {
  const own = region.components.find((component) => holds(component.points, point));
  if (!own) return NaN;
  const rough = exitsAlong(own.points, point, axis, sign);
  const isStableAt = (value) => {
    const wall = [...point];
    wall[axis] = value;
    return isStable(loop, ...wall);
  };
  const width = 0.02 * Math.abs(rough - point[axis]) + SMOOTH * extentOf(own.points).size[axis];
  let beyond = rough + sign * width, before = rough - sign * width;
  if ((before - point[axis]) * sign < 0) before = point[axis];
  if (!isStableAt(before) || isStableAt(beyond)) return rough;
  return lastThatHolds(isStableAt, before, beyond);
}

/** By how many samples the delay may grow until a stable wall is found unstable. */
function extraDelay(setup, alpha, beta) {
  const isStableWith = (more) =>
    isStable(loopOf({ ...setup, delay: setup.delay + more }), alpha, beta);
  for (let more = DELAY_STEP; more <= MOST_DELAY; more += DELAY_STEP) {
    if (!isStableWith(more)) return lastThatHolds(isStableWith, more - DELAY_STEP, more);
  }
  return Infinity;
}

/**
 * The sampled positions after a push with a constant force, as shares of the last one.
 *
 * With G0 = N0/D the plant without its delay, the position is G0/(1 + z^-w G C) times the step, so
 * p(z) times the position is N0 z^w times the estimator's denominator, times the step.
 */
function responseOf(setup, alpha, beta, samples) {
  const loop = loopOf(setup), polynomial = closedLoop(loop, alpha, beta);
  const { gamma, delta } = loop.plant, undelayed = plantOf(gamma, delta, 0);
  const input = product(undelayed.numerator, loop.passed);
  const late = polynomial.length - input.length; // samples before the push is felt
  const last = 1 / (alpha + gamma);
  const positions = new Float64Array(samples);
  let pushed = 0;
  for (let k = 0; k < samples; k++) {
    const index = k - late;
    if (index >= 0 && index < input.length) pushed += input[index];
    let sum = pushed;
    const most = Math.min(k, polynomial.length - 1);
    for (let j = 1; j <= most; j++) sum -= polynomial[j] * positions[k - j];
    positions[k] = sum;
  }
  return positions.map((position) => position / last);
}

/**
 * The first sample from which on the position stays within 2 % of its last one.
 * @returns {number} NaN where that takes longer than what is looked at
 */
function settlingSamples(setup, alpha, beta, radius) {
  if (!(radius < 1)) return NaN;
  const needed = Math.ceil(Math.log(1e-6) / Math.log(radius)) + 64;
  if (needed > HORIZON) return NaN;
  const shares = responseOf(setup, alpha, beta, needed);
  let last = needed - 1;
  while (last >= 0 && Math.abs(shares[last] - 1) <= LEVEL) last--;
  return last + 1;
}

/**
 * What is known of a wall, in SI units.
 * @param {{stiffness: number, damping: number}} wall K and B
 */
function wallFacts(setup, loop, region, wall) {
  const units = unitsOf(setup);
  const point = [wall.stiffness / units.stiffness, wall.damping / units.damping];
  const { code, radius, bound } = verdictAndRadius(loop, ...point);
  const facts = { code, radius, bound, settling: NaN, island: false };
  if (code !== STABLE) return facts;
  const own = region.components.find((component) => holds(component.points, point));
  const limit = (axis, sign) => limitFrom(loop, region, point, axis, sign);
  return {
    ...facts,
    island: Boolean(own && !own.holdsSmallGains && mainOf(region)),
    settling: settlingSamples(setup, ...point, radius) * setup.period,
    stiffness: [limit(0, -1), limit(0, 1)].map((alpha) => alpha * units.stiffness),
    damping: [limit(1, -1), limit(1, 1)].map((beta) => beta * units.damping),
    extraDelay: extraDelay(setup, ...point) * setup.period,
  };
}
