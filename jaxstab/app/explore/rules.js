// The simple rules beside the exact region: passivity and the linear rule.
"use strict";

const DIRECTIONS = 120; // of the passive region's outline
const PASSIVE_ANGLES = 240;
const passiveShapes = new Map(); // of damping 1, by delay

/**
 * The passive walls of a damping of 1, as [alpha, beta]: they grow in proportion to the damping.
 *
 * The condition of each angle (Colgate and Schenkel 1997; lemma C6 of docs/proofs.md) is
 * R + f (1 - f) |H|^2 / 4 < 1; along a ray from the origin R grows in proportion, |H|^2 as the
 * square.
 */
function passiveShape(delay) {
  if (passiveShapes.has(delay)) return passiveShapes.get(delay);
  const conditions = passiveConditions(delay), points = [];
  for (let k = 0; k <= DIRECTIONS; k++) {
    const direction = Math.PI * (k / DIRECTIONS - 0.5);
    const a = Math.cos(direction), b = Math.sin(direction);
    let reach = Infinity;
    for (const { ofStiffness, ofDamping, versine, folded } of conditions) {
      const rise = a * ofStiffness + b * ofDamping;
      const square = folded * (a * a + 2 * (a * b + b * b) * versine);
      const root = Math.sqrt(rise * rise + 4 * square);
      if (rise + root > 0) reach = Math.min(reach, 2 / (rise + root));
    }
    points.push([reach * a, reach * b]);
  }
  points.push([0, 0]);
  passiveShapes.set(delay, points);
  return points;
}

function passiveConditions(delay) {
  const whole = Math.floor(delay), fraction = delay - whole, conditions = [];
  const angles = PASSIVE_ANGLES * (1 + Math.ceil(delay / 4));
  for (let k = 0; k <= angles; k++) {
    const theta = (Math.PI * k) / angles, half = theta / 2;
    const part = (n) => sineRatio(2 * n + 1, half) / 2;
    const wave = (n) => -Math.cos((n + 1) * theta);
    conditions.push({
      ofStiffness: (1 - fraction) * part(whole) + fraction * part(whole + 1),
      ofDamping: (1 - fraction) * wave(whole) + fraction * wave(whole + 1),
      versine: 1 - Math.cos(theta),
      folded: (fraction * (1 - fraction)) / 4,
    });
  }
  return conditions;
}

/** Whether the velocity is the difference over one sample, for which the rules are made. */
function isPlain({ estimator }) {
  const { window, cutoff, factor, numerator } = estimator;
  return window === 1 && !(cutoff > 0) && !(factor > 0 && factor < 1) && !numerator;
}

/** The same setup with the velocity of the paper, the difference over one sample. */
function withOneSample(setup) {
  const estimator = { window: 1, cutoff: 0, order: 1, kind: "low-pass", factor: 1 };
  return { ...setup, estimator };
}

/** The outline of the passive walls in N/m and N s/m; empty where the theorem does not hold. */
function passiveWalls(setup) {
  if (!isPlain(setup) || !(setup.damping > 0)) return [];
  const per = setup.damping / setup.period; // delta m/T^2
  return passiveShape(setup.delay).map(([a, b]) => [a * per, b * setup.damping]);
}

/** The line (K, B) of the linear rule, which promises stability above it, between two K. */
function linearRule(setup, ends) {
  const lag = (setup.delay + 0.5) * setup.period, own = setup.damping + setup.handDamping;
  return ends.map((stiffness) => [stiffness, stiffness * lag - own]);
}
