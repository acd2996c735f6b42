// The map: scans of keyframes painted into tiles, and what moves drawn over them.

const TILE_PX = 512, PX_PER_M = 20;      // tiles hold 25.6 m at 5 cm a pixel
const NO_RETURN = 65535;
const GAP_RAD = 0.1;                      // a wider gap between returns is not known to be free
const MOVED_M = 0.025, MOVED_RAD = 0.01;  // a keyframe that moved by more is painted anew
const REPAINT_MS = 1500, BUDGET_MS = 8;   // between two repaints, and of one picture for it
const ELLIPSE = Math.sqrt(5.991);         // chi-square of 95 %, two degrees of freedom

export class MapView {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.mode = "fit";
    this.centre = [0, 0];
    this.scale = 40;                      // px per m
    this.clear();
    this.readColours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.readColours();
      this.repaint();
    });
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.listen();
  }

  clear() {
    this.keyframes = [];                  // {outline, walls, pose, painted}
    this.closures = [];
    this.state = null;
    this.mount = [0, 0, 0];
    this.tiles = new Map();
    this.next = null;                     // tiles and row of a repaint under way
    this.bounds = [Infinity, Infinity, -Infinity, -Infinity];
    this.stale = false;
    this.repainted = -Infinity;
    this.wake();
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    this.colours = Object.fromEntries(
      ["unknown", "free", "wall", "scan", "path", "robot", "closure", "ink"].map(
        name => [name, style.getPropertyValue("--" + name).trim()]));
  }

  addKeyframes(first, mount, scans, poses) {
    this.mount = mount;
    scans.forEach((scan, k) => {
      const keyframe = { ...trace(scan, mount), pose: poses.slice(3 * k, 3 * k + 3) };
      this.keyframes[first + k] = keyframe;
      this.paint(this.tiles, keyframe);
    });
    this.wake();
  }

  move(rows, poses) {
    rows.forEach((row, k) => {
      const keyframe = this.keyframes[row];
      keyframe.pose = poses.slice(3 * k, 3 * k + 3);
      const [x, y, theta] = keyframe.painted;
      const [X, Y, Theta] = keyframe.pose;
      this.stale ||= Math.hypot(X - x, Y - y) > MOVED_M || Math.abs(turn(Theta - theta)) > MOVED_RAD;
    });
    this.wake();
  }

  show(state) {
    this.state = state;
    this.wake();
  }

  repaint() {
    this.stale = true;
    this.repainted = -Infinity;
    this.wake();
  }

  // Painting: free space below, walls above, so that no scan wipes out what another has seen.

  paint(tiles, keyframe) {
    const { outline, walls, pose } = keyframe;
    const at = points => transformed(points, pose);
    const edge = at(outline), wall = at(walls);
    let [left, bottom, right, top] = [Infinity, Infinity, -Infinity, -Infinity];
    const shape = new Path2D();
    for (let k = 0; k < edge.length; k += 2) {
      shape.lineTo(edge[k], edge[k + 1]);
      left = Math.min(left, edge[k]); right = Math.max(right, edge[k]);
      bottom = Math.min(bottom, edge[k + 1]); top = Math.max(top, edge[k + 1]);
    }
    if (tiles === this.tiles) {
      const b = this.bounds;
      this.bounds = [Math.min(b[0], left), Math.min(b[1], bottom), Math.max(b[2], right), Math.max(b[3], top)];
    }
    const side = TILE_PX / PX_PER_M;
    for (let i = Math.floor(left / side); i <= Math.floor(right / side); i++) {
      for (let j = Math.floor(bottom / side); j <= Math.floor(top / side); j++) {
        tile(tiles, i, j, this.colours).free.fill(shape);
      }
    }
    const cell = 1 / PX_PER_M;
    for (let k = 0; k < wall.length; k += 2) {
      const x = wall[k], y = wall[k + 1];
      const target = tile(tiles, Math.floor(x / side), Math.floor(y / side), this.colours);
      target.walls.fillRect(Math.floor(x / cell) * cell, Math.floor(y / cell) * cell, cell, cell);
    }
    keyframe.painted = pose;
  }

  // A repaint goes on beside the pictures, a few keyframes each; the old tiles stay until it is done.
  work() {
    const now = performance.now();
    if (this.stale && !this.next && now - this.repainted > REPAINT_MS) {
      this.next = { tiles: new Map(), row: 0 };
      this.stale = false;
    }
    if (!this.next) return;
    while (this.next.row < this.keyframes.length && performance.now() - now < BUDGET_MS) {
      this.paint(this.next.tiles, this.keyframes[this.next.row++]);
    }
    if (this.next.row === this.keyframes.length) {
      this.tiles = this.next.tiles;
      this.next = null;
      this.repainted = now;
    }
  }

  // Drawing

  wake() {
    this.waiting ??= requestAnimationFrame(() => {
      this.waiting = null;
      this.work();
      this.draw();
      if (this.next) this.wake();
      else if (this.stale) setTimeout(() => this.wake(), REPAINT_MS);
    });
  }

  resize() {
    const ratio = devicePixelRatio || 1;
    this.canvas.width = Math.round(this.canvas.clientWidth * ratio);
    this.canvas.height = Math.round(this.canvas.clientHeight * ratio);
    this.wake();
  }

  aim() {
    const { width, height } = this.canvas, b = this.bounds;
    if (this.mode === "fit" && b[0] < b[2]) {
      this.centre = [(b[0] + b[2]) / 2, (b[1] + b[3]) / 2];
      this.scale = 0.92 * Math.min(width / (b[2] - b[0]), height / (b[3] - b[1]), 200);
    } else if (this.mode === "follow" && this.state?.pose) {
      this.centre = this.state.pose.slice(0, 2);
    }
  }

  draw() {
    this.aim();
    const { context: c, canvas, colours, scale } = this;
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.fillStyle = colours.unknown;
    c.fillRect(0, 0, canvas.width, canvas.height);
    c.setTransform(scale, 0, 0, -scale, canvas.width / 2 - scale * this.centre[0], canvas.height / 2 + scale * this.centre[1]);
    const side = TILE_PX / PX_PER_M;
    for (const layer of ["free", "walls"]) {
      for (const { i, j, ...layers } of this.tiles.values()) {
        c.save();
        c.translate(i * side, (j + 1) * side);
        c.scale(1, -1);
        c.drawImage(layers[layer].canvas, 0, 0, side, side);
        c.restore();
      }
    }
    this.drawPath(c, 1 / scale);
    if (this.state?.pose) this.drawRobot(c, 1 / scale);
    this.drawScale(c);
  }

  drawPath(c, px) {
    const ratio = devicePixelRatio || 1;
    c.lineWidth = 1.5 * ratio * px;
    c.strokeStyle = this.colours.path;
    c.beginPath();
    for (const { pose } of this.keyframes) c.lineTo(pose[0], pose[1]);
    c.stroke();
    if (this.scale > 60) {
      c.fillStyle = this.colours.path;
      for (const { pose } of this.keyframes) {
        c.beginPath();
        c.arc(pose[0], pose[1], 3 * ratio * px, 0, 2 * Math.PI);
        c.fill();
      }
    }
    c.strokeStyle = this.colours.closure;
    c.globalAlpha = 0.6;
    c.lineWidth = ratio * px;
    c.beginPath();
    for (const [i, j, accepted] of this.closures) {
      const a = this.keyframes[i]?.pose, b = this.keyframes[j]?.pose;
      if (!accepted || !a || !b) continue;
      c.moveTo(a[0], a[1]);
      c.lineTo(b[0], b[1]);
    }
    c.stroke();
    c.globalAlpha = 1;
  }

  drawRobot(c, px) {
    const { pose, scan, covariance } = this.state, ratio = devicePixelRatio || 1;
    if (scan) {
      c.fillStyle = this.colours.scan;
      const points = transformed(trace(scan, this.mount).walls, pose), size = 2.4 * ratio * px;
      for (let k = 0; k < points.length; k += 2) c.fillRect(points[k] - size / 2, points[k + 1] - size / 2, size, size);
    }
    c.save();
    c.translate(pose[0], pose[1]);
    c.rotate(pose[2]);
    c.strokeStyle = c.fillStyle = this.colours.robot;
    c.lineWidth = 1.5 * ratio * px;
    if (covariance?.length === 9) {
      const [xx, xy, , , yy] = covariance;
      const mean = (xx + yy) / 2, half = Math.hypot((xx - yy) / 2, xy);
      c.beginPath();
      c.ellipse(0, 0, ELLIPSE * Math.sqrt(mean + half), ELLIPSE * Math.sqrt(Math.max(mean - half, 0)),
        Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
      c.globalAlpha = 0.25;
      c.fill();
      c.globalAlpha = 1;
      c.stroke();
    }
    const size = Math.max(0.2, 7 * ratio * px);  // a P3-DX is about 0.4 m long
    c.beginPath();
    c.moveTo(size, 0); c.lineTo(-size, 0.7 * size); c.lineTo(-0.6 * size, 0); c.lineTo(-size, -0.7 * size);
    c.closePath();
    c.fill();
    c.restore();
  }

  drawScale(c) {
    const ratio = devicePixelRatio || 1, wanted = 120 * ratio / this.scale;
    const power = 10 ** Math.floor(Math.log10(wanted));
    const length = [5, 2, 1].map(m => m * power).find(m => m <= wanted) ?? power;
    const y = this.canvas.height - 16 * ratio, x = 14 * ratio;
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.fillStyle = this.colours.ink;
    c.fillRect(x, y, length * this.scale, 3 * ratio);
    c.font = `${12 * ratio}px system-ui, sans-serif`;
    c.fillText(`${length} m`, x, y - 5 * ratio);
  }

  // Hands

  setMode(mode) {
    this.mode = mode;
    if (mode === "follow") this.scale = Math.max(this.scale, 40);
    this.onmode?.(mode);
    this.wake();
  }

  listen() {
    const canvas = this.canvas, ratio = () => devicePixelRatio || 1;
    canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", event => {
      if (!event.buttons) return;
      this.setMode("free");
      this.centre = [
        this.centre[0] - event.movementX * ratio() / this.scale,
        this.centre[1] + event.movementY * ratio() / this.scale];
    });
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      const factor = Math.exp(-event.deltaY * 0.0015), box = canvas.getBoundingClientRect();
      const dx = ((event.clientX - box.left) * ratio() - canvas.width / 2) / this.scale;
      const dy = (canvas.height / 2 - (event.clientY - box.top) * ratio()) / this.scale;
      const keep = this.mode === "follow" ? 0 : 1 - 1 / factor;
      if (this.mode === "fit") this.setMode("free");
      this.scale = Math.min(Math.max(this.scale * factor, 0.5), 2000);
      this.centre = [this.centre[0] + dx * keep, this.centre[1] + dy * keep];
      this.wake();
    }, { passive: false });
  }
}

// Points of a scan in the robot's frame: the outline of what it sees, and where it met a wall.
function trace({ start, step, cm }, mount) {
  const outline = [mount[0], mount[1]], walls = [];
  let last = null;
  cm.forEach((range, k) => {
    if (range === NO_RETURN) return;
    const bearing = mount[2] + start + k * step, r = range / 100;
    const x = mount[0] + r * Math.cos(bearing), y = mount[1] + r * Math.sin(bearing);
    if (last !== null && Math.abs((k - last) * step) > GAP_RAD) outline.push(mount[0], mount[1]);
    outline.push(x, y);
    walls.push(x, y);
    last = k;
  });
  return { outline, walls };
}

function transformed(points, [x, y, theta]) {
  const c = Math.cos(theta), s = Math.sin(theta), moved = new Float64Array(points.length);
  for (let k = 0; k < points.length; k += 2) {
    moved[k] = x + c * points[k] - s * points[k + 1];
    moved[k + 1] = y + s * points[k] + c * points[k + 1];
  }
  return moved;
}

function tile(tiles, i, j, colours) {
  const key = `${i} ${j}`;
  let found = tiles.get(key);
  if (!found) {
    found = { i, j, free: layer(i, j, colours.free), walls: layer(i, j, colours.wall) };
    tiles.set(key, found);
  }
  return found;
}

function layer(i, j, colour) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = TILE_PX;
  const context = canvas.getContext("2d");
  context.fillStyle = colour;
  context.setTransform(PX_PER_M, 0, 0, -PX_PER_M, -i * TILE_PX, (j + 1) * TILE_PX);
  return context;
}

function turn(angle) {
  return Math.atan2(Math.sin(angle), Math.cos(angle));
}
