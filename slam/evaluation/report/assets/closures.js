"use strict";
// Loop closures on the map: where they are, and the two scans of each laid over each other.

/** Points of a scan in the map frame, from its keyframe's pose `map_T_base`; degrees. */
function scanPoints(scan, laser, pose) {
  const at = compose(pose, laser);
  return decode(scan.ranges).flatMap((range, k) => {
    if (range === null) return [];
    const bearing = ((at[2] + scan.first + k * scan.step) * Math.PI) / 180;
    return [[at[1] + range * Math.sin(bearing), at[0] + range * Math.cos(bearing)]];
  });
}

/** `a_T_c` from `a_T_b` and `b_T_c`: x, y in m, heading in degrees. */
function compose([x, y, heading], [dx, dy, turn]) {
  const c = Math.cos((heading * Math.PI) / 180),
    s = Math.sin((heading * Math.PI) / 180);
  return [x + c * dx - s * dy, y + s * dx + c * dy, heading + turn];
}

/** Adds the closures' layers to a map; returns how to open one. */
function addClosures(run, map, panel, addLayer) {
  const {closures, keyframes} = run;
  const nothing = {open() {}, redraw() {}, openAt: () => false};
  if (!closures.old) return nothing;
  const layerOf = ["rejected closures", "accepted closures"];
  const place = k => (keyframes.x[k] === undefined ? null : [keyframes.y[k], keyframes.x[k]]);
  const ends = closures.old.map((old, k) => [place(old), place(closures.new[k])]);
  let current = null,
    overlay = null;

  function layer(accepted, style) {
    const there = ends.filter((end, k) => end[0] && end[1] && closures.accepted[k] === accepted);
    const dots = there.map(end =>
      L.circleMarker(end[1], {
        radius: 2.5,
        stroke: false,
        fillOpacity: 0.9,
        fillColor: style().color,
        interactive: false,
      }),
    );
    return L.layerGroup([L.polyline(there, {weight: 1, interactive: false, ...style()}), ...dots]);
  }
  if (closures.accepted.includes(1))
    addLayer(layerOf[1], "d", () => layer(1, () => ({color: colour("d"), opacity: 0.6})), true);
  if (closures.accepted.includes(0))
    addLayer(
      layerOf[0],
      "e",
      () => layer(0, () => ({color: colour("e"), opacity: 0.6, dashArray: "3 3"})),
      false,
    );

  function pose(k) {
    return [keyframes.x[k], keyframes.y[k], keyframes.heading[k]];
  }

  function drawOverlay() {
    if (overlay) overlay.remove();
    overlay = null;
    if (current === null) return;
    const old = closures.old[current],
      fresh = closures.new[current],
      scans = [closures.scans[old], closures.scans[fresh]];
    if (!scans[0] || !scans[1]) return;
    const old_T_new = [closures.x[current], closures.y[current], closures.heading[current]];
    const clouds = [
      scanPoints(scans[0], closures.laser, pose(old)),
      scanPoints(scans[1], closures.laser, compose(pose(old), old_T_new)),
    ];
    const pair = L.polyline(ends[current], {color: colour("ink"), weight: 3, interactive: false});
    overlay = L.layerGroup([
      pair,
      ...clouds.flatMap((points, which) =>
        points.map(point =>
          L.circleMarker(point, {
            radius: 2.5,
            stroke: false,
            fillOpacity: 0.85,
            fillColor: colour(which ? "a" : "b"),
            interactive: false,
          }),
        ),
      ),
    ]);
    overlay.addTo(map);
    return L.latLngBounds(clouds.flat());
  }

  function fillPanel() {
    const k = current,
      value = (name, digits, unit = "") =>
        closures[name][k] === null ? null : figure(closures[name][k], digits, unit);
    const at = index =>
      keyframes.t[index] === undefined ? "" : ` at ${figure(keyframes.t[index], 1, " s")}`;
    const key = name => {
      const made = element("i", {className: "key"});
      made.style.borderColor = colour(name);
      return made;
    };
    const step = (words, by) =>
      element(
        "button",
        {
          type: "button",
          onclick: () => open(current + by),
          disabled: !(current + by in closures.old),
        },
        words,
      );
    const motion = closures.measured[k] ? "measured" : "in the graph";
    const drawn = closures.scans[closures.old[k]] && closures.scans[closures.new[k]];
    panel.replaceChildren(
      element(
        "header",
        {},
        element(
          "b",
          {},
          `Closure ${k + 1} of ${closures.old.length}: ${closures.accepted[k] ? "accepted" : "rejected"}`,
        ),
        step("previous", -1),
        step("next", 1),
        element("button", {type: "button", onclick: close}, "close"),
      ),
      element(
        "div",
        {className: "tools"},
        element("span", {}, key("b"), ` scan of keyframe ${closures.old[k]}${at(closures.old[k])}`),
        element("span", {}, key("a"), ` scan of keyframe ${closures.new[k]}${at(closures.new[k])}`),
      ),
      factList([
        ["result", run.closures.reasons[closures.reason[k]]],
        ["score", value("score", 2)],
        ["second best", value("second_score", 2)],
        ["chi²", value("chi_square", 1)],
        [`x, ${motion}`, value("x", 3, " m")],
        [`y, ${motion}`, value("y", 3, " m")],
        [`heading, ${motion}`, value("heading", 2, "°")],
        ["off the graph", value("off_m", 4, " m")],
        ["off in heading", value("off_deg", 3, "°")],
      ]),
      element(
        "p",
        {className: "note"},
        !drawn
          ? "The scans were left out to keep this page small, or the run does not hold them."
          : closures.measured[k]
            ? "The newer scan lies where the closure measured it."
            : "No measurement is on record: the scans lie where the finished graph has them.",
      ),
    );
    panel.hidden = false;
  }

  function open(k) {
    current = k;
    fillPanel();
    const bounds = drawOverlay();
    if (bounds?.isValid()) map.fitBounds(bounds, {padding: [20, 20]});
  }

  function close() {
    current = null;
    panel.hidden = true;
    drawOverlay();
  }

  function openAt(event, shown) {
    const click = map.latLngToLayerPoint(event.latlng);
    let best = TAP_REACH,
      found = null;
    ends.forEach(([from, to], k) => {
      if (!from || !to || !shown(layerOf[closures.accepted[k]])) return;
      const distance = L.LineUtil.pointToSegmentDistance(
        click,
        map.latLngToLayerPoint(from),
        map.latLngToLayerPoint(to),
      );
      if (distance < best) {
        best = distance;
        found = k;
      }
    });
    if (found !== null) open(found);
    return found !== null;
  }

  return {
    open,
    openAt,
    redraw() {
      if (current !== null) {
        drawOverlay();
        fillPanel();
      }
    },
  };
}
