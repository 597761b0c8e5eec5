// The stable set in the plane of alpha and beta: pieces of the curve and of the two lines of a real
// root at z = 1 and z = -1 on which all other roots are inside, joined to loops.
"use strict";

const FIRST_ANGLE = 1e-7; // from both ends of the curve
const CLOSE = 1e-5; // to a resonance
const HALVINGS = 40; // of an interval of angles in which something changes
const LOOKS = 4; // at a region that does not close, each closer
const MOST_PIECES = 150; // of a curve: more are rounding
const MOST_SUSPECTS = 60;
const NEAR_CIRCLE = 3e-3; // roots that may be on it next to a corner
const OPEN = 1e-4; // of the region's size: ends that are farther from each other do not meet
const SMOOTH = 4e-4; // of the region's size: how far the boundary may leave its polygon
const MOST_SPLITS = 7;
const SMALL = 1e-6; // of the region's size: gains that turning up from 0 reaches first

/**
 * A part of the boundary; seen along its points, the stable set is on the left.
 * @typedef {object} Piece
 * @property {number[][]} points [alpha, beta]
 * @property {string} branch "curve", "z = 1" or "z = -1"
 * @property {number[]} [angles] of the points, on the curve
 */

/**
 * A connected part of the stable set: its outer boundary.
 * @typedef {{points: number[][], area: number, holdsSmallGains: boolean, pieces: Piece[]}} Component
 */

/** Angles of the scan, in order: even steps, finer to both ends and where the loop resonates. */
function scanAngles(loop, fineness, suspects) {
  const count = fineness * (240 + 8 * loop.base.length), step = Math.PI / count;
  const angles = [];
  for (let k = 0; k < count; k++) angles.push((k + 0.5) * step);
  const growth = 10 ** (1 / (4 * fineness));
  for (let offset = FIRST_ANGLE; offset < step; offset *= growth) angles.push(offset, Math.PI - offset);
  for (const center of [...resonances(loop), ...suspects]) {
    for (let offset = CLOSE; offset < step; offset *= growth * growth) {
      angles.push(center - offset, center + offset);
    }
  }
  return angles.filter((one) => one > 0 && one < Math.PI).sort((a, b) => a - b);
}

/** The angles at which the hand swings, or the window lets nothing through. */
function resonances(loop) {
  const { plant, window } = loop, found = [];
  const square = plant.gamma - plant.delta ** 2 / 4;
  if (square > 0 && Math.sqrt(square) < Math.PI) found.push(Math.sqrt(square));
  for (let k = 1; k < window; k++) found.push((k * Math.PI) / window);
  return found;
}

/** The angles of roots next to the circle at the ends of pieces: there others may be hidden. */
function suspectsOf(loop, curve) {
  const found = [];
  for (const { samples } of curve) {
    for (const { alpha, beta } of [samples[0], samples[samples.length - 1]]) {
      const { re, im } = rootsOf(closedLoop(loop, alpha, beta));
      re.forEach((x, k) => {
        const isNear = Math.abs(Math.hypot(x, im[k]) - 1) < NEAR_CIRCLE;
        if (isNear && im[k] > CLOSE) found.push(Math.atan2(im[k], x));
      });
    }
  }
  return found.slice(0, MOST_SUSPECTS);
}

/** Whether all roots but the pair at exp(+-i theta) are inside, at a point of the curve. */
function othersInside(loop, theta, point) {
  if (!Number.isFinite(point.alpha + point.beta)) return false;
  const work = closedLoopAtWork(loop, point.alpha, point.beta);
  divideByPair(work, work.length, Math.cos(theta));
  return isInside(work, work.length - 3);
}

/** The curve at an angle, and whether it bounds the stable set there. */
function lookAt(loop, theta) {
  const point = curvePoint(loop, theta);
  point.theta = theta;
  point.bounds = othersInside(loop, theta, point);
  return point;
}

/** The point where what bounds begins or ends, between two neighbours of the scan. */
function edgeBetween(loop, inside, outside) {
  for (let k = 0; k < HALVINGS; k++) {
    const middle = lookAt(loop, 0.5 * (inside.theta + outside.theta));
    if (middle.bounds && middle.sign === inside.sign) inside = middle;
    else outside = middle;
  }
  return inside;
}

/** How many pieces of the curve begin in a scan. */
function startsIn(scan) {
  return scan.filter((point, k) => point.bounds && !(k && scan[k - 1].bounds)).length;
}

/** The pieces of the curve that bound the stable set. */
function curvePieces(loop, scan) {
  const pieces = [];
  let run = [];
  for (let k = 0; k <= scan.length; k++) {
    const point = scan[k], before = scan[k - 1];
    const goesOn = point && run.length && point.bounds && point.sign === before.sign;
    if (run.length && !goesOn) {
      if (point) run.push(edgeBetween(loop, before, point));
      pieces.push(run);
      run = [];
    }
    if (point && point.bounds) {
      if (!run.length && before) run.push(edgeBetween(loop, point, before));
      run.push(point);
    }
  }
  return pieces.map((points) => ({
    branch: "curve",
    samples: points[0].sign < 0 ? points.reverse() : points,
  }));
}

/**
 * The line of a real root at z = end, as a point and a direction with the stable side on its left.
 * @param {1|-1} end
 */
function lineOf(loop, end) {
  if (end === 1) return { through: [-loop.plant.gamma, 0], along: [0, -1] };
  const { base, stiffness, damping, plant } = loop;
  if (Math.abs(plant.atMinusOne) < 1e-13 * plant.total) return null; // it is at infinity
  const sign = base.length % 2 ? 1 : -1; // of z to the degree of p
  const [a, b, rest] = [stiffness, damping, base].map((one) => sign * valueAt(one, -1));
  const square = a * a + b * b;
  return { through: [(-rest * a) / square, (-rest * b) / square], along: [b, -a] };
}

/** How far a point is to the left of a line. */
function sideOf(line, alpha, beta) {
  const [x, y] = line.along;
  return x * (beta - line.through[1]) - y * (alpha - line.through[0]);
}

/** Where along a line a point is, in units of its direction. */
function placeOn(line, alpha, beta) {
  const [x, y] = line.along;
  return (x * (alpha - line.through[0]) + y * (beta - line.through[1])) / (x * x + y * y);
}

/** The point at a place along a line. */
function pointOn(line, place) {
  return [line.through[0] + place * line.along[0], line.through[1] + place * line.along[1]];
}

/** The places along a line where a stable part may begin or end: where the curve leaves it. */
function placesOn(line, other, curve) {
  const places = [];
  for (const { samples } of curve) {
    for (const { alpha, beta } of [samples[0], samples[samples.length - 1]]) {
      places.push(placeOn(line, alpha, beta));
    }
  }
  if (other) {
    const speed = sideOf(other, ...pointOn(line, 1)) - sideOf(other, ...line.through);
    if (speed !== 0) places.push(-sideOf(other, ...line.through) / speed);
  }
  return places.filter(Number.isFinite).sort((a, b) => a - b);
}

/** The pieces of the line of a real root at z = end that bound the stable set. */
function linePieces(loop, curve, end) {
  const line = lineOf(loop, end), pieces = [];
  if (!line) return pieces;
  const places = placesOn(line, lineOf(loop, -end), curve);
  for (let k = 1; k < places.length; k++) {
    if (places[k] === places[k - 1]) continue;
    const middle = pointOn(line, 0.5 * (places[k - 1] + places[k]));
    const work = closedLoopAtWork(loop, ...middle);
    divideByRoot(work, work.length, end);
    if (!isInside(work, work.length - 2)) continue;
    const points = [places[k - 1], places[k]].map((place) => pointOn(line, place));
    pieces.push({ branch: end === 1 ? "z = 1" : "z = -1", points });
  }
  return pieces;
}

// --------------------------------------------------------------------------------------- outlines

/** How far points reach in alpha and in beta. */
function extentOf(points) {
  const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (const point of points) {
    for (const axis of [0, 1]) {
      low[axis] = Math.min(low[axis], point[axis]);
      high[axis] = Math.max(high[axis], point[axis]);
    }
  }
  return { low, high, size: [high[0] - low[0] || 1, high[1] - low[1] || 1] };
}

/** The distance of two points, in units of an extent. */
function apart(one, other, size) {
  return Math.hypot((one[0] - other[0]) / size[0], (one[1] - other[1]) / size[1]);
}

/** Give a piece of the curve points so close that straight lines between them are not seen. */
function smoothed(loop, piece, size) {
  if (!piece.samples) return piece;
  const at = (theta) => {
    const { alpha, beta } = curvePoint(loop, theta);
    return [alpha, beta];
  };
  const points = [], angles = [];
  const split = (first, start, last, end, depth) => {
    const middle = 0.5 * (first + last), point = at(middle);
    const chord = [0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])];
    const isSmooth = apart(point, chord, size) < SMOOTH;
    if (!isSmooth && depth < MOST_SPLITS) {
      split(first, start, middle, point, depth + 1);
      split(middle, point, last, end, depth + 1);
    } else {
      points.push(end);
      angles.push(last);
    }
  };
  const first = piece.samples[0];
  points.push([first.alpha, first.beta]);
  angles.push(first.theta);
  for (let k = 1; k < piece.samples.length; k++) {
    const [from, to] = [piece.samples[k - 1], piece.samples[k]];
    split(from.theta, [from.alpha, from.beta], to.theta, [to.alpha, to.beta], 0);
  }
  return { branch: piece.branch, points, angles };
}

/** The points of a piece, or those of its samples before it is smoothed. */
function pointsOf(piece) {
  return piece.points || piece.samples.map(({ alpha, beta }) => [alpha, beta]);
}

/** The first and the last point of a piece. */
function endsOf(piece) {
  const points = pointsOf(piece);
  return [points[0], points[points.length - 1]];
}

/** Join pieces to loops, each end to the nearest beginning; gap is the widest one left. */
function loopsOf(pieces, size) {
  const ends = new Map(pieces.map((piece) => [piece, endsOf(piece)]));
  const free = new Set(pieces), loops = [];
  let gap = 0;
  while (free.size) {
    const [first] = free, chain = [];
    let piece = first;
    do {
      chain.push(piece);
      free.delete(piece);
      const [, end] = ends.get(piece);
      let nearest = first, least = apart(end, ends.get(first)[0], size);
      for (const other of free) {
        const distance = apart(end, ends.get(other)[0], size);
        if (distance < least) [nearest, least] = [other, distance];
      }
      gap = Math.max(gap, least);
      piece = nearest;
    } while (piece !== first);
    loops.push(chain);
  }
  return { loops, gap };
}

/** The area that a loop of points encloses, positive where it is to the left. */
function areaOf(points) {
  let sum = 0;
  points.forEach(([x, y], k) => {
    const [u, v] = points[(k + 1) % points.length];
    sum += x * v - u * y;
  });
  return sum / 2;
}

/** Whether a point is inside of a loop of points. */
function holds(points, [x, y]) {
  let inside = false;
  for (let k = 0, j = points.length - 1; k < points.length; j = k++) {
    const [[ax, ay], [bx, by]] = [points[k], points[j]];
    if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) inside = !inside;
  }
  return inside;
}

/** Whether positive gains next to 0 are inside, or all are stable until one is: polygons are coarse. */
function holdsSmallGains(loop, points) {
  const { low, high } = extentOf(points);
  const most = [0, 1].map((axis) => Math.max(Math.abs(low[axis]), Math.abs(high[axis])));
  for (let ratio = -6; ratio <= 6; ratio++) { // of alpha to beta, in units of what the component spans
    const way = [most[0] * 10 ** Math.min(ratio, 0), most[1] * 10 ** Math.min(-ratio, 0)];
    for (let share = SMALL; share < 0.1; share *= 2) {
      const wall = way.map((one) => share * one);
      if (holds(points, wall)) return true;
      if (!isStable(loop, ...wall)) break;
    }
  }
  return false;
}

/** @returns {Component} */
function componentOf(loop, chain) {
  const { size } = extentOf(chain.flatMap(pointsOf));
  const pieces = chain.map((piece) => smoothed(loop, piece, size)), points = pieces.flatMap((one) => one.points);
  return { points, area: areaOf(points), holdsSmallGains: holdsSmallGains(loop, points), pieces };
}

/**
 * The stable set of a loop.
 * @param {Loop} loop
 * @returns {{components: Component[], isClosed: boolean}} first what turning gains up from 0
 *   reaches, if there is such a component, then islands by their area
 */
function regionOf(loop, looks = LOOKS) {
  let suspects = [], found;
  for (let look = 1; look <= looks; look++) {
    const scan = scanAngles(loop, look, suspects).map((theta) => lookAt(loop, theta));
    if (startsIn(scan) > MOST_PIECES) return { components: [], isClosed: false };
    const curve = curvePieces(loop, scan);
    found = regionWithin(loop, curve);
    if (found.isClosed) break;
    suspects = suspectsOf(loop, curve);
  }
  return found;
}

/** The stable set that these pieces of the curve bound, and pieces of the lines. */
function regionWithin(loop, curve) {
  const pieces = [...curve, ...linePieces(loop, curve, 1), ...linePieces(loop, curve, -1)];
  const { loops, gap } = loopsOf(pieces, extentOf(pieces.flatMap(pointsOf)).size);
  const components = loops.map((chain) => componentOf(loop, chain)).filter(({ area }) => area > 0);
  components.sort((a, b) => b.holdsSmallGains - a.holdsSmallGains || b.area - a.area);
  return { components, isClosed: gap < OPEN };
}

/** The component that turning gains up from 0 reaches; undefined where small gains are unstable. */
function mainOf(region) {
  return region.components.find((component) => component.holdsSmallGains);
}

/**
 * The point of a component that is farthest along an axis, of those where the other gain is not
 * negative; undefined where there are none.
 * @param {0|1} axis 0 for alpha, 1 for beta
 */
function farthest(loop, component, axis) {
  const other = 1 - axis;
  let best;
  const offer = (point) => {
    if (point[other] >= 0 && !(best && point[axis] <= best[axis])) best = point;
  };
  for (const { points, angles } of component.pieces) {
    points.forEach((point, index) => {
      offer(point);
      const last = points[index - 1], next = points[index + 1];
      if (last && last[other] < 0 !== point[other] < 0) offer(onAxis(loop, last, point, angles && [angles[index - 1], angles[index]], other));
      if (angles && last && next && point[axis] > last[axis] && point[axis] > next[axis]) offer(refinedPeak(loop, angles[index - 1], angles[index + 1], axis));
    });
  }
  return best;
}

/** Where the boundary crosses 0 of a gain between two points of a line or, with angles, of the curve. */
function onAxis(loop, here, there, angles, gain) {
  const share = here[gain] / (here[gain] - there[gain]);
  const point = here.map((value, axis) => value + share * (there[axis] - value));
  if (angles) {
    let [low, high] = angles;
    for (let k = 0; k < HALVINGS; k++) {
      const middle = 0.5 * (low + high);
      if (wallAt(loop, middle)[gain] < 0 === here[gain] < 0) low = middle;
      else high = middle;
    }
    point.splice(0, 2, ...wallAt(loop, high));
  }
  point[gain] = 0;
  return point;
}

/** The wall with roots at an angle. */
function wallAt(loop, theta) {
  const { alpha, beta } = curvePoint(loop, theta);
  return [alpha, beta];
}

/** The farthest point of the curve between two angles, by the golden section. */
function refinedPeak(loop, low, high, axis) {
  const golden = (Math.sqrt(5) - 1) / 2;
  for (let k = 0; k < HALVINGS; k++) {
    const width = golden * (high - low), first = high - width, second = low + width;
    if (wallAt(loop, first)[axis] > wallAt(loop, second)[axis]) high = second;
    else low = first;
  }
  return wallAt(loop, 0.5 * (low + high));
}
