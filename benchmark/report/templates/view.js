"use strict";
/* A scene drawn on a 2D canvas: points go into a picture with a depth buffer, lines over it.

World: east, north, up, in metres. The eye turns about a target: yaw about the vertical, pitch above
the horizon. Screen: x right, y down, z away from the eye. */
const data = JSON.parse(document.getElementById("data").textContent);
const canvas = document.getElementById("space");
const context = canvas.getContext("2d", { willReadFrequently: true });
const COLOURS = { has: "#37e05b", none: "#ff453a", truth: "#f5f5f7", map: "#7ab8f5", query: "#ffb340" };
const ADDED = [255, 60, 230];
// Colours of estimated poses: the error in metres that each stays below.
const ERRORS = [[0.25, "#37e05b", "less than 0.25 m off"], [0.5, "#a6e22e", "less than 0.5 m off"],
  [5, "#ffb340", "less than 5 m off"], [Infinity, "#ff453a", "5 m off or more"]];
const NO_POSE = "#8e8e93";
const FOCAL = 1.1; // focal length over the shorter side of the screen
const NEAR = 0.2; // smallest distance from the eye that is drawn, metres
const TURN = 0.006; // radians per pixel of dragging
const CLICK = 14; // largest distance of a click from a camera, pixels
const SPARSE = 150000; // a cloud with fewer coordinates (three per point) is drawn with larger dots

const scale = Math.min(2, window.devicePixelRatio || 1);

const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const clouds = data.clouds.map(cloud => {
  const whole = new Uint16Array(bytes(cloud.xyz).buffer), xyz = new Float32Array(whole.length);
  for (let k = 0; k < whole.length; k++) xyz[k] = cloud.low[k % 3] + whole[k] * cloud.step[k % 3];
  const least = Math.round((xyz.length < SPARSE ? 2 : 1) * scale); // few points need larger dots
  return { ...cloud, xyz, rgb: bytes(cloud.rgb), least };
});

const shown = {}; // by layer, whether it is drawn
let after = true, method = null, chosen = null;
const eye = { target: data.target.slice(), distance: data.distance, yaw: 0.6, pitch: 0.85 };
let picture = null, depths = null, asked = false;

/* --- geometry ------------------------------------------------------------------------------- */

function axes() {
  const [cy, sy, cp, sp] = [Math.cos(eye.yaw), Math.sin(eye.yaw), Math.cos(eye.pitch), Math.sin(eye.pitch)];
  return { right: [cy, -sy, 0], ahead: [sy * cp, cy * cp, -sp], up: [sy * sp, cy * sp, cp] };
}
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/* The view as numbers: where the eye is, its axes, and pixels per unit of slope. */
function view() {
  const { right, ahead, up } = axes(), focal = FOCAL * Math.min(canvas.width, canvas.height);
  const at = eye.target.map((value, k) => value - eye.distance * ahead[k]);
  return { at, right, ahead, up, focal, cx: canvas.width / 2, cy: canvas.height / 2 };
}

function project(v, p) {
  const off = [p[0] - v.at[0], p[1] - v.at[1], p[2] - v.at[2]], z = dot(off, v.ahead);
  return [v.cx + v.focal * dot(off, v.right) / z, v.cy - v.focal * dot(off, v.up) / z, z];
}

/* A segment cut off at the plane before the eye. */
function line(v, a, b) {
  const off = p => dot([p[0] - v.at[0], p[1] - v.at[1], p[2] - v.at[2]], v.ahead) - NEAR;
  const da = off(a), db = off(b);
  if (da <= 0 && db <= 0) return;
  const cut = (from, to, t) => from.map((value, k) => value + t * (to[k] - value));
  if (da < 0) a = cut(a, b, da / (da - db));
  if (db < 0) b = cut(b, a, db / (db - da));
  const [ax, ay] = project(v, a), [bx, by] = project(v, b);
  context.moveTo(ax, ay);
  context.lineTo(bx, by);
}

function stroke(colour, width, draw) {
  context.strokeStyle = colour;
  context.lineWidth = width * scale;
  context.beginPath();
  draw();
  context.stroke();
}

/* --- drawing -------------------------------------------------------------------------------- */

function draw() {
  asked = false;
  const wide = Math.max(1, Math.round(canvas.clientWidth * scale)), high = Math.max(1, Math.round(canvas.clientHeight * scale));
  if (canvas.width !== wide || canvas.height !== high || picture === null) {
    canvas.width = wide;
    canvas.height = high;
    picture = context.createImageData(wide, high);
    depths = new Float32Array(wide * high);
  }
  const v = view();
  new Uint32Array(picture.data.buffer).fill(0xff1a1714);
  depths.fill(Infinity);
  for (const cloud of clouds)
    if (shown[cloud.layer] && (after || cloud.layer !== "added")) splat(v, cloud);
  context.putImageData(picture, 0, 0);
  if (shown.objects) drawObjects(v);
  if (shown.cameras) drawCameras(v, data.cameras.filter(c => c.role === "map"), COLOURS.map);
  if (shown.queries) drawCameras(v, data.cameras.filter(c => c.role === "query"), COLOURS.query);
  if (method !== null) drawQueries(v);
  if (chosen !== null) drawCameras(v, [chosen], "#ffffff");
}

function splat(v, cloud) {
  const { xyz, rgb } = cloud, wide = canvas.width, high = canvas.height, pixels = picture.data;
  const marked = cloud.layer === "added" || cloud.layer === "landmarks", [ax, ay, az] = v.at;
  const [rx, ry] = v.right, [fx, fy, fz] = v.ahead, [ux, uy, uz] = v.up;
  for (let k = 0, n = xyz.length / 3; k < n; k++) {
    const x = xyz[3 * k] - ax, y = xyz[3 * k + 1] - ay, z = xyz[3 * k + 2] - az;
    const away = x * fx + y * fy + z * fz;
    if (away < NEAR) continue;
    const inverse = v.focal / away;
    const column = Math.round(v.cx + inverse * (x * rx + y * ry));
    const row = Math.round(v.cy - inverse * (x * ux + y * uy + z * uz));
    const reach = marked ? Math.round(3 * scale) : Math.min(4, Math.max(cloud.least, Math.round(0.12 * inverse)));
    if (column < reach || row < reach || column >= wide - reach || row >= high - reach) continue;
    const [red, green, blue] = cloud.layer === "added" ? ADDED : [rgb[3 * k], rgb[3 * k + 1], rgb[3 * k + 2]];
    const low = marked ? -reach : 0;
    for (let dy = low; dy < reach; dy++)
      for (let dx = low; dx < reach; dx++) {
        const at = (row + dy) * wide + column + dx;
        if (away >= depths[at]) continue;
        depths[at] = away;
        pixels[4 * at] = red;
        pixels[4 * at + 1] = green;
        pixels[4 * at + 2] = blue;
      }
  }
}

const hasPoint = object => after ? object.after : object.before;

function drawObjects(v) {
  for (const [colour, has] of [[COLOURS.has, true], [COLOURS.none, false]])
    stroke(colour, 1.2, () => {
      for (const object of data.objects) {
        if (hasPoint(object) !== has || (object.size !== "small" && !shown.larger)) continue;
        const base = object.corners.map(([x, y]) => [x, y, object.low]);
        const top = object.corners.map(([x, y]) => [x, y, object.high]);
        for (let k = 0; k < 4; k++) {
          line(v, base[k], base[(k + 1) % 4]);
          line(v, top[k], top[(k + 1) % 4]);
          line(v, base[k], top[k]);
        }
      }
    });
}

function drawCameras(v, cameras, colour) {
  const size = 0.02 * data.distance;
  stroke(colour, 1, () => {
    for (const camera of cameras) {
      const corners = camera.rays.map(ray => camera.centre.map((value, k) => value + size * ray[k]));
      for (let k = 0; k < 4; k++) {
        line(v, camera.centre, corners[k]);
        line(v, corners[k], corners[(k + 1) % 4]);
      }
    }
  });
}

/* The path of the camera, and a line from each true camera centre to the estimated one. */
function drawQueries(v) {
  stroke(COLOURS.truth, 1, () => {
    for (const way of data.ways) for (let k = 1; k < way.length; k++) line(v, way[k - 1], way[k]);
  });
  for (const query of method.queries) {
    const colour = errorColour(query);
    if (query.centre !== null) stroke(colour, 2, () => line(v, query.truth, query.centre));
    const [x, y, z] = project(v, query.centre ?? query.truth);
    if (z < NEAR) continue;
    context.fillStyle = colour;
    context.fillRect(Math.round(x - 3 * scale), Math.round(y - 3 * scale), 6 * scale, 6 * scale);
  }
}

function errorColour(query) {
  if (query.error === null) return NO_POSE;
  return ERRORS.find(([most]) => query.error < most)[1];
}

function ask() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(draw);
}

/* --- panel ---------------------------------------------------------------------------------- */

function swatchOf(colour) {
  const swatch = document.createElement("span");
  swatch.className = "swatch";
  swatch.style.background = colour;
  return swatch;
}

/* What colours mean: entries of a colour and its text. */
function key(id, parent, entries) {
  const list = document.createElement("ul");
  Object.assign(list, { id, className: "key" });
  for (const [colour, text] of entries) {
    const item = document.createElement("li");
    item.append(swatchOf(colour), text);
    list.append(item);
  }
  document.getElementById(parent).append(list);
}

function row(parent, kind, name, text, count, colour, checked, change) {
  const label = document.createElement("label"), input = document.createElement("input");
  Object.assign(input, { type: kind, name, checked, value: text });
  input.addEventListener("change", () => { change(input.checked); figures(); ask(); });
  label.append(input);
  if (colour) label.append(swatchOf(colour));
  const words = document.createElement("span"), number = document.createElement("span");
  words.textContent = text;
  number.textContent = count;
  label.append(words, number);
  parent.append(label);
}

function colourOf(cloud) {
  if (cloud.layer === "landmarks") return "rgb(" + cloud.rgb.slice(0, 3) + ")";
  return cloud.layer === "added" ? "rgb(" + ADDED + ")" : null;
}

function layer(key, text, count, colour, checked) {
  if (!count) return;
  shown[key] = checked;
  row(document.getElementById("layers"), "checkbox", key, text, count.toLocaleString("en"), colour, checked, on => { shown[key] = on; });
}

function panel() {
  document.getElementById("name").textContent = data.name;
  document.title = `${data.name}: scene`;
  const texts = { sparse: "points of the map", added: "added points", landmarks: "learned objects", dense: "dense points" };
  for (const cloud of clouds)
    layer(cloud.layer, texts[cloud.layer], cloud.total, colourOf(cloud), cloud.layer !== "dense");
  const small = data.objects.filter(object => object.size === "small").length;
  layer("objects", "small objects", small, null, true);
  layer("larger", "larger objects too", data.objects.length - small, null, false);
  if (data.objects.length)
    key("object-key", "layers", [[COLOURS.has, "object with a point of the map"], [COLOURS.none, "object without one"]]);
  const count = role => data.cameras.filter(camera => camera.role === role).length;
  layer("cameras", "photographs of the map", count("map"), COLOURS.map, true);
  layer("queries", "queries", count("query"), COLOURS.query, false);
  const states = document.getElementById("states"), methods = document.getElementById("methods");
  states.hidden = !clouds.some(cloud => cloud.layer === "added");
  for (const [text, value] of [["before", false], ["after", true]])
    row(states, "radio", "state", text, "", null, value, () => { after = value; });
  methods.hidden = data.methods.length === 0;
  row(methods, "radio", "method", "no method", "", null, true, () => { method = null; });
  for (const found of data.methods)
    row(methods, "radio", "method", found.name, found.queries.filter(query => query.found).length, null, false, () => { method = found; });
  key("error-key", "methods", [...ERRORS.map(([, colour, text]) => [colour, text]), [NO_POSE, "no pose"],
    [COLOURS.truth, "line: true path of the camera"]]);
  const thinned = clouds.filter(cloud => cloud.xyz.length / 3 < cloud.total)
    .map(cloud => `${(cloud.xyz.length / 3).toLocaleString("en")} of ${cloud.total.toLocaleString("en")} ${texts[cloud.layer]} are drawn, chosen at random.`);
  document.getElementById("bounds").textContent = thinned.join(" ");
  figures();
}

function figures() {
  const lines = [];
  const small = data.objects.filter(object => object.size === "small");
  if (small.length) lines.push(`${small.filter(hasPoint).length} of ${small.length} small objects in the photographs have a point`);
  if (method !== null) {
    const errors = method.queries.filter(q => q.error !== null).map(q => q.error).sort((a, b) => a - b);
    lines.push(`${method.name}: ${errors.length} of ${method.queries.length} queries have a pose` +
      (errors.length ? `, median ${errors[errors.length >> 1].toFixed(2)} m off` : ""));
  }
  document.getElementById("error-key").hidden = method === null;
  document.getElementById("figures").textContent = lines.join("\n");
}

function choose(camera) {
  chosen = camera;
  document.getElementById("camera").hidden = camera === null;
  if (camera !== null) {
    document.getElementById("camera-name").textContent = camera.name;
    const image = document.getElementById("photograph"), source = data.photographs[camera.name];
    image.hidden = source === undefined;
    if (source !== undefined) image.src = source;
    image.alt = `photograph ${camera.name}`;
    const lines = [`${camera.role === "map" ? "photograph of the map" : "query"}, ${camera.session}`];
    if (source === undefined) lines.push("its picture is left out to keep the page small");
    for (const found of data.methods)
      for (const query of found.queries)
        if (query.name === camera.name)
          lines.push(`${found.name}: ${query.error === null ? "no pose" : `${query.error.toFixed(2)} m, ${query.angle.toFixed(2)}° off`}${query.status === "ok" ? "" : ` (${query.status})`}`);
    document.getElementById("camera-text").textContent = lines.join("\n");
  }
  ask();
}

/* --- moving --------------------------------------------------------------------------------- */

function turn(dx, dy) {
  eye.yaw += TURN * dx;
  eye.pitch = Math.min(Math.PI / 2, Math.max(-0.2, eye.pitch + TURN * dy));
  ask();
}

function move(dx, dy) {
  const v = view(), metres = eye.distance / v.focal * scale;
  eye.target = eye.target.map((value, k) => value - metres * (dx * v.right[k] - dy * v.up[k]));
  ask();
}

function zoom(factor) {
  eye.distance = Math.min(20 * data.distance, Math.max(0.002 * data.distance, eye.distance * factor));
  ask();
}

function stand(camera) {
  const ahead = camera.ahead, flat = Math.hypot(ahead[0], ahead[1]);
  eye.pitch = Math.min(Math.PI / 2, Math.atan2(-ahead[2], flat));
  // Who looks straight down heads where the top of the picture is.
  const heading = flat > 0.2 ? ahead : camera.up;
  eye.yaw = Math.atan2(heading[0], heading[1]);
  eye.distance = Math.max(1, camera.depth);
  const towards = axes().ahead;
  eye.target = camera.centre.map((value, k) => value + eye.distance * towards[k]);
  ask();
}

function nearest(x, y) {
  const v = view();
  let best = null, least = CLICK * scale;
  for (const camera of data.cameras) {
    if (!shown[camera.role === "map" ? "cameras" : "queries"]) continue;
    const [px, py, z] = project(v, camera.centre), off = Math.hypot(px - x * scale, py - y * scale);
    if (z > NEAR && off < least) [best, least] = [camera, off];
  }
  return best;
}

let pressed = null;
canvas.addEventListener("pointerdown", event => {
  canvas.setPointerCapture(event.pointerId);
  pressed = { x: event.clientX, y: event.clientY, far: 0, moving: event.shiftKey || event.button === 2 };
});
canvas.addEventListener("pointermove", event => {
  if (pressed === null) return;
  const dx = event.clientX - pressed.x, dy = event.clientY - pressed.y;
  pressed.far += Math.hypot(dx, dy);
  Object.assign(pressed, { x: event.clientX, y: event.clientY });
  (pressed.moving ? move : turn)(dx, dy);
});
canvas.addEventListener("pointerup", event => {
  if (pressed !== null && pressed.far < 4) choose(nearest(event.clientX, event.clientY));
  pressed = null;
});
canvas.addEventListener("pointercancel", () => { pressed = null; });
canvas.addEventListener("contextmenu", event => event.preventDefault());
canvas.addEventListener("wheel", event => {
  event.preventDefault();
  zoom(Math.exp(0.001 * event.deltaY));
}, { passive: false });
canvas.addEventListener("keydown", event => {
  const keys = {
    ArrowLeft: () => turn(-20, 0), ArrowRight: () => turn(20, 0), ArrowUp: () => turn(0, 20),
    ArrowDown: () => turn(0, -20), "+": () => zoom(0.8), "-": () => zoom(1.25),
  };
  if (keys[event.key]) {
    event.preventDefault();
    keys[event.key]();
  }
});
document.getElementById("close").addEventListener("click", () => choose(null));
document.getElementById("through").addEventListener("click", () => stand(chosen));
window.addEventListener("resize", ask);

panel();
// On a phone the panel would cover the scene.
if (matchMedia("(max-width: 600px)").matches) document.getElementById("panel").open = false;
ask();
