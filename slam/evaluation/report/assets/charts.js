"use strict";
// Charts: drag or pinch to zoom, double click to see all again, point to read values.

const CHART_HEIGHT = 260,
  LEGEND_HEIGHT = 30,
  EVENT_ROW = 26; // px
const DOT = 2; // px, of an event or a lone value

/** Draws a chart that Python described; `path` has the columns that it names. */
function drawChart(host, chart, run) {
  const values = column => (typeof column === "string" ? run.path[column] : decode(column));
  const x = values(chart.x);
  const data = [x, ...chart.curves.map(curve => values(curve.y))];
  return plot(host, chart, data, chart.x === "t" ? run : null);
}

/** The position errors of all runs over time; false if fewer than two have any. */
function drawErrors(host, runs) {
  const known = runs.map((run, k) => ({run, k})).filter(({run}) => run.path.error);
  if (known.length < 2) return false;
  const data = uPlot.join(known.map(({run}) => [run.path.t, run.path.error]));
  const curves = known.map(({run, k}) => ({name: run.name, style: runColour(k)}));
  const chart = {
    kind: "line",
    x_label: "time [s]",
    y_label: `${known[0].run.error_of} [m]`,
    curves,
  };
  return plot(host, chart, data, null);
}

function plot(host, chart, data, run) {
  let drawn = null,
    quiet = false;

  /** On paper everything is drawn twice as large and shown at half: ink is finer than a screen. */
  function options() {
    const finer = onPaper() ? 2 : 1,
      events = chart.kind === "events";
    const axis = {
      stroke: () => colour("soft"),
      font: `${12 * finer}px system-ui, sans-serif`,
      labelFont: `${12 * finer}px system-ui, sans-serif`,
      labelSize: 20 * finer,
      gap: 5 * finer,
      grid: {stroke: () => colour("line"), width: finer},
      ticks: {stroke: () => colour("line"), width: finer, size: 5 * finer},
    };
    const names = chart.curves.map(curve =>
      curve.name.length > 18 ? curve.name.slice(0, 17) + "…" : curve.name,
    );
    return {
      width: (onPaper() ? PAPER_WIDTH : host.clientWidth) * finer,
      height: (events ? 70 + EVENT_ROW * names.length : CHART_HEIGHT) * finer,
      pxAlign: 0,
      scales: {
        x: {time: false, range: chart.kind === "bars" ? binLimits : undefined},
        y: {range: events ? [-0.5, names.length - 0.5] : valueLimits},
      },
      legend: {show: !events},
      cursor: {y: false, points: {size: 7}, drag: {x: true, y: false}},
      axes: [
        {...axis, label: chart.x_label, size: 30 * finer, space: 60 * finer, values: ticks},
        {
          ...axis,
          label: chart.y_label || null,
          space: 34 * finer,
          size: (events ? 130 : 58) * finer,
          ...(events
            ? {splits: () => names.map((_, k) => k), values: () => names}
            : {values: ticks}),
        },
      ],
      series: [
        {label: chart.kind === "bars" ? "about" : chart.x_label, value: (_, value) => short(value)},
        ...chart.curves.map(curve => series(curve, chart.kind, finer)),
      ],
      hooks: run
        ? {
            setCursor: [
              ({cursor}) => {
                if (!quiet && cursor.idx !== null && cursor.left >= 0) run.show(cursor.idx);
              },
            ],
          }
        : {},
    };
  }

  function draw() {
    if (drawn) drawn.destroy();
    host.style.zoom = onPaper() ? 0.5 : "";
    drawn = new uPlot(options(), data, host);
    pinch(drawn);
  }

  /** Draws again what is on the screen, and on paper all. */
  function redraw() {
    if (drawn || onPaper()) draw();
  }

  /** Moves the cursor to what another drawing points at. */
  function show(k) {
    if (!drawn) return;
    quiet = true;
    drawn.setCursor({left: drawn.valToPos(data[0][k], "x"), top: 0}, false);
    quiet = false;
  }

  // Many charts of long runs take seconds: each waits until it is nearly in sight.
  host.style.minHeight = `${CHART_HEIGHT + LEGEND_HEIGHT}px`;
  const waiting = new IntersectionObserver(
    entries => {
      if (!entries.some(entry => entry.isIntersecting)) return;
      waiting.disconnect();
      host.style.minHeight = "";
      if (!drawn) draw();
    },
    {rootMargin: "400px"},
  );
  waiting.observe(host);
  new ResizeObserver(() => {
    if (drawn && !onPaper() && host.clientWidth && host.clientWidth !== drawn.width)
      drawn.setSize({width: host.clientWidth, height: drawn.height});
  }).observe(host);
  return {draw: redraw, show: run ? show : null};
}

function series(curve, kind, finer) {
  const look = {
    label: curve.name,
    stroke: () => colour(curve.style),
    width: 1.5 * finer,
    spanGaps: true,
    value: (_, value) => short(value),
    points: {show: false},
  };
  if (kind === "bars")
    return {
      ...look,
      fill: () => colour(curve.style),
      paths: uPlot.paths.bars({size: [0.9, Infinity]}),
    };
  if (kind === "events")
    return {
      ...look,
      width: 0,
      paths: () => null,
      points: {
        show: true,
        size: 2 * DOT * finer + 2,
        width: 0,
        fill: () => colour(curve.style),
        space: 0,
      },
    };
  return {
    ...look,
    points: {
      show: (plot, k) => lonely(plot.data[k]),
      size: 2 * DOT * finer + 2,
      width: 0,
      fill: () => colour(curve.style),
    },
  };
}

/** A value in few digits. */
function short(value) {
  return value === null || value === undefined
    ? "–"
    : grouped(Number(value.toPrecision(Math.abs(value) >= 1000 ? 6 : 4)));
}

/** A number as the tables have it, in every language of the browser. */
const grouped = value =>
  value
    .toLocaleString("en", {maximumFractionDigits: 6})
    .replaceAll(",", "\u202f")
    .replace("-", "\u2212");

const ticks = (_, values) => values.map(grouped);

/** So that the first and last bar are whole. */
function binLimits(plot, low, high) {
  const half = (plot.data[0][1] - plot.data[0][0]) / 2;
  return [plot.data[0][0] - half, plot.data[0].at(-1) + half];
}

/** Two fingers zoom a chart along x, as they do a map; one still scrolls the page. */
function pinch(chart) {
  let held = null; // values of x below the two fingers
  const places = event =>
    [...event.touches].map(touch => touch.clientX - chart.over.getBoundingClientRect().left);
  chart.over.style.touchAction = "pan-y";
  chart.over.addEventListener("touchstart", event => {
    held = event.touches.length === 2 ? places(event).map(at => chart.posToVal(at, "x")) : null;
  });
  chart.over.addEventListener(
    "touchmove",
    event => {
      if (!held || event.touches.length !== 2) return;
      event.preventDefault();
      const [a, b] = places(event),
        perPixel = (held[1] - held[0]) / (b - a);
      if (!(perPixel > 0)) return;
      const min = held[0] - a * perPixel;
      chart.setScale("x", {min, max: min + chart.over.clientWidth * perPixel});
    },
    {passive: false},
  );
}

/** Whether values are so few that lines between them would hardly be seen, as surveyed poses are. */
function lonely(values) {
  let known = 0;
  for (const value of values)
    if (value !== null && value !== undefined && ++known > 60) return false;
  return true;
}

/** From zero where values do not go below it, with some air. */
function valueLimits(plot, low, high) {
  if (low === null || high === null) return [0, 1];
  const span = high - Math.min(low, 0) || 1;
  return [low < 0 ? low - 0.05 * span : 0, high + 0.05 * span];
}
