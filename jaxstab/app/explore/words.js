// What is said of a state in words, beside and below the picture.
"use strict";

const IN_ALL_DIGITS = new Intl.NumberFormat("en", { maximumSignificantDigits: MOST_DIGITS });

/** A number with all of its digits. */
function inDigits(value) {
  return value === 0 || Math.abs(value) >= 1e-3 ? IN_ALL_DIGITS.format(value) : String(value);
}

/** A largest stiffness with its unit, rounded down. */
function stiffnessInWords(stiffness) {
  return `${inDigits(rounded(stiffness, LIMIT_DIGITS, -1))} ${units().stiffness}`;
}

/** An interval with its unit, its ends rounded inwards. */
function rangeInWords([low, high], unit) {
  const least = Math.abs(low) < NOTHING * high ? 0 : rounded(low, LIMIT_DIGITS, 1);
  return `${inDigits(least)} to ${inDigits(rounded(high, LIMIT_DIGITS, -1))} ${unit}`;
}

/** Say what is the stiffest wall, and what the estimator costs. */
function sayHeadline({ stiffest, printed, plain, region, setup, isRough }) {
  const headline = headlineOf(printed, region, isRough), comparison = comparisonOf(stiffest, plain, setup);
  assign(byId("headline"), "textContent", headline);
  assign(byId("comparison"), "textContent", comparison);
  const title = `The plane of stiffness K and damping B. ${headline} ${comparison}`;
  assign(byId("picture-title"), "textContent", title);
}

function headlineOf(stiffest, region, isRough) {
  const late = isRough ? " Its outline is not resolved yet." : " Its outline was not resolved: it may be wrong.";
  const open = region.isClosed ? "" : late;
  if (stiffest) {
    const [stiffness, damping] = stiffest.map(inDigits);
    return `The stiffest stable wall: ${stiffness} ${units().stiffness}, at a damping of ${damping} ${units().damping}.${open}`;
  }
  if (mainOf(region) || (!region.isClosed && !region.components.length)) {
    return isRough ? "The stable region is not resolved yet." : "The stable region was not resolved here; jaxstab limits knows more.";
  }
  const none = region.components.length ? "Small gains are not stable, but others are." : "No wall is stable.";
  return `${none}${open}`;
}

function comparisonOf(stiffest, plain, setup) {
  if (!plain) return "The velocity is the difference over one sample. Software that people run takes a window or a filter.";
  const now = `The velocity is ${estimatorInWords(setup)}. Over one sample the stiffest wall would be ${stiffnessInWords(plain.stiffness)}`;
  const ratio = stiffest ? plain.stiffness / stiffest[0] : 1;
  return ratio > 1.01 ? `${now}: ${short(rounded(ratio, 3))} times as stiff.` : `${now}.`;
}

/** Name what is drawn. */
function showLegend({ islands, setup, plain }, view) {
  const rows = [["stable", "stable"]];
  if (islands.length) rows.push(["island", "stable, but not reached by turning gains up"]);
  if (plain) rows.push(["ghost", "stable with the difference over one sample"]);
  rows.push(["rule", `linear rule${plain ? " (it ignores filters)" : ""}: promises stability above the line`]);
  if (view.passive.length) {
    const most = Math.max(...view.passive.map(([stiffness]) => stiffness));
    rows.push(["passive", `passive for any hand, up to ${stiffnessInWords(most)}`]);
  } else {
    rows.push(["", setup.damping > 0 ? "the passive region is known for the difference over one sample only" : "without damping of the device no wall is passive"]);
  }
  const words = rows.map(([, text]) => text).join("|");
  if (byId("legend").dataset.words === words) return;
  byId("legend").dataset.words = words;
  byId("legend").replaceChildren(...rows.map(([look, text]) => html("li", {}, sampleOf(look), text)));
}

/** A sample of how something is drawn. */
function sampleOf(look) {
  if (!look) return "";
  const svg = element("svg", { viewBox: "0 0 26 14", "aria-hidden": "true" });
  const isLine = look === "ghost" || look === "rule";
  svg.append(isLine ? element("path", { class: look, d: "M0 7H26" }) : element("rect", { class: look, x: 1, y: 1, width: 24, height: 12 }));
  return svg;
}

const VERDICTS = { [STABLE]: "stable", [UNSTABLE]: "unstable", [UNDECIDED]: "undecided" };
const LOOKS_OF_VERDICTS = { [STABLE]: "good", [UNSTABLE]: "bad", [UNDECIDED]: "" };

/** Show the verdicts of the walls in their rows, which are built anew where walls come or go. */
function showVerdicts(walls) {
  const body = byId("walls").tBodies[0], key = JSON.stringify(state.walls.map(({ name }) => name));
  if (body.dataset.key !== key) buildWalls(body, key);
  walls.forEach(({ stiffness, damping, code, radius }, index) => {
    const cells = body.rows[index].cells;
    const [first, second] = [cells[1].firstChild, cells[2].firstChild];
    if (document.activeElement !== first) assign(first, "value", String(stiffness));
    if (document.activeElement !== second) assign(second, "value", String(damping));
    assign(cells[3], "textContent", VERDICTS[code]);
    cells[3].className = LOOKS_OF_VERDICTS[code];
    assign(cells[4], "textContent", radius.toFixed(5));
  });
}

function buildWalls(body, key) {
  body.dataset.key = key;
  body.replaceChildren(...state.walls.map((wall, index) => {
    const input = (field, words) => {
      const made = html("input", { type: "number", step: "any", value: wall[field] });
      made.setAttribute("aria-label", `${words} of wall ${wall.name}`);
      made.addEventListener("change", () => changeWall(index, { [field]: Number(made.value) }));
      return html("td", {}, made);
    };
    const remove = html("button", { type: "button", textContent: "Remove" });
    remove.setAttribute("aria-label", `Remove wall ${wall.name}`);
    remove.addEventListener("click", () => {
      update({ walls: state.walls.filter((_, other) => other !== index) });
      byId("wall-name").focus();
    });
    const name = html("th", { scope: "row", textContent: wall.name });
    return html("tr", {}, name, input("stiffness", "stiffness"), input("damping", "damping"), html("td", {}), html("td", {}), html("td", {}, remove));
  }));
}

function changeWall(index, change) {
  if (Object.values(change).some((value) => !Number.isFinite(value))) return;
  update({ walls: state.walls.map((wall, other) => (other === index ? { ...wall, ...change } : wall)) });
}

/** How a simulated contact ends. */
function contactInWords({ kind, amplitude, frequency, timeToRest, speed }) {
  const rate = Number.isFinite(frequency) ? ` at ${short(rounded(frequency, 3))} Hz` : "";
  const motion = `amplitude ${short(rounded(amplitude * 1e3, 3))} ${smallUnit()}${rate}`;
  const words = {
    rests: `rests after ${short(rounded(timeToRest, 3))} s`,
    oscillates: `oscillates in contact with the wall, ${motion}`,
    bounces: `leaves the wall and returns to it, ${motion}`,
    grows: "the motion grows",
    decays: `still moves after ${DURATION} s, less and less`,
    outside: "outside of the wall at the end",
  };
  return `simulated${speed > 0 ? ` from ${short(speed)} ${state.motion === "rotation" ? "rad" : "m"}/s` : ""}: ${words[kind]}`;
}

/** The unit in which positions are drawn: a thousandth of the scene's. */
function smallUnit() {
  return state.motion === "rotation" ? "mrad" : "mm";
}

/** Say at once whether the cursor is stable, and by which radius. */
function showCursorVerdict({ code, radius, bound }) {
  const words = byId("cursor-verdict");
  words.textContent = `${VERDICTS[code]}, spectral radius ${radius.toFixed(bound < 1e-6 ? 6 : 4)} (computed here, not proved)`;
  words.className = `verdict ${LOOKS_OF_VERDICTS[code]}`;
}

