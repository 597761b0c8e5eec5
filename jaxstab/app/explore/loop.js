// The loop as mathematics: p(z) = base + alpha stiffness + beta damping, and the curve in closed
// form on which a pair of its roots lies on the unit circle (docs/model.md, "the boundary").
"use strict";

const LARGEST_GAMMA = 1e4, LARGEST_DELTA = 1e3, LARGEST_RATE = 1e6; // Hz

/**
 * Device, hand and controller in SI units, as the controls have them.
 * @typedef {object} Setup
 * @property {number} mass of the device in kg (kg m^2), > 0
 * @property {number} damping of the device in N s/m
 * @property {number} handMass
 * @property {number} handStiffness in N/m
 * @property {number} handDamping
 * @property {number} period T in s
 * @property {number} delay in samples
 * @property {Estimator} estimator see velocityOf
 */

/**
 * A loop in numbers without units.
 * @typedef {object} Loop
 * @property {Plant} plant
 * @property {number} lag whole samples w of the delay, z^-w N/D
 * @property {number} window of the velocity in samples
 * @property {Stage[]} stages of the velocity
 * @property {number[]} passed z^w times the denominators of the estimator
 * @property {number[]} base
 * @property {number[]} stiffness what alpha multiplies
 * @property {number[]} damping what beta multiplies
 * @property {Float64Array} work what closedLoop is divided in, one wall after the other
 */

/** The hand without units: gamma = k T^2/m and delta = b T/m. */
function handOf(setup) {
  const moved = setup.mass + setup.handMass, { period } = setup;
  const gamma = (setup.handStiffness * period * period) / moved;
  return { gamma, delta: ((setup.damping + setup.handDamping) * period) / moved };
}

/** Why a setup is out of the range that jaxstab computes; an empty text where it is within. */
function whyRefused(setup) {
  const { gamma, delta } = handOf(setup), forIt = "for this mass and sampling period";
  if (setup.period * LARGEST_RATE < 1) return "the sampling period is below 1 µs";
  if (!(gamma <= LARGEST_GAMMA)) return `the hand's stiffness k is too large ${forIt}: k T²/m is above ${LARGEST_GAMMA}`;
  return delta <= LARGEST_DELTA ? "" : `the damping b is too large ${forIt}: b T/m is above ${LARGEST_DELTA}`;
}

function isComputable(setup) {
  return whyRefused(setup) === "";
}

/** @returns {Loop} */
function loopOf(setup) {
  const { gamma, delta } = handOf(setup), { period } = setup;
  const velocity = velocityOf(setup.estimator, period);
  return dimensionlessLoop(gamma, delta, setup.delay, velocity);
}

/** What alpha and beta are multiplied with to give K and B. */
function unitsOf(setup) {
  const moved = setup.mass + setup.handMass;
  return { stiffness: moved / setup.period ** 2, damping: moved / setup.period };
}

/** @returns {Loop} */
function dimensionlessLoop(gamma, delta, delay, velocity) {
  const whole = Math.floor(delay), fraction = delay - whole;
  const plant = plantOf(gamma, delta, fraction);
  const lag = whole + plant.numerator.length - 2; // a fraction costs one degree more
  const { window, stages } = velocity;
  const above = productOf(stages.map((stage) => stage.numerator));
  const below = productOf(stages.map((stage) => stage.denominator));
  const difference = [1, ...new Array(window - 1).fill(0), -1].map((c) => c / window);
  const passed = product(powerOf(lag + window), below); // what a push does not meet
  const base = product(passed, plant.denominator);
  const stiffness = product(product(plant.numerator, powerOf(window)), below);
  const damping = productOf([plant.numerator, difference, above]);
  const parts = withoutCommonPowers([base, stiffness, damping]);
  const work = new Float64Array(parts.base.length);
  const common = base.length - parts.base.length; // powers of z
  return { plant, lag, window, stages, passed: passed.slice(0, passed.length - common), ...parts, work };
}

/** The three polynomials, of one length, without the powers of z that all of them have. */
function withoutCommonPowers(polynomials) {
  const length = Math.max(...polynomials.map((one) => one.length));
  let [base, stiffness, damping] = polynomials.map((one) => paddedTo(length, one));
  let end = length;
  while (end > 1 && base[end - 1] === 0 && stiffness[end - 1] === 0 && damping[end - 1] === 0) end--;
  [base, stiffness, damping] = [base, stiffness, damping].map((one) => one.slice(0, end));
  return { base, stiffness, damping };
}

/** The polynomial of the closed loop at a wall. */
function closedLoop(loop, alpha, beta) {
  const { base, stiffness, damping } = loop;
  return base.map((c, k) => c + alpha * stiffness[k] + beta * damping[k]);
}

/** The polynomial of the closed loop, in the loop's own memory. */
function closedLoopAtWork(loop, alpha, beta) {
  const { base, stiffness, damping, work } = loop;
  for (let k = 0; k < work.length; k++) work[k] = base[k] + alpha * stiffness[k] + beta * damping[k];
  return work;
}

/** A bound of the error of each coefficient of closedLoop, as far as rounding goes. */
function errorOf(loop, alpha, beta) {
  const { base, stiffness, damping } = loop;
  let largest = 0;
  for (let k = 0; k < base.length; k++) {
    const terms = Math.abs(alpha * stiffness[k]) + Math.abs(beta * damping[k]);
    largest = Math.max(largest, Math.abs(base[k]) + terms);
  }
  return (8 + 4 * loop.stages.length) * EPSILON * largest;
}

/**
 * What float64 can say of a wall: the verdict, the largest modulus of the roots and how far the
 * discs around them reach beyond it; no proof.
 * @returns {{code: number, radius: number, bound: number}} the code is STABLE, UNSTABLE or UNDECIDED
 */
function verdictAndRadius(loop, alpha, beta) {
  const discs = rootDiscs(closedLoop(loop, alpha, beta), errorOf(loop, alpha, beta));
  const moduli = Array.from(discs.re, (x, k) => Math.hypot(x, discs.im[k]));
  const radius = Math.max(0, ...moduli);
  const reach = Math.max(0, ...moduli.map((modulus, k) => modulus + discs.width[k]));
  return { code: verdictOf(discs), radius, bound: reach - radius };
}

/** Whether a wall is stable, as far as float64 tells: for searches. */
function isStable(loop, alpha, beta) {
  const work = closedLoopAtWork(loop, alpha, beta);
  return isInside(work, work.length - 1);
}

// ------------------------------------------------------------------------------------- the curve
//
// p = 0 reads alpha + beta V(z) = W(z), W = -z^w D/N, at z = exp(i theta). For theta up to pi/2
// both sides are divided by s = z - 1 first, as gamma + W and V vanish there in the end; beyond,
// everything is formed from pi - theta. So nothing cancels at either end.

const PI_REST = 1.2246467991473532e-16; // pi less Math.PI

/** cos and sin of k theta, exact to their last digits next to pi, too. */
class Turn {
  constructor(theta) {
    this.isUpper = theta > Math.PI / 2;
    this.folded = this.isUpper ? Math.PI - theta + PI_REST : theta;
  }
  cosine(k) {
    const value = Math.cos(k * this.folded);
    return this.isUpper && k % 2 ? -value : value;
  }
  sine(k) {
    const value = Math.sin(k * this.folded);
    return this.isUpper && k % 2 === 0 ? -value : value;
  }
}

/** The product of complex numbers. */
function times(one, other) {
  return [one[0] * other[0] - one[1] * other[1], one[0] * other[1] + one[1] * other[0]];
}

/** The quotient of complex numbers. */
function over(above, below) {
  const square = below[0] * below[0] + below[1] * below[1];
  const re = above[0] * below[0] + above[1] * below[1];
  return [re / square, (above[1] * below[0] - above[0] * below[1]) / square];
}

/** What the stages of the estimator let through at z = 1 + s = t - 1. */
function throughStages(stages, z, s, t) {
  let whole = [1, 0];
  for (const { numerator, shifted, nyquist } of stages) {
    let above = nyquist ? [numerator[0], 0] : horner(numerator, z);
    for (let k = 0; k < (nyquist || 0); k++) above = times(above, t);
    whole = times(whole, over(above, horner(shifted, s)));
  }
  return whole;
}

/** sin(k half) / sin(half), k at half = 0. */
function sineRatio(k, half) {
  return half === 0 ? k : Math.sin(k * half) / Math.sin(half);
}

/** (W + gamma) and V, both divided by 2 sin(theta/2), for theta up to pi/2. */
function dividedSides(loop, theta) {
  const { plant, lag, window } = loop, half = theta / 2;
  const turned = [Math.cos(half), Math.sin(half)];
  const z = [Math.cos(theta), Math.sin(theta)];
  const s = times([0, 2 * turned[1]], turned);
  const sized = (factor, turns) => [factor * Math.cos(turns), factor * Math.sin(turns)];
  const powers = sized(sineRatio(lag, half), (lag - 1) * half); // (z^w - 1) / s
  const square = times(s, s);
  const d = [
    square[0] + plant.c1 * s[0] + plant.gamma * plant.total,
    square[1] + plant.c1 * s[1],
  ];
  const slope = [plant.g1 + plant.g2 * s[0], plant.g2 * s[1]];
  const n = times(s, slope);
  n[0] += plant.total;
  const lost = times(d, powers);
  const above = [
    plant.gamma * slope[0] - plant.c1 - s[0] - lost[0],
    plant.gamma * slope[1] - s[1] - lost[1],
  ];
  const through = throughStages(loop.stages, z, s, [z[0] + 1, z[1]]);
  const ofWindow = sized(sineRatio(window, half) / window, -window * half);
  return {
    w: times([-turned[1], turned[0]], over(above, n)),
    v: times([0, 1], times(ofWindow, through)),
    scale: 2 * turned[1],
    offset: -plant.gamma,
  };
}

/** W and V, for theta beyond pi/2. */
function plainSides(loop, theta) {
  const { plant, lag, window } = loop, turn = new Turn(theta);
  const z = [turn.cosine(1), turn.sine(1)], half = turn.folded / 2;
  const [, d1, d0] = plant.denominator;
  const d = [turn.cosine(2) + d1 * z[0] + d0, turn.sine(2) + d1 * z[1]];
  const t = times([0, 2 * Math.sin(half)], [Math.cos(half), -Math.sin(half)]); // z + 1
  const n = times(t, [plant.h1 + plant.h2 * t[0], plant.h2 * t[1]]);
  n[0] += plant.atMinusOne;
  const lagged = times([turn.cosine(lag), turn.sine(lag)], d);
  const through = throughStages(loop.stages, z, [z[0] - 1, z[1]], t);
  // 1 - z^-n, whose real part is a square of a sine or cosine
  const size = 2 * (window % 2 ? Math.cos((window * half)) : Math.sin((window * half)));
  const ofWindow = [
    (size * (window % 2 ? Math.cos(window * half) : Math.sin(window * half))) / window,
    turn.sine(window) / window,
  ];
  const quotient = over(lagged, n);
  const w = [-quotient[0], -quotient[1]];
  return { w, v: times(ofWindow, through), scale: 1, offset: 0 };
}

/**
 * The wall that puts a pair of roots at exp(+-i theta).
 * @param {Loop} loop
 * @param {number} theta in [0, pi)
 * @returns {{alpha: number, beta: number, sign: number}} the side on the left, in the direction of
 *   growing theta, has the pair inside where the sign is positive; on the right elsewhere
 */
function curvePoint(loop, theta) {
  const { w, v, scale, offset } = (theta > Math.PI / 2 ? plainSides : dividedSides)(loop, theta);
  const beta = w[1] / v[1];
  const rest = w[0] - beta * v[0];
  return { alpha: offset + scale * rest, beta, sign: Math.sign(v[1]) };
}
