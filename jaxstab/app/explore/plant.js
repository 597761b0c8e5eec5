// One mass with hand, spring and damper behind a zero-order hold, and the velocity estimator.
//
// Everything is dimensionless (Table I of Hulin, Preusche, Hirzinger 2008): gamma = k T^2/m,
// delta = b T/m, the delay in samples. Coefficients of polynomials stand with the highest power of
// z first, as everywhere in jaxstab. The formulas are those of jaxstab/model/plant.py and
// jaxstab/model/filters.py, in float64.
"use strict";

const TAYLOR_TERMS = 12;
const LARGEST_NODE = 1.0; // of a Taylor series; beyond, the duplication formulas

/**
 * Values of a function at two nodes x and y, and its divided difference between them.
 * @typedef {{x: number, y: number, xy: number}} Values
 */

/**
 * Evaluate the series of 1/(2k + odd)! powers at two nodes, with its divided difference.
 * @param {0|1} odd 0 for cosh sqrt(x), 1 for sinh(sqrt x) / sqrt x
 * @returns {Values}
 */
function taylor(odd, x, y) {
  let atX = 0, atY = 0, between = 0;
  for (let k = TAYLOR_TERMS; k >= 0; k--) {
    let coefficient = 1;
    for (let j = 2; j <= 2 * k + odd; j++) coefficient /= j;
    between = atX + y * between;
    atX = coefficient + x * atX;
    atY = coefficient + y * atY;
  }
  return { x: atX, y: atY, xy: between };
}

/** Values of kappa = cosh sqrt and sigma = sinh sqrt / sqrt at two nodes. */
function entireFunctions(x, y) {
  let doublings = 0;
  while (Math.max(Math.abs(x), Math.abs(y)) > LARGEST_NODE) {
    x /= 4;
    y /= 4;
    doublings++;
  }
  let kappa = taylor(0, x, y), sigma = taylor(1, x, y);
  for (; doublings > 0; doublings--) {
    const even = sigma.y * sigma.y + x * (sigma.x + sigma.y) * sigma.xy;
    const odd = sigma.xy * kappa.x + sigma.y * kappa.xy;
    const ofFour = (node, value) => 1 + 2 * node * value * value;
    const next = { x: ofFour(x, sigma.x), y: ofFour(y, sigma.y), xy: even / 2 };
    sigma = { x: sigma.x * kappa.x, y: sigma.y * kappa.y, xy: odd / 4 };
    kappa = next;
    x *= 4;
    y *= 4;
  }
  return { kappa, sigma };
}

/** The plant while a force is held for a part of a sample: what its response is made of. */
function hold(gamma, delta, length) {
  const a = (length * delta) / 2;
  const { kappa, sigma } = entireFunctions(a * a, a * a - length * length * gamma);
  const decay = Math.exp(-a);
  return { length, decay, even: kappa.xy, odd: a * sigma.xy };
}

/**
 * The sampled plant N(z)/D(z), without the whole samples of the delay.
 *
 * On the circle N is total + s (g1 + g2 s) around z = 1, s = z - 1, and
 * atMinusOne + t (h1 + h2 t) around z = -1, t = z + 1; D is s^2 + s c1 + gamma total.
 * @typedef {object} Plant
 * @property {number[]} numerator of two or three coefficients
 * @property {number[]} denominator of three
 */

/**
 * @param {number} gamma physical stiffness
 * @param {number} delta physical damping
 * @param {number} fraction of a sample of delay, in [0, 1)
 * @returns {Plant}
 */
function plantOf(gamma, delta, fraction) {
  const step = hold(gamma, delta, 1);
  const total = 2 * step.decay * step.even;
  const difference = 2 * step.decay * step.odd;
  const c1 = gamma * total - Math.expm1(-delta);
  const denominator = [1, c1 - 2, Math.exp(-delta)];
  const common = { gamma, delta, total, c1, denominator };
  if (fraction === 0) {
    const first = (total + difference) / 2;
    const numerator = [first, (total - difference) / 2];
    return { ...common, numerator, atMinusOne: -difference, g1: first, g2: 0, h1: first, h2: 0 };
  }
  const after = hold(gamma, delta, 1 - fraction), before = hold(gamma, delta, fraction);
  const b2 = after.length ** 2 * after.decay * (after.even + after.odd);
  const reversed = before.length ** 2 * before.decay * (before.even - before.odd);
  const b0 = after.decay ** 2 * reversed;
  const b1 = total - b2 - b0;
  const atMinusOne = 2 * (b2 + b0) - total;
  const numerator = [b2, b1, b0];
  return { ...common, numerator, atMinusOne, g1: 2 * b2 + b1, g2: b2, h1: b1 - 2 * b2, h2: b2 };
}

/**
 * A part of the estimator behind the difference: a quotient of polynomials in z.
 * @typedef {object} Stage
 * @property {number[]} numerator in powers of z
 * @property {number[]} denominator in powers of z
 * @property {number[]} shifted the denominator in powers of z - 1
 * @property {number} [nyquist] how many factors z + 1 the numerator is made of, if only of these
 */

/** A first-order low pass with its pole at exp(-2 pi f T). */
function lowPass(cutoffTimesPeriod) {
  const pole = Math.exp(-2 * Math.PI * cutoffTimesPeriod);
  return { numerator: [1 - pole, 0], denominator: [1, -pole], shifted: [1, 1 - pole] };
}

/** Exponential smoothing y_k = y_(k-1) + factor (x_k - y_(k-1)). */
function smoothing(factor) {
  return { numerator: [factor, 0], denominator: [1, factor - 1], shifted: [1, factor] };
}

/** Butterworth's low pass by the bilinear transform, in sections of second order. */
function butterworth(cutoffTimesPeriod, order) {
  const w = Math.tan(Math.PI * cutoffTimesPeriod), stages = [];
  for (let k = 0; k < Math.floor(order / 2); k++) {
    const sine = Math.sin((Math.PI * (2 * k + 1)) / (2 * order));
    const first = 1 + 2 * w * sine + w * w, gain = (w * w) / first;
    stages.push({
      numerator: [gain, 2 * gain, gain],
      denominator: [1, (2 * (w * w - 1)) / first, (1 - 2 * w * sine + w * w) / first],
      shifted: [1, (4 * w * (sine + w)) / first, (4 * w * w) / first],
      nyquist: 2,
    });
  }
  if (order % 2) {
    const gain = w / (1 + w);
    stages.push({
      numerator: [gain, gain],
      denominator: [1, (w - 1) / (w + 1)],
      shifted: [1, (2 * w) / (1 + w)],
      nyquist: 1,
    });
  }
  return stages;
}

/** A velocity V(z) in 1/s by its coefficients, less its factor (1 - 1/z) / T. */
function transferStage(numerator, denominator, period) {
  let sum = 0;
  const steps = numerator.slice(0, -1).map((one) => (sum += one));
  const first = denominator[0];
  const below = denominator.map((one) => one / first);
  return {
    numerator: [...steps.map((one) => (one * period) / first), 0],
    denominator: below,
    shifted: inPowersOfShift(below),
  };
}

/** The coefficients of a polynomial in powers of z - 1, by one division after the other. */
function inPowersOfShift(polynomial) {
  const rest = [...polynomial];
  for (let end = rest.length; end > 1; end--) {
    for (let k = 1; k < end; k++) rest[k] += rest[k - 1];
  }
  return rest;
}

/**
 * How the velocity is estimated: the difference over a window, then stages.
 * @param {Estimator} estimator window in samples, cutoff in Hz (0: none), order, kind, factor; or,
 *   in place of all of them, numerator and denominator of a transfer function
 * @param {number} period the sampling period in s
 * @returns {{window: number, stages: Stage[]}}
 */
function velocityOf(estimator, period) {
  const { window, cutoff, order, kind, factor, numerator, denominator } = estimator;
  if (numerator) return { window: 1, stages: [transferStage(numerator, denominator, period)] };
  const stages = [];
  if (cutoff > 0 && kind === "butterworth") stages.push(...butterworth(cutoff * period, order));
  else if (cutoff > 0) stages.push(...Array(order).fill(lowPass(cutoff * period)));
  if (factor > 0 && factor < 1) stages.push(smoothing(factor));
  return { window, stages };
}
