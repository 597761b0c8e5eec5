// Polynomials by their coefficients, highest power first, and where their roots are.
"use strict";

const EPSILON = 2 ** -52;
const STABLE = 1, UNSTABLE = 2, UNDECIDED = 3; // the codes of jaxstab.Verdict
const ROOT_STEPS = 200;

/** The value of a polynomial with real coefficients at a complex number. */
function horner(polynomial, point) {
  let re = 0, im = 0;
  for (let k = 0; k < polynomial.length; k++) {
    const next = re * point[0] - im * point[1] + polynomial[k];
    im = re * point[1] + im * point[0];
    re = next;
  }
  return [re, im];
}

/** The product of two polynomials. */
function product(one, other) {
  const result = new Array(one.length + other.length - 1).fill(0);
  one.forEach((a, j) => other.forEach((b, k) => (result[j + k] += a * b)));
  return result;
}

/** The product of some polynomials. */
function productOf(polynomials) {
  return polynomials.reduce(product, [1]);
}

/** z to a power. */
function powerOf(degree) {
  return [1, ...new Array(degree).fill(0)];
}

/** A polynomial with zeros in front, up to a length. */
function paddedTo(length, polynomial) {
  return [...new Array(length - polynomial.length).fill(0), ...polynomial];
}

/** The value at a real point, by Horner's rule. */
function valueAt(polynomial, point) {
  return polynomial.reduce((sum, coefficient) => sum * point + coefficient, 0);
}

/**
 * Whether all roots are inside of the unit circle, as float64 has it: for drawing.
 * @param {Float64Array} work the coefficients, which are overwritten
 * @param {number} degree
 */
function isInside(work, degree) {
  for (; degree > 0; degree--) {
    const ratio = work[degree] / work[0];
    if (!(Math.abs(ratio) < 1)) return false;
    for (let k = 0, j = degree; k < j; k++, j--) {
      const a = work[k], b = work[j];
      work[k] = a - ratio * b;
      work[j] = b - ratio * a;
    }
    if (degree % 2 === 0) work[degree / 2] *= 1 - ratio;
  }
  return true;
}

/** Divide by z - root in place, without the rest. */
function divideByRoot(work, length, root) {
  let sum = 0;
  for (let k = 0; k < length - 1; k++) work[k] = sum = work[k] + root * sum;
}

/** Divide by z^2 - 2 cosine z + 1, a pair of roots on the circle, in place, without the rest. */
function divideByPair(work, length, cosine) {
  let before = 0, last = 0;
  for (let k = 0; k < length - 2; k++) {
    const next = work[k] + 2 * cosine * last - before;
    before = last;
    work[k] = last = next;
  }
}

/**
 * All roots, by the iteration of Aberth and Ehrlich from a circle.
 * @param {number[]} polynomial its first coefficient is not 0
 * @returns {{re: Float64Array, im: Float64Array}}
 */
function rootsOf(polynomial) {
  let length = polynomial.length;
  while (length > 1 && polynomial[length - 1] === 0) length--; // roots at 0 are known
  const degree = length - 1;
  const re = new Float64Array(polynomial.length - 1), im = new Float64Array(polynomial.length - 1);
  for (let k = 0; k < degree; k++) {
    const angle = (2 * Math.PI * k) / degree + 0.4;
    re[k] = 0.9 * Math.cos(angle);
    im[k] = 0.9 * Math.sin(angle);
  }
  for (let step = 0; step < ROOT_STEPS; step++) {
    let moved = 0;
    for (let k = 0; k < degree; k++) moved = Math.max(moved, aberthStep(polynomial, degree, re, im, k));
    if (moved < 4 * EPSILON) break;
  }
  return { re, im };
}

/** Move one root by a step of Aberth's iteration; return how far it moved. */
function aberthStep(polynomial, degree, re, im, k) {
  newtonStep(polynomial, degree, re[k], im[k]);
  const stepRe = STEP[0], stepIm = STEP[1];
  if (stepRe === 0 && stepIm === 0) return 0;
  let sumRe = 0, sumIm = 0;
  for (let j = 0; j < degree; j++) {
    if (j === k) continue;
    const x = re[k] - re[j], y = im[k] - im[j], square = x * x + y * y || 1e-300;
    sumRe += x / square;
    sumIm -= y / square;
  }
  const x = 1 - (stepRe * sumRe - stepIm * sumIm), y = -(stepRe * sumIm + stepIm * sumRe);
  const square = x * x + y * y || 1e-300;
  const moveRe = (stepRe * x + stepIm * y) / square, moveIm = (stepIm * x - stepRe * y) / square;
  re[k] -= moveRe;
  im[k] -= moveIm;
  return Math.hypot(moveRe, moveIm);
}

const STEP = new Float64Array(2); // what newtonStep returns: new arrays would be most of the garbage

/** Put the step of Newton's method, p / p', into STEP, by Horner's rule; 0 where p is rounding. */
function newtonStep(polynomial, degree, x, y) {
  let re = 0, im = 0, slopeRe = 0, slopeIm = 0, size = 0;
  const modulus = Math.hypot(x, y);
  for (let k = 0; k <= degree; k++) {
    const nextSlope = slopeRe * x - slopeIm * y + re;
    slopeIm = slopeRe * y + slopeIm * x + im;
    slopeRe = nextSlope;
    const next = re * x - im * y + polynomial[k];
    im = re * y + im * x;
    re = next;
    size = size * modulus + Math.abs(polynomial[k]);
  }
  const square = slopeRe * slopeRe + slopeIm * slopeIm || 1e-300;
  const isRounding = Math.hypot(re, im) < 2 * EPSILON * size;
  STEP[0] = isRounding ? 0 : (re * slopeRe + im * slopeIm) / square;
  STEP[1] = isRounding ? 0 : (im * slopeRe - re * slopeIm) / square;
}

/**
 * Discs whose union holds all roots, each connected part as many as it has discs (Smith 1970).
 *
 * The rounding of the discs themselves is left out: they are no proof.
 * @param {number[]} polynomial
 * @param {number} error of each coefficient at most
 * @returns {{re: Float64Array, im: Float64Array, width: Float64Array}} centers and radii
 */
function rootDiscs(polynomial, error) {
  const { re, im } = rootsOf(polynomial), degree = re.length;
  const width = new Float64Array(degree);
  for (let k = 0; k < degree; k++) {
    const modulus = Math.hypot(re[k], im[k]);
    if (modulus === 0) continue; // a root at 0 is exact
    let distance = Math.abs(polynomial[0]);
    for (let j = 0; j < degree; j++) {
      if (j !== k) distance *= Math.hypot(re[k] - re[j], im[k] - im[j]);
    }
    const { value, size } = sizeAt(polynomial, re[k], im[k]);
    let powers = 0;
    for (let j = 0; j <= degree; j++) powers = powers * modulus + 1;
    width[k] = (degree * (value + error * powers + 2 * degree * EPSILON * size)) / distance;
  }
  return { re, im, width };
}

/** The modulus of a polynomial at a complex number, and that of its terms. */
function sizeAt(polynomial, x, y) {
  const modulus = Math.hypot(x, y), [re, im] = horner(polynomial, [x, y]);
  return {
    value: Math.hypot(re, im),
    size: polynomial.reduce((sum, coefficient) => sum * modulus + Math.abs(coefficient), 0),
  };
}

/**
 * What discs of roots say of stability.
 * @returns {number} STABLE, UNSTABLE or UNDECIDED
 */
function verdictOf({ re, im, width }) {
  const modulus = (k) => Math.hypot(re[k], im[k]);
  const every = Array.from(re.keys());
  if (every.every((k) => modulus(k) + width[k] < 1)) return STABLE;
  let outside = every.filter((k) => modulus(k) - width[k] > 1);
  for (let count = -1; count !== outside.length; ) {
    count = outside.length;
    const others = every.filter((k) => !outside.includes(k));
    const meets = (k, j) => Math.hypot(re[k] - re[j], im[k] - im[j]) <= width[k] + width[j];
    outside = outside.filter((k) => !others.some((j) => meets(k, j)));
  }
  return outside.length ? UNSTABLE : UNDECIDED;
}
