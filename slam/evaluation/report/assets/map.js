"use strict";
// The map: paths over the occupancy grid, to zoom, pan and point at.

const POINT_REACH = 24; // px from the pointer to the nearest pose
const TAP_REACH = 12; // px from a tap to the nearest closure
const MARGIN = 0.12; // share of the paths' extent that is shown around them
const BINS = 14; // colours of a path
const PAPER_WIDTH = 640,
  PAPER_HEIGHT = 760; // px, fit on A4 and letter with their margins
// Dark to bright, told apart also by the colour-blind; each readable on its ground.
const RAMPS = {
  light: ["#0d0887", "#6a00a8", "#b12a90", "#e16462", "#f39b1f"],
  dark: ["#6d5cf5", "#a74bd1", "#e0607e", "#fca636", "#f0f921"],
};

function rampColour(share) {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches && !onPaper();
  const anchors = RAMPS[dark ? "dark" : "light"],
    at = share * (anchors.length - 1);
  const k = Math.min(Math.floor(at), anchors.length - 2);
  const part = (text, i) => parseInt(text.slice(2 * i + 1, 2 * i + 3), 16);
  const mix = i =>
    Math.round(part(anchors[k], i) + (at - k) * (part(anchors[k + 1], i) - part(anchors[k], i)));
  return `rgb(${mix(0)} ${mix(1)} ${mix(2)})`;
}

/** From the lowest value to the 98th percentile: a single bad pose must not hide the others. */
function valueRange(values) {
  const known = values.filter(value => value !== null).sort((a, b) => a - b);
  const low = known[0],
    high = known[Math.floor(0.98 * (known.length - 1))];
  return {
    low,
    high: high > low ? high : known.at(-1) > low ? known.at(-1) : low + 1,
    most: known.at(-1),
  };
}

/** Pieces of the path by colour; what has no value comes under -1. */
function pathByColour(path, values, range) {
  const pieces = new Map();
  let bin = null;
  for (let k = 1; k < path.x.length; k++) {
    const value = values[k],
      share = (value - range.low) / (range.high - range.low);
    const next = value === null ? -1 : Math.min(Math.max(Math.floor(share * BINS), 0), BINS - 1);
    if (!pieces.has(next)) pieces.set(next, []);
    if (next !== bin) pieces.get(next).push([[path.y[k - 1], path.x[k - 1]]]);
    pieces
      .get((bin = next))
      .at(-1)
      .push([path.y[k], path.x[k]]);
  }
  return pieces;
}

const latLngs = (x, y) => x.flatMap((value, k) => (value === null ? [] : [[y[k], value]]));

/** A Leaflet map in metres of the map frame. */
function makeMap(host, images, paths) {
  const screenRenderer = L.canvas({padding: 0.5});
  const map = L.map(host, {
    crs: L.CRS.Simple,
    renderer: screenRenderer,
    attributionControl: false,
    zoomSnap: 0,
    minZoom: -8,
    maxZoom: 9,
    wheelPxPerZoomLevel: 120,
    zoomAnimation: false,
  });
  for (const image of images) L.imageOverlay(image.url, image.bounds).addTo(map);
  // What lies around the paths; single far readings would make all else small.
  let bounds = L.latLngBounds(paths.flatMap(path => latLngs(path.x, path.y)));
  const most = Math.max(
    bounds.getNorth() - bounds.getSouth(),
    bounds.getEast() - bounds.getWest(),
    1,
  );
  const {lat, lng} = bounds.getCenter(); // a straight drive would make a sliver
  bounds.extend([lat - most / 6, lng - most / 6]).extend([lat + most / 6, lng + most / 6]);
  map.fitBounds((bounds = bounds.pad(MARGIN)));
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
    let best = reach * reach,
      where = null;
    paths.forEach((path, which) => {
      for (let k = 0; k < path.x.length; k++) {
        const dx = path.x[k] - event.latlng.lng,
          dy = path.y[k] - event.latlng.lat;
        const square = dx * dx + dy * dy;
        if (square < best) {
          best = square;
          where = [which, k];
        }
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
    map.screenRenderer.remove(); // printed, an empty canvas would cover what lies below
    map.invalidateSize({pan: false}).fitBounds(bounds, {animate: false});
  } else if (!onPaper() && before) {
    delete host.dataset.view;
    host.style.width = host.style.height = "";
    map.inkRenderer.remove();
    map.invalidateSize({pan: false}).setView(...before, {animate: false});
  }
}
