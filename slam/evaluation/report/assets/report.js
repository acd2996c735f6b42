"use strict";
// Puts the drawings into the page and keeps them together.

/** The values at the kth pose of a run, in words. */
function factsOf(run) {
  const {path, keyframes} = run;
  const value = (name, k, digits, unit) =>
    path[name] ? figure(path[name][k], digits, unit) : null;
  return k => {
    const latest = keyframes.t ? lastUpTo(keyframes.t, path.t[k]) : -1;
    const since = latest >= 0 ? path.t[k] - keyframes.t[latest] : 0;
    return [
      ["time", value("t", k, 3, " s")],
      ["x", value("x", k, 3, " m")],
      ["y", value("y", k, 3, " m")],
      ["heading", figure(wrapped(path.heading[k]), 2, "°")],
      [run.error_of, value("error", k, 4, " m")],
      ["sigma", value("sigma", k, 4, " m")],
      ["sigma of heading", value("sigma_heading", k, 3, "°")],
      ["speed", value("speed", k, 2, " m/s")],
      [
        "keyframe",
        latest < 0
          ? null
          : since < 0.0005
            ? `${latest}`
            : `${latest}, ${figure(since, 1, " s")} ago`,
      ],
      ["taken because of", latest < 0 ? null : keyframes.reasons[keyframes.reason[latest]] || null],
      [
        "T_PE",
        latest < 0 || keyframes.t_pe[latest] === null ? null : figure(keyframes.t_pe[latest], 3),
      ],
    ];
  };
}

function prepare(run) {
  const made = {
    ...run,
    path: decodeAll(run.path),
    keyframes: decodeAll(run.keyframes),
    closures: decodeAll(run.closures),
    drawings: [],
  };
  made.facts = factsOf(made);
  made.show = k => made.drawings.forEach(drawing => drawing.show?.(k));
  return made;
}

function linkTable(table, run, drawing, place) {
  for (const row of table.querySelectorAll("tr[data-closure]")) {
    const open = () => {
      drawing.closures.open(Number(row.dataset.closure));
      place.scrollIntoView({block: "nearest"});
    };
    row.cells[0].prepend(element("button", {type: "button", onclick: open}, "show"), " ");
  }
}

async function start() {
  const {runs: packed} = await unpack(document.getElementById("data").textContent);
  const runs = packed.map(prepare),
    drawings = [];
  for (const place of document.querySelectorAll("[data-map]")) {
    const run = runs[place.dataset.map];
    const drawing = run ? drawRunMap(place, run) : drawAllPaths(place, runs);
    drawings.push(drawing);
    if (!run) continue;
    run.drawings.push(drawing);
    const table = document.querySelector(`table.closures[data-run="${place.dataset.map}"]`);
    if (table) linkTable(table, run, drawing, place.parentElement);
  }
  for (const host of document.querySelectorAll("[data-chart]")) {
    const run = runs[host.dataset.run],
      drawing = drawChart(host, run.charts[host.dataset.chart], run);
    drawings.push(drawing);
    if (drawing.show) run.drawings.push(drawing);
  }
  for (const host of document.querySelectorAll("[data-compare]")) {
    host.parentElement.hidden = false;
    const drawing = drawErrors(host, runs);
    host.parentElement.hidden = !drawing;
    if (drawing) drawings.push(drawing);
  }
  const drawAll = () => drawings.forEach(drawing => drawing.draw());
  const toPaper = paper => {
    if (paper === onPaper()) return;
    document.documentElement.classList.toggle("paper", paper);
    drawAll();
  };
  addEventListener("beforeprint", () => toPaper(true));
  addEventListener("afterprint", () => toPaper(false));
  matchMedia("print").addEventListener("change", event => toPaper(event.matches));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  document.documentElement.dataset.ready = "true";
}

start().catch(error => {
  const words = `Map and charts cannot be drawn in this browser: ${error.message}`;
  document.querySelector("nav").after(element("p", {className: "warnings"}, words));
  throw error;
});
