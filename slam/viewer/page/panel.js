// The figures beside the map.

const LAST = 200;  // keyframes in the little chart
const NEWS = 8;
const STALE_S = 1;  // older data are not live; as in slam/runs/status.py

const byId = id => document.getElementById(id);
const say = (id, text) => { const node = byId(id); if (node.textContent !== text) node.textContent = text; };
const number = (value, digits, unit = "") => value == null ? "–" : value.toFixed(digits) + unit;
const degrees = rad => rad * 180 / Math.PI;

export class Panel {
  constructor() {
    this.clear();
  }

  clear() {
    this.history = [];
    this.news = [];
    this.closures = [];
    this.showClosures();
    list(byId("losses"), [["nothing", "", ""]]);
    byId("devices").hidden = byId("news").hidden = true;
  }

  extent([left, bottom, right, top]) {
    say("extent", left < right ? `${number(right - left, 0)} × ${number(top - bottom, 0)} m` : "–");
  }

  link(state, text) {
    byId("link").dataset.state = state;
    say("link", text);
  }

  addKeyframes(first, items) {
    items.forEach((item, k) => { this.history[first + k] = [item.interval, item.t_pe]; });
    const recent = this.history.slice(-LAST);
    [".interval", ".t_pe"].forEach((style, column) => {
      byId("history").querySelector(style).setAttribute("d", curve(recent.map(row => row[column])));
    });
  }

  setClosures(first, items) {
    this.closures.length = first;
    this.closures.push(...items);
    this.showClosures();
  }

  showClosures() {
    const refused = this.closures.filter(item => !item[2]);
    say("accepted", String(this.closures.length - refused.length));
    say("refused", String(refused.length));
    say("refusal", refused.length ? `last refused: ${refused.at(-1)[3]}` : "");
  }

  show(state) {
    say("stage", state.alarm ? `${state.stage}, but no live data` : state.stage);
    if (state.pose) this.showPose(state);
    if (state.losses) showLosses(state.losses);
    if (state.devices) this.showDevices(state);
  }

  showPose({ pose, covariance, decision, seconds, scans, travelled_m, keyframes, astray }) {
    say("seconds", number(seconds, 1, " s"));
    say("scans", String(scans));
    say("travelled", number(travelled_m, 1, " m"));
    say("position", `${number(pose[0], 2)}, ${number(pose[1], 2)} m`);
    say("heading", number(degrees(pose[2]), 1, "°"));
    const sigma = k => covariance.length ? Math.sqrt(covariance[4 * k]) : null;
    say("sigmas", covariance.length
      ? `${number(sigma(0) * 1000, 0)}, ${number(sigma(1) * 1000, 0)} mm, ${number(degrees(sigma(2)), 2)}°` : "–");
    byId("astray").hidden = !astray;
    say("keyframes", String(keyframes));
    say("t_pe", number(decision.t_pe, 2));
    say("interval", number(decision.interval, 2, decision.unit === "metres" ? " m" : ` ${decision.unit}`));
    say("reason", decision.axis ? `${decision.reason} (${decision.axis})` : decision.reason);
  }

  showDevices({ devices, status }) {
    byId("devices").hidden = false;
    const rows = Object.entries(devices).map(
      ([name, kind]) => [name, kind, ["connected", "resumed"].includes(kind) ? "good" : "bad"]);
    for (const [name, value] of Object.entries(status.robot)) {
      rows.push([name, value, ["off", "pressed", "stalled"].includes(value) ? "bad" : ""]);
    }
    const old = status.age_s > STALE_S;
    rows.push(["scans a second", number(status.scan_hz, 1), ""],
      ["age of data", old ? number(status.age_s, 1, " s") : number(status.age_s * 1000, 0, " ms"), old ? "bad" : ""]);
    if (status.waiting > 1) rows.push(["waiting", String(status.waiting), "bad"]);
    list(byId("devices").querySelector("dl"), rows);
    const reasons = Object.entries(status.reasons).map(([name, text]) => `${name}: ${text}`);
    byId("reasons").replaceChildren(...[...reasons, ...status.warnings].map(text => element("li", text)));
    if (status.seconds === this.told) return;
    this.told = status.seconds;
    this.news = [...this.news, ...status.news].slice(-NEWS);
    byId("news").hidden = !this.news.length;
    byId("news").querySelector("ul").replaceChildren(...this.news.map(text => element("li", text)));
  }
}

function showLosses(losses) {
  const rows = Object.entries(losses).map(([cause, count]) => [cause, String(count), "bad"]);
  list(byId("losses"), rows.length ? rows : [["nothing", "", ""]]);
}

function list(node, rows) {
  const text = JSON.stringify(rows);
  if (node.dataset.text === text) return;
  node.dataset.text = text;
  node.replaceChildren(...rows.flatMap(([name, value, style]) => {
    const detail = element("dd", value);
    if (style) detail.className = style;
    return [element("dt", name), detail];
  }));
}

function element(tag, text) {
  const node = document.createElement(tag);
  node.textContent = text;
  return node;
}

function curve(values) {
  const known = values.filter(value => value != null);
  if (known.length < 2) return "";
  const low = Math.min(...known), spread = Math.max(...known) - low || 1;
  let pen = "M";
  return values.map((value, k) => {
    if (value == null) { pen = "M"; return ""; }
    const point = `${pen}${(240 * k / (values.length - 1)).toFixed(1)} ${(57 - 54 * (value - low) / spread).toFixed(1)}`;
    pen = "L";
    return point;
  }).join("");
}
