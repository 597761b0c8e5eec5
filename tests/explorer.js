// What the tests ask of the explorer's scripts, in node and in a browser.
"use strict";

/** Points (alpha, beta) of the curve at angles. */
function curves(cases) {
  return cases.map(({ gamma, delta, delay, estimator, theta }) => {
    const loop = dimensionlessLoop(gamma, delta, delay, velocityOf(estimator, 1));
    return theta.map((angle) => {
      const { alpha, beta } = curvePoint(loop, angle);
      return [alpha, beta];
    });
  });
}

/** Verdicts and radii of walls, with their bounds. */
function verdicts(cases) {
  return cases.map((setup) => {
    const loop = loopOf(setup), scale = unitsOf(setup);
    return setup.walls.map(({ stiffness, damping }) => {
      const gains = [stiffness / scale.stiffness, damping / scale.damping];
      const { code, radius, bound } = verdictAndRadius(loop, ...gains);
      return [code, radius, bound];
    });
  });
}

/** Regions in SI units. */
function regions(cases) {
  return cases.map((setup) => {
    const loop = loopOf(setup), scale = unitsOf(setup), region = regionOf(loop);
    const inUnits = (wall) => wall ? [wall[0] * scale.stiffness, wall[1] * scale.damping] : [null, null];
    return {
      isClosed: region.isClosed,
      hasMain: Boolean(mainOf(region)),
      areas: region.components.map(({ area }) => area * scale.stiffness * scale.damping),
      farthest: region.components.map((one) => [0, 1].map((axis) => inUnits(farthest(loop, one, axis)))),
    };
  });
}

/** What the page says of the stiffest wall of loops. */
function headlines(cases) {
  globalThis.units = () => ({ stiffness: "N/m", damping: "N s/m" });
  return cases.map((setup) => {
    const loop = loopOf(setup), scale = unitsOf(setup), region = regionOf(loop), main = mainOf(region);
    if (!main) return headlineOf(null, region, false);
    return headlineOf(printedWall(loop, scale, farthest(loop, main, 0), region.isClosed), region, false);
  });
}

/** Margins and settling times of walls; JSON has null for what is NaN or infinite. */
function walls(cases) {
  return cases.map((setup) => {
    const loop = loopOf(setup), region = regionOf(loop);
    return setup.walls.map((wall) => wallFacts(setup, loop, region, wall));
  });
}

/** Outlines of passive walls in SI units. */
function passives(cases) {
  return cases.map(passiveWalls);
}

/** States that went through a link. */
function links(states) {
  const other = { ...states[0], mass: 77, walls: [], view: "all" };
  return states.map((state) => stateOfHash(hashOf(state), other));
}

/** States as scenes. */
function scenes(states) {
  return states.map(sceneOf);
}

/** Lines of the linear rule between two stiffnesses. */
function rules(cases) {
  return cases.map((setup) => linearRule(setup, [0, 1000]));
}

/** Simulated contacts with a wall each. */
function contacts(cases) {
  return cases.map((setup) => {
    const { positions, ...answer } = contactOf(setup, setup.wall, setup.conditions);
    return { ...answer, positions: Array.from(positions) };
  });
}

/** The worst of the contacts that begin at rest and at a speed. */
function worstContacts(cases) {
  return cases.map((setup) => {
    const { kind, speed } = worstContactOf(setup, setup.wall, setup.conditions, [0, setup.conditions.speed]);
    return { kind, speed };
  });
}

/** Why contacts are not simulated. */
function refusals(cases) {
  return cases.map((setup) => whyNoContact(setup, setup.wall, setup.conditions));
}
