"use strict";
// The map: paths over the occupancy grid, to zoom, pan and point at.

const POINT_REACH = 24;  // px from the pointer to the nearest pose
const TAP_REACH = 12;  // px from a tap to the nearest closure
const MARGIN = 0.12;  // share of the paths' extent that is shown around them
const BINS = 14;  // colours of a path
const PAPER_WIDTH = 640, PAPER_HEIGHT = 760;  // px, fit on A4 and letter with their margins
// Dark to bright, told apart also by the colour-blind; each readable on its ground.
const RAMPS = {
  light: ["#0d0887", "#6a00a8", "#b12a90", "#e16462", "#f39b1f"],
  dark: ["#6d5cf5", "#a74bd1", "#e0607e", "#fca636", "#f0f921"],
};

function rampColour(share) {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches && !onPaper();
  const anchors = RAMPS[dark ? "dark" : "light"], at = share * (anchors.length - 1);
  const k = Math.min(Math.floor(at), anchors.length - 2);
  const part = (text, i) => parseInt(text.slice(2 * i + 1, 2 * i + 3), 16);
  const mix = i => Math.round(part(anchors[k], i) + (at - k) * (part(anchors[k + 1], i) - part(anchors[k], i)));
  return `rgb(${mix(0)} ${mix(1)} ${mix(2)})`;
}

/** From the lowest value to the 98th percentile: a single bad pose must not hide the others. */
function valueRange(values) {
  const known = values.filter(value => value !== null).sort((a, b) => a - b);
  const low = known[0], high = known[Math.floor(0.98 * (known.length - 1))];
  return {low, high: high > low ? high : known.at(-1) > low ? known.at(-1) : low + 1, most: known.at(-1)};
}

/** Pieces of the path by colour; what has no value comes under -1. */
function pathByColour(path, values, range) {
  const pieces = new Map();
  let bin = null;
  for (let k = 1; k < path.x.length; k++) {
    const value = values[k], share = (value - range.low) / (range.high - range.low);
    const next = value === null ? -1 : Math.min(Math.max(Math.floor(share * BINS), 0), BINS - 1);
    if (!pieces.has(next)) pieces.set(next, []);
    if (next !== bin) pieces.get(next).push([[path.y[k - 1], path.x[k - 1]]]);
    pieces.get(bin = next).at(-1).push([path.y[k], path.x[k]]);
  }
  return pieces;
}

const latLngs = (x, y) => x.flatMap((value, k) => value === null ? [] : [[y[k], value]]);

/** A Leaflet map in metres of the map frame. */
function makeMap(host, images, paths) {
  const screenRenderer = L.canvas({padding: 0.5});
  const map = L.map(host, {
    crs: L.CRS.Simple, renderer: screenRenderer, attributionControl: false,
    zoomSnap: 0, minZoom: -8, maxZoom: 9, wheelPxPerZoomLevel: 120, zoomAnimation: false,
  });
  for (const image of images) L.imageOverlay(image.url, image.bounds).addTo(map);
  // What lies around the paths; single far readings would make all else small.
  let bounds = L.latLngBounds(paths.flatMap(path => latLngs(path.x, path.y)));
  const most = Math.max(bounds.getNorth() - bounds.getSouth(), bounds.getEast() - bounds.getWest(), 1);
  const {lat, lng} = bounds.getCenter();  // a straight drive would make a sliver
  bounds.extend([lat - most / 6, lng - most / 6]).extend([lat + most / 6, lng + most / 6]);
  map.fitBounds(bounds = bounds.pad(MARGIN));
  L.control.scale({imperial: false}).addTo(map);
  // A canvas is fast; lines on paper are to be sharp.
  Object.assign(map, {screenRenderer, inkRenderer: L.svg({padding: 0})});
  return {map, bounds};
}

/** Calls `found(which path, index)` for the pose of the path next to the pointer, as it moves or taps. */
function pointAt(map, paths, found) {
  const look = event => {
    if (map.dragging.moving()) return;
    const reach = POINT_REACH / map.getZoomScale(map.getZoom(), 0);
    let best = reach * reach, where = null;
    paths.forEach((path, which) => {
      for (let k = 0; k < path.x.length; k++) {
        const dx = path.x[k] - event.latlng.lng, dy = path.y[k] - event.latlng.lat;
        const square = dx * dx + dy * dy;
        if (square < best) { best = square; where = [which, k]; }
      }
    });
    if (where) found(...where);
  };
  map.on("mousemove", look);
  return look;
}

/** The mark of the pose that is shown, drawn by itself so that nothing else is drawn again. */
function makeProbe(map) {
  const mark = L.circleMarker([0, 0], {renderer: L.svg(), radius: 6, interactive: false});
  return (x, y) => {
    mark.setStyle({color: colour("ink"), fillColor: colour("card"), fillOpacity: 0.9, weight: 2});
    mark.setLatLng([y, x]);
    if (!map.hasLayer(mark)) mark.addTo(map);
  };
}

/** Fits a map onto paper, or back into its place on the screen. */
function fitForPaper(host, map, bounds) {
  map.options.renderer = onPaper() ? map.inkRenderer : map.screenRenderer;
  const before = host.dataset.view ? JSON.parse(host.dataset.view) : null;
  if (onPaper() && !before) {
    const {lat, lng} = map.getCenter();
    host.dataset.view = JSON.stringify([[lat, lng], map.getZoom()]);
    const share = (bounds.getNorth() - bounds.getSouth()) / (bounds.getEast() - bounds.getWest());
    host.style.width = `${PAPER_WIDTH}px`;
    host.style.height = `${Math.min(PAPER_WIDTH * share, PAPER_HEIGHT)}px`;
    map.screenRenderer.remove();  // printed, an empty canvas would cover what lies below
    map.invalidateSize({pan: false}).fitBounds(bounds, {animate: false});
  } else if (!onPaper() && before) {
    delete host.dataset.view;
    host.style.width = host.style.height = "";
    map.inkRenderer.remove();
    map.invalidateSize({pan: false}).setView(...before, {animate: false});
  }
}

/** What the path can be coloured by: words, column, digits, unit. */
const COLOURINGS = [
  ["error", "error", 3, " m"],
  ["sigma of the position", "sigma", 3, " m"],
  ["time", "t", 0, " s"],
  ["speed", "speed", 2, " m/s"],
];

/** The map of one run with its controls. */
function drawRunMap(place, run) {
  const {path} = run, layers = new Map(), host = element("div", {className: "map"});
  const readout = element("div", {className: "readout", hidden: true}), ramp = element("div", {className: "ramp", hidden: true});
  const tools = element("div", {className: "tools"}), panel = element("div", {className: "closure", hidden: true});
  const slider = element("input", {type: "range", min: 0, max: path.x.length - 1, value: 0});
  const scrub = element("label", {className: "scrub"}, "along the run", slider);
  place.append(tools, element("div", {className: "frame"}, host, readout), ramp, scrub, panel);
  const {map, bounds} = makeMap(host, run.map ? [run.map] : [], [path]);
  const probe = makeProbe(map);
  const keys = new Map();

  function addLayer(name, style, make, shown) {
    const box = element("input", {type: "checkbox", checked: shown}), key = element("i", {className: "key"});
    tools.append(element("label", {}, box, key, name));
    layers.set(name, {style, make, box, drawn: null});
    keys.set(name, key);
    box.addEventListener("change", draw);
  }

  const choice = element("select", {},
    element("option", {value: ""}, "one colour"),
    ...COLOURINGS.filter(([, column]) => path[column]).map(([name, column]) =>
      element("option", {value: column}, column === "error" ? run.error_of : name)));
  tools.append(element("label", {}, "Colour of the path", choice));
  choice.addEventListener("change", draw);

  function drawPath() {
    const coloured = COLOURINGS.find(([, column]) => column === choice.value);
    ramp.hidden = !coloured;
    if (!coloured) return L.polyline(latLngs(path.x, path.y), {color: colour("a"), weight: 2, interactive: false});
    const [, column, digits, unit] = coloured, range = valueRange(path[column]);
    const stops = Array.from({length: BINS}, (_, k) => rampColour(k / (BINS - 1)));
    const more = range.most > range.high ? ` and more (most ${figure(range.most, digits, unit)})` : "";
    const bar = element("i");
    bar.style.background = `linear-gradient(to right, ${stops.join(", ")})`;
    ramp.replaceChildren(figure(range.low, digits, unit), bar, figure(range.high, digits, unit) + more);
    return L.layerGroup([...pathByColour(path, path[column], range)].map(([bin, lines]) =>
      L.polyline(lines, {color: bin < 0 ? colour("soft") : stops[bin], weight: 3, interactive: false})));
  }

  const line = (before, style) => () =>
    L.polyline(latLngs(path[`${before}_x`], path[`${before}_y`]), {interactive: false, ...style()});
  if (path.truth_x) addLayer("truth", "c", line("truth", () => ({color: colour("c"), weight: 4, opacity: 0.7})), true);
  if (path.odometry_x) addLayer("odometry", "b", line("odometry", () => ({color: colour("b"), weight: 1.5, dashArray: "6 4"})), !path.truth_x);
  const closures = addClosures(run, map, panel, addLayer);
  addLayer("SLAM", "a", drawPath, true);

  function draw() {
    for (const [name, layer] of layers) {
      if (layer.drawn) layer.drawn.remove();
      layer.drawn = layer.box.checked ? layer.make().addTo(map) : null;
      keys.get(name).style.borderColor = colour(layer.style);
    }
    closures.redraw();
  }

  function show(k) {
    probe(path.x[k], path.y[k]);
    slider.value = k;
    readout.hidden = false;
    readout.replaceChildren(factList(run.facts(k)));
  }

  const shown = name => layers.get(name)?.box.checked;
  const look = pointAt(map, [path], (_, k) => run.show(k));
  map.on("click", event => closures.openAt(event, shown) || look(event));
  slider.addEventListener("input", () => {
    const k = Number(slider.value);
    if (!map.getBounds().contains([path.y[k], path.x[k]])) map.panTo([path.y[k], path.x[k]], {animate: false});
    run.show(k);
  });
  host.leaflet = map;
  draw();
  return {show, closures, draw() { fitForPaper(host, map, bounds); draw(); }};
}

/** All runs over the map of the first. */
function drawAllPaths(place, runs) {
  const tools = element("div", {className: "tools"}), host = element("div", {className: "map"});
  const readout = element("div", {className: "readout", hidden: true});
  place.append(tools, element("div", {className: "frame"}, host, readout));
  const paths = runs.map(run => run.path);
  const {map, bounds} = makeMap(host, runs[0].map ? [runs[0].map] : [], paths);
  const probe = makeProbe(map);
  const boxes = runs.map(run => {
    const box = element("input", {type: "checkbox", checked: true}), key = element("i", {className: "key"});
    tools.append(element("label", {}, box, key, run.name));
    box.addEventListener("change", draw);
    return {box, key};
  });
  let drawn = [];
  function draw() {
    drawn.forEach(layer => layer.remove());
    boxes.forEach(({key}, k) => { key.style.borderColor = colour(runColour(k)); });
    drawn = runs.flatMap((run, k) => boxes[k].box.checked
      ? [L.polyline(latLngs(run.path.x, run.path.y), {color: colour(runColour(k)), weight: 2, interactive: false}).addTo(map)] : []);
  }
  const look = pointAt(map, paths, (which, k) => {
    probe(paths[which].x[k], paths[which].y[k]);
    readout.hidden = false;
    readout.replaceChildren(factList([["run", runs[which].name], ...runs[which].facts(k)]));
  });
  map.on("click", look);
  host.leaflet = map;
  draw();
  return {draw() { fitForPaper(host, map, bounds); draw(); }};
}

/** Name of the colour of the kth run in drawings of several. */
const runColour = k => "abcdef"[k % 6];
