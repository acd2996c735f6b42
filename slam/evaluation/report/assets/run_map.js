"use strict";
// The map of one run with its controls, and the map of all runs.

/** What the path can be coloured by: words, column, digits, unit. */
const COLOURINGS = [
  ["error", "error", 3, " m"],
  ["sigma of the position", "sigma", 3, " m"],
  ["time", "t", 0, " s"],
  ["speed", "speed", 2, " m/s"],
];

/** Writes the facts of a pose into the half of the map where the pose is not. */
function showFacts(map, readout, pose, facts) {
  readout.hidden = false;
  readout.classList.toggle("left", map.latLngToContainerPoint(pose).x > map.getSize().x / 2);
  readout.replaceChildren(factList(facts));
}

/** The map of one run with its controls. */
function drawRunMap(place, run) {
  const {path} = run,
    layers = new Map(),
    host = element("div", {className: "map"});
  const readout = element("div", {className: "readout", hidden: true}),
    ramp = element("div", {className: "ramp", hidden: true});
  const tools = element("div", {className: "tools"}),
    panel = element("div", {className: "closure", hidden: true});
  const slider = element("input", {type: "range", min: 0, max: path.x.length - 1, value: 0});
  const scrub = element("label", {className: "scrub"}, "along the run", slider);
  place.append(tools, element("div", {className: "frame"}, host, readout), ramp, scrub, panel);
  const {map, bounds} = makeMap(host, run.map ? [run.map] : [], [path]);
  const probe = makeProbe(map);
  const keys = new Map();

  function addLayer(name, style, make, shown) {
    const box = element("input", {type: "checkbox", checked: shown}),
      key = element("i", {className: "key"});
    tools.append(element("label", {}, box, key, name));
    layers.set(name, {style, make, box, drawn: null});
    keys.set(name, key);
    box.addEventListener("change", draw);
  }

  const choice = element(
    "select",
    {},
    element("option", {value: ""}, "one colour"),
    ...COLOURINGS.filter(([, column]) => path[column]).map(([name, column]) =>
      element("option", {value: column}, column === "error" ? run.error_of : name),
    ),
  );
  tools.append(element("label", {}, "Colour of the path", choice));
  choice.addEventListener("change", draw);

  function drawPath() {
    const coloured = COLOURINGS.find(([, column]) => column === choice.value);
    ramp.hidden = !coloured;
    if (!coloured)
      return L.polyline(latLngs(path.x, path.y), {
        color: colour("a"),
        weight: 2,
        interactive: false,
      });
    const [, column, digits, unit] = coloured,
      range = valueRange(path[column]);
    const stops = Array.from({length: BINS}, (_, k) => rampColour(k / (BINS - 1)));
    const more =
      range.most > range.high ? ` and more (most ${figure(range.most, digits, unit)})` : "";
    const bar = element("i");
    bar.style.background = `linear-gradient(to right, ${stops.join(", ")})`;
    ramp.replaceChildren(
      figure(range.low, digits, unit),
      bar,
      figure(range.high, digits, unit) + more,
    );
    return L.layerGroup(
      [...pathByColour(path, path[column], range)].map(([bin, lines]) =>
        L.polyline(lines, {
          color: bin < 0 ? colour("soft") : stops[bin],
          weight: 3,
          interactive: false,
        }),
      ),
    );
  }

  const line = (before, style) => () =>
    L.polyline(latLngs(path[`${before}_x`], path[`${before}_y`]), {interactive: false, ...style()});
  if (path.truth_x)
    addLayer(
      "truth",
      "c",
      line("truth", () => ({color: colour("c"), weight: 4, opacity: 0.7})),
      true,
    );
  if (path.odometry_x)
    addLayer(
      "odometry",
      "b",
      line("odometry", () => ({color: colour("b"), weight: 1.5, dashArray: "6 4"})),
      !path.truth_x,
    );
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
    showFacts(map, readout, [path.y[k], path.x[k]], run.facts(k));
  }

  const shown = name => layers.get(name)?.box.checked;
  const look = pointAt(map, [path], (_, k) => run.show(k));
  map.on("click", event => closures.openAt(event, shown) || look(event));
  slider.addEventListener("input", () => {
    const k = Number(slider.value);
    if (!map.getBounds().contains([path.y[k], path.x[k]]))
      map.panTo([path.y[k], path.x[k]], {animate: false});
    run.show(k);
  });
  host.leaflet = map;
  draw();
  return {
    show,
    closures,
    draw() {
      fitForPaper(host, map, bounds);
      draw();
    },
  };
}

/** All runs over the map of the first. */
function drawAllPaths(place, runs) {
  const tools = element("div", {className: "tools"}),
    host = element("div", {className: "map"});
  const readout = element("div", {className: "readout", hidden: true});
  place.append(tools, element("div", {className: "frame"}, host, readout));
  const paths = runs.map(run => run.path);
  const {map, bounds} = makeMap(host, runs[0].map ? [runs[0].map] : [], paths);
  const probe = makeProbe(map);
  const boxes = runs.map(run => {
    const box = element("input", {type: "checkbox", checked: true}),
      key = element("i", {className: "key"});
    tools.append(element("label", {}, box, key, run.name));
    box.addEventListener("change", draw);
    return {box, key};
  });
  let drawn = [];
  function draw() {
    drawn.forEach(layer => layer.remove());
    boxes.forEach(({key}, k) => {
      key.style.borderColor = colour(runColour(k));
    });
    drawn = runs.flatMap((run, k) =>
      boxes[k].box.checked
        ? [
            L.polyline(latLngs(run.path.x, run.path.y), {
              color: colour(runColour(k)),
              weight: 2,
              interactive: false,
            }).addTo(map),
          ]
        : [],
    );
  }
  const look = pointAt(map, paths, (which, k) => {
    probe(paths[which].x[k], paths[which].y[k]);
    const facts = [["run", runs[which].name], ...runs[which].facts(k)];
    showFacts(map, readout, [paths[which].y[k], paths[which].x[k]], facts);
  });
  map.on("click", look);
  host.leaflet = map;
  draw();
  return {
    draw() {
      fitForPaper(host, map, bounds);
      draw();
    },
  };
}

/** Name of the colour of the kth run in drawings of several. */
const runColour = k => "abcdef"[k % 6];
