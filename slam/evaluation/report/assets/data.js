"use strict";
// The document that the page carries, and small things that all drawings need.

/** Read what Python's `pack` wrote: JSON, compressed, as base64. */
async function unpack(text) {
  const bytes = Uint8Array.from(atob(text.trim()), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return JSON.parse(await new Response(stream).text());
}

/** Values of a column that Python's `column` wrote; null where there is none. */
function decode({scale, steps}) {
  let sum = 0;
  return steps.map(step => (step === null ? null : (sum += step) / scale));
}

function decodeAll(columns) {
  const isColumn = value => value !== null && typeof value === "object" && "steps" in value;
  return Object.fromEntries(
    Object.entries(columns).map(([name, value]) => [name, isColumn(value) ? decode(value) : value]),
  );
}

/** A colour of the style sheet, as it is now: light, dark, or on paper. */
const colour = name =>
  getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** A number with its unit; a dash where there is none. */
function figure(value, digits, unit = "") {
  return value === null || value === undefined || Number.isNaN(value)
    ? "–"
    : value.toFixed(digits) + unit;
}

/** An element with properties and children; text stays text, whatever a log may say. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

/** A list of names and values; those without a value are left out. */
function factList(facts) {
  const known = facts.filter(([, text]) => text !== null && text !== undefined);
  return element(
    "dl",
    {className: "facts"},
    ...known.flatMap(([name, text]) => [element("dt", {}, name), element("dd", {}, text)]),
  );
}

/** Index of the last value that is not above `wanted`; values ascend; -1 if there is none. */
function lastUpTo(values, wanted) {
  let low = 0,
    high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] <= wanted) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** Degrees in (-180, 180]. */
const wrapped = degrees =>
  degrees === null ? null : degrees - 360 * Math.ceil((degrees - 180) / 360);

const onPaper = () => document.documentElement.classList.contains("paper");
