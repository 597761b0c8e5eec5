// The controls: a slider and a number for each quantity, and a choice of software.
"use strict";

const PLACES = 400; // of a slider

const byId = (id) => document.getElementById(id);
const units = () => initial.units[state.motion];

/** An element of HTML with properties. */
function html(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

/** A label, a slider and a number for a quantity; change gets values in SI units. */
function rowOf(quantity, context, change) {
  const { key, label, unit, scale } = quantity, name = `${context}${label}`;
  const slider = html("input", { type: "range", min: 0, max: PLACES, step: 1, id: `${key}-slider` });
  const number = html("input", { type: "number", step: "any", id: `${key}-number` });
  if (!quantity.isFree) number.min = 0;
  slider.setAttribute("aria-label", name);
  number.setAttribute("aria-label", `${name} in ${unit}`);
  slider.addEventListener("input", () => change(valueAtPlace(quantity, slider.value / PLACES), slider));
  number.addEventListener("change", () => change(Number(number.value) / scale, number));
  const text = html("span", { textContent: label });
  const shown = html("span", { className: "unit", textContent: unit });
  return html("div", { className: "row" }, text, slider, number, shown);
}

/** Set a property where it changes: what is set is laid out anew. */
function assign(target, name, value) {
  if (target[name] !== value) target[name] = value;
}

/** Show a value in its row, but not in what the user is moving. */
function showIn(quantity, value, moved) {
  const slider = byId(`${quantity.key}-slider`), number = byId(`${quantity.key}-number`);
  const place = Math.round(placeOfValue(quantity, value) * PLACES);
  if (slider !== moved) assign(slider, "value", String(place));
  const isNone = quantity.key === "cutoff" && !(value > 0);
  const words = isNone ? "" : String(Number((value * quantity.scale).toPrecision(MOST_DIGITS)));
  assign(number, "value", words);
  assign(number, "placeholder", isNone ? "none" : "");
  assign(slider, "ariaValueText", isNone ? "none" : `${words} ${quantity.unit}`);
}

/** Build the controls of the loop. */
function buildControls() {
  const groups = { velocity: "How the velocity is estimated", controller: "Controller", device: "Device", hand: "Hand" };
  for (const [group, title] of Object.entries(groups)) {
    const set = html("fieldset", {}, html("legend", { textContent: title }));
    if (group === "velocity") set.append(softwareChoice());
    for (const quantity of quantitiesOf(state.motion).filter((one) => one.group === group)) {
      set.append(rowOf(quantity, `${title}: `, (value, moved) => changeTo(quantity.key, value, moved)));
    }
    if (group === "hand" && initial.hands) set.append(...handChoices());
    set.append(html("p", { className: "hint", id: `${group}-hint` }));
    byId("controls").append(set);
  }
}

/** Buttons for the ends of the scene's range of hands. */
function handChoices() {
  return Object.entries(initial.hands).map(([end, hand]) => {
    const button = html("button", { type: "button", textContent: `${end} hand of the scene` });
    button.addEventListener("click", () => update(hand));
    return button;
  });
}

/** A choice of estimators by the software that has them. */
function softwareChoice() {
  const choice = html("select", { id: "software" }, html("option", { value: "", textContent: "as set below" }));
  choice.setAttribute("aria-label", "Velocity as a software estimates it");
  initial.software.forEach(({ title }, index) => choice.append(html("option", { value: index, textContent: title })));
  choice.addEventListener("change", () => {
    const chosen = initial.software[choice.value], next = chosen && estimatorOf(chosen, state.period);
    if (!next) return;
    const refusal = next.window ? "" : refusalOf("window", `the window of ${chosen.title} in samples`);
    update(refusal ? {} : next, null, refusal);
  });
  return choice;
}

/** The estimator of a software at a sampling period: its window becomes whole samples. */
function estimatorOf({ window, cutoff, order, kind, factor, numerator, denominator }, period) {
  const samples = window ? acceptable("window", window / period) : 1;
  return {
    window: samples, cutoff: cutoff || 0, order: order || 1, kind: kind || "low-pass",
    factor: factor || 1, numerator: numerator || null, denominator: denominator || null,
  };
}

/** The software whose estimator that of a state is, as its place in the choice; -1 where there is none. */
function softwareOf(state) {
  const text = JSON.stringify;
  return initial.software.findIndex((software) =>
    Object.entries(estimatorOf(software, state.period)).every(([key, value]) => text(value) === text(state[key])));
}

/** Why a value is refused, in words. */
function refusalOf(key, label) {
  return `${label} must be a number ${boundsOf(key)[2]}`;
}

/** Take a value of a control over, if it is one that can be computed. */
function changeTo(key, value, moved) {
  const next = { [key]: acceptable(key, value) };
  if (Number.isNaN(next[key])) {
    return update({}, null, refusalOf(key, quantitiesOf(state.motion).find((one) => one.key === key).label));
  }
  if (key === "window" || key === "cutoff") Object.assign(next, { numerator: null, denominator: null });
  return update(next, moved);
}

/** Build the switch for simulated contacts, and what it asks for. */
function buildContact() {
  for (const quantity of quantitiesOf(state.motion).filter((one) => one.group === "contact")) {
    byId("contact-controls").append(rowOf(quantity, "Contact: ", (value, moved) => changeTo(quantity.key, value, moved)));
  }
  const isOn = byId("contact-on");
  isOn.addEventListener("change", () => update({ contact: isOn.checked ? "on" : "off" }));
}

/** The cursor's two sliders, which go as far as the axes. */
function cursorQuantities() {
  const ends = drawn ? drawn.frame.ends : [[0, 1], [0, 1]];
  return ["Stiffness", "Damping"].map((word, axis) => ({
    key: `cursor${word}`, label: `${word.toLowerCase()} ${"KB"[axis]}`,
    unit: [units().stiffness, units().damping][axis], scale: 1, map: "linear", isFree: true,
    low: ends[axis][0], high: ends[axis][1],
  }));
}

function buildCursor() {
  cursorQuantities().forEach((quantity, axis) => {
    const row = rowOf(quantity, "Cursor: ", (value, moved) => {
      const place = moved.value / PLACES; // of the axes as they are now
      const next = moved.type === "range" ? valueAtPlace(cursorQuantities()[axis], place) : value;
      update(Number.isFinite(next) ? { [quantity.key]: next } : {}, moved);
    });
    byId("cursor-controls").append(row);
  });
}
