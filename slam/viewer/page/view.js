// Fetches the feed, hands its frames on, and asks again whenever it breaks off.

import { MapView } from "./map.js";
import { Panel } from "./panel.js";

const RETRY_MS = 500, LONGEST_RETRY_MS = 3000;

const map = new MapView(document.getElementById("map"));
const panel = new Panel();
let stage = "", failures = 0;

for (const mode of ["fit", "follow"]) {
  document.getElementById(mode).addEventListener("click", () => map.setMode(mode));
}
map.onmode = mode => {
  for (const name of ["fit", "follow"]) {
    document.getElementById(name).setAttribute("aria-pressed", String(name === mode));
  }
};

function array(text, Kind) {
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  return Array.from(new Kind(bytes.buffer));
}

const scanOf = scan => scan && { ...scan, cm: array(scan.cm, Uint16Array) };

const frames = {
  hello() {
    // All that follows is told from the start, whatever was known before.
    map.clear();
    panel.clear();
  },
  keyframes(frame) {
    map.addKeyframes(frame.first, frame.mount, frame.items.map(item => scanOf(item.scan)), array(frame.poses, Float32Array));
    panel.addKeyframes(frame.first, frame.items);
    panel.extent(map.bounds);
  },
  moved(frame) {
    map.move(array(frame.rows, Uint32Array), array(frame.poses, Float32Array));
  },
  closures(frame) {
    map.closures.length = frame.first;
    map.closures.push(...frame.items);
    panel.setClosures(frame.first, frame.items);
  },
  state(frame) {
    stage = frame.stage;
    map.show({ ...frame, scan: scanOf(frame.scan) });
    panel.show(frame);
    if (frame.alarm) panel.link("lost", `not live: ${frame.alarm}`);
    else panel.link(stage === "finished" ? "finished" : "live", stage === "finished" ? "finished" : "live");
  },
};

function connect() {
  const socket = new WebSocket(`ws://${location.host}/feed${location.search}`);
  socket.onmessage = event => {
    failures = 0;
    const frame = JSON.parse(event.data);
    frames[frame.type](frame);
  };
  socket.onclose = () => {
    failures += 1;
    if (stage === "finished") panel.link("finished", "finished; waiting for the next run …");
    else panel.link("lost", "no connection, trying again …");
    setTimeout(connect, Math.min(RETRY_MS * failures, LONGEST_RETRY_MS));
  };
}

connect();
