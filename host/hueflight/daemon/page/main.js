// The live page: holds the state, and nothing else knows of it all.

import { colourMap, rgbBands } from "./colours.js";
import { Cloud } from "./cloud.js";
import { showFacts, showState } from "./facts.js";
import { ask, live } from "./link.js";
import { decodePicture } from "./message.js";
import { Plane } from "./plane.js";
import { drawHistogram, drawSpectrum } from "./plots.js";

const $ = (id) => document.getElementById(id);
const PIXEL_MS = 250;
const UNKNOWN = 65535;

const state = {
  instrument: null,
  status: null,
  connected: false,
  view: "depth",
  picture: null,
  arrivedMs: null,
  pixel: null,
  pixelFacts: null,
  pixelAskedMs: 0,
  ranges: {},
  shownAck: null,
  drawn: false,
};

let plane, cloud;

// -- pictures ------------------------------------------------------------------------------------

/** Where 3 % and 97 % of a plane's known values lie. */
function limits(values) {
  const sample = [];
  const step = Math.max(1, Math.floor(values.length / 4096));
  for (let i = 0; i < values.length; i += step) if (values[i] !== UNKNOWN) sample.push(values[i]);
  if (sample.length < 2) return [0, 1];
  sample.sort((a, b) => a - b);
  const low = sample[Math.floor(0.03 * sample.length)];
  const high = sample[Math.floor(0.97 * (sample.length - 1))];
  return [low, Math.max(high, low + 1)];
}

/** The range of a view in units that last from picture to picture; follows slowly. */
function follow(name, [low, high]) {
  const before = state.ranges[name];
  if (before && $("lock").checked) return;
  const jump = !before || Math.abs(high - before[1]) > 0.5 * (before[1] - before[0]);
  const share = jump ? 1 : 0.1;
  const [a, b] = jump ? [low, high] : before;
  state.ranges[name] = [a + share * (low - a), b + share * (high - b)];
}

function onPicture(buffer, shown) {
  const picture = decodePicture(buffer);
  state.picture = picture;
  state.arrivedMs = performance.now();
  const { planes, depth_scale: scale } = picture;
  if (planes.depth) follow("depth", limits(planes.depth).map((v) => v * scale));
  follow("photons", limits(planes.photons));
  const target = state.view === "points" ? cloud : plane;
  target.show(picture);
  state.shownAck = () => shown(picture.number);
  state.drawn = false;
  refreshPixel();
}

function rangeOf(view) {
  if (view === "photons") return state.ranges.photons ?? [0, 1];
  const scale = state.picture?.depth_scale ?? 1;
  return (state.ranges.depth ?? [0, 1]).map((v) => v / scale);
}

function draw() {
  requestAnimationFrame(draw);
  showAge();
  if (state.drawn || !state.instrument) return;
  state.drawn = true;
  const { bands, slope_right, slope_down } = state.instrument;
  const rgb = rgbBands(bands);
  const three = $("three").checked || !state.picture?.planes.colours;
  const calibrated = Boolean(state.picture?.planes.depth);
  const view = calibrated ? state.view : "photons";
  if (state.view === "points" && calibrated) {
    cloud.draw({ rgb, three, range: rangeOf("depth"), slopes: [slope_right, slope_down] });
  } else {
    plane.draw({ view, bands, rgb, three, range: rangeOf(view) });
  }
  $("hint").hidden = calibrated || !state.picture;
  $("hint").textContent = hint();
  showBar(view);
  showCursor();
  if (state.shownAck) {
    // the answer is sent when the drawing is done, not when it was asked for
    const gl = state.view === "points" && calibrated ? cloud.gl : plane.gl;
    gl.finish();
    state.shownAck();
    state.shownAck = null;
  }
}

function hint() {
  const kind = state.picture?.kind;
  if (kind && !["scene", "reference"].includes(kind)) return `capture ${kind}: photons`;
  return state.status?.calibration.calibrated
    ? "photons" : "not calibrated: photons only. Press C to calibrate";
}

function redraw() {
  state.drawn = false;
}

function showAge() {
  const age = state.arrivedMs === null ? Infinity : (performance.now() - state.arrivedMs) / 1e3;
  const { status, connected } = state;
  const old = !connected || (status !== null && (age > status.picture.stale_after_s || status.state === "disconnected"));
  $("view").classList.toggle("old", old && state.picture !== null);
  const words = !connected ? "The daemon is not reachable."
    : !status || status.state === "idle" ? "Stopped."
    : status.state === "disconnected" ? "No camera."
    : state.picture ? "No new picture." : "Waiting for the first picture.";
  const since = Number.isFinite(age) ? `\nThis picture is ${age < 100 ? age.toFixed(0) : Math.round(age / 60) + " ·60"} s old.` : "";
  const text = old || !state.picture ? words + since : "";
  const stale = $("stale");
  stale.hidden = !text;
  if (stale.textContent !== text) stale.textContent = text;
}

function showBar(view) {
  const bar = document.querySelector(".bar");
  const coloured = view === "colour" || view === "points";
  $("three-label").hidden = !coloured || !state.picture?.planes.colours;
  const shown = view === "depth" || view === "photons";
  bar.classList.toggle("off", !shown);
  if (!shown) return;
  const [low, high] = state.ranges[view] ?? [0, 1];
  const words = view === "depth" ? (v) => `${v.toFixed(3)} m` : (v) => `${Math.round(v)} photons`;
  $("bar-low").textContent = words(low);
  $("bar-high").textContent = words(high);
}

function paintBar() {
  const canvas = $("bar");
  canvas.width = 256;
  canvas.height = 1;
  const image = new ImageData(new Uint8ClampedArray(colourMap()), 256, 1);
  canvas.getContext("2d").putImageData(image, 0, 0);
}

// -- the pixel -----------------------------------------------------------------------------------

function choosePixel(row, col) {
  const { rows, cols } = state.instrument;
  state.pixel = [Math.max(0, Math.min(rows - 1, row)), Math.max(0, Math.min(cols - 1, col))];
  state.pixelAskedMs = 0;
  refreshPixel();
  redraw();
}

async function refreshPixel() {
  const now = performance.now();
  if (!state.pixel || !state.picture || now - state.pixelAskedMs < PIXEL_MS) return;
  state.pixelAskedMs = now;
  const [row, col] = state.pixel;
  try {
    const facts = await ask("GET", `/api/pixel?row=${row}&col=${col}`);
    if (state.pixel[0] === row && state.pixel[1] === col) showPixel(facts);
  } catch (error) {
    $("pixel-note").textContent = error.message;
  }
}

function showPixel(facts) {
  state.pixelFacts = facts;
  const { bands } = state.instrument;
  $("pixel-place").textContent = `row ${facts.row}, column ${facts.col}`;
  const depth = facts.depth_m === null ? "no depth" : `${facts.depth_m.toFixed(4)} m`;
  const spread = facts.depth_std_m === null ? "" : ` ± ${(1e3 * facts.depth_std_m).toFixed(1)} mm`;
  $("pixel-depth").textContent = depth + spread;
  // what a live picture skips has not changed since it was fitted
  const words = facts.quality.map((flag) => (flag === "skipped" ? "unchanged" : flag));
  const flags = words.length ? `; ${words.join(", ")}` : "";
  $("pixel-note").textContent = `${facts.photons.toLocaleString("en")} photons in ${facts.frames} frames${flags}`;
  drawHistogram($("histogram"), facts, bands);
  drawSpectrum($("spectrum"), facts, bands);
}

function showCursor() {
  const cursor = $("cursor");
  const tiled = state.view === "bands" && state.picture?.planes.depth;
  cursor.hidden = !state.pixel || state.view === "points" || tiled;
  if (cursor.hidden) return;
  const { rows, cols } = state.instrument;
  cursor.style.left = `${((state.pixel[1] + 0.5) / cols) * 100}%`;
  cursor.style.top = `${((state.pixel[0] + 0.5) / rows) * 100}%`;
}

// -- views ---------------------------------------------------------------------------------------

function chooseView(view) {
  state.view = view;
  for (const tab of document.querySelectorAll("[role=tab]")) {
    tab.setAttribute("aria-selected", String(tab.dataset.view === view));
  }
  $("plane").hidden = view === "points";
  $("cloud").hidden = view !== "points";
  if (state.picture) (view === "points" ? cloud : plane).show(state.picture);
  const labels = $("labels");
  labels.replaceChildren();
  if (view === "bands" && state.instrument) {
    const { bands } = state.instrument;
    Plane.tiles(bands.length).forEach(([x, y], i) => {
      const label = document.createElement("span");
      label.textContent = `${bands[i].name} ${bands[i].wavelength_nm} nm`;
      label.style.left = `${100 * x}%`;
      label.style.top = `${100 * y}%`;
      labels.append(label);
    });
  }
  redraw();
}

// -- commands ------------------------------------------------------------------------------------

let toastTimer = 0;
function say(text) {
  const message = $("message");
  message.textContent = text;
  message.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => { message.hidden = true; }, 5000);
}

async function command(path, body) {
  try {
    return await ask("POST", path, body);
  } catch (error) {
    say(error.message);
    return null;
  }
}

const commands = {
  run: () => command(state.status?.state === "idle" ? "/api/start" : "/api/stop"),
  record: async () => {
    const on = state.status?.recording.name;
    const answer = await command(on ? "/api/recordings/stop" : "/api/recordings", on ? undefined : {});
    if (answer) say(on ? `recording ${answer.name} ends` : `recording ${answer.name}`);
  },
  calibrate: () => $("calibrate-dialog").showModal(),
  theme: () => {
    const dark = document.documentElement.dataset.theme === "dark";
    chooseTheme(dark ? "light" : "dark");
    localStorage.setItem("hueflight-theme", dark ? "light" : "dark");
  },
};

async function beginCalibration() {
  const answer = await command("/api/calibration", {
    distance: Number($("distance").value),
    frames: Number($("frames").value),
    bands: $("with-bands").checked,
    dark: $("with-dark").checked,
  });
  if (answer) say("calibration begins");
}

function chooseTheme(theme) {
  document.documentElement.dataset.theme = theme;
  if (state.pixelFacts) showPixel(state.pixelFacts);
}

function showButtons() {
  const { status, connected } = state;
  const running = status.state !== "idle";
  $("run").lastElementChild.textContent = running ? "Stop" : "Start";
  $("record").lastElementChild.textContent = status.recording.name ? "End recording" : "Record";
  $("record").classList.toggle("on", Boolean(status.recording.name));
  const busy = !["idle", "done", "failed"].includes(status.calibration.step);
  $("calibrate").lastElementChild.textContent = busy ? "Calibrating" : "Calibrate";
  for (const name of ["run", "record", "calibrate"]) $(name).disabled = !connected;
  $("calibrate").disabled ||= busy;
}

// -- input ---------------------------------------------------------------------------------------

const VIEW_KEYS = { 1: "depth", 2: "colour", 3: "bands", 4: "points", 5: "photons" };
const ARROWS = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || $("calibrate-dialog").open) return;
  const typing = event.target.matches("input, select, textarea");
  if (typing) return;
  const onButton = event.target.matches("button, summary, a");
  const { key } = event;
  if (VIEW_KEYS[key]) chooseView(VIEW_KEYS[key]);
  else if (key === " " && !onButton) commands.run();
  else if (key === "r") commands.record();
  else if (key === "c") commands.calibrate();
  else if (key === "t") commands.theme();
  else if (ARROWS[key] && !onButton && state.instrument) arrow(ARROWS[key], event.shiftKey ? 8 : 1);
  else if ("+-0".includes(key) && state.view === "points") zoomKey(key);
  else return;
  event.preventDefault();
}

function arrow([down, right], step) {
  if (state.view === "points") {
    cloud.turnBy(0.08 * right * step, 0.08 * down * step);
    redraw();
    return;
  }
  const { rows, cols } = state.instrument;
  const [row, col] = state.pixel ?? [rows >> 1, cols >> 1];
  choosePixel(row + down * step, col + right * step);
}

function zoomKey(key) {
  if (key === "0") cloud.home();
  else cloud.zoomBy(key === "+" ? 0.85 : 1 / 0.85);
  redraw();
}

function onTabKey(event) {
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (!step) return;
  const tabs = [...document.querySelectorAll("[role=tab]")];
  const next = tabs.at((tabs.indexOf(event.target) + step) % tabs.length);
  next.focus();
  chooseView(next.dataset.view);
  event.preventDefault();
  event.stopPropagation();
}

function pixelAt(event) {
  const box = $("view").getBoundingClientRect();
  let x = (event.clientX - box.left) / box.width;
  let y = (event.clientY - box.top) / box.height;
  const { rows, cols, bands } = state.instrument;
  if (state.view === "bands" && state.picture?.planes.depth) {
    const tile = Plane.tiles(bands.length).find(([tx, ty, w, h]) => x >= tx && x < tx + w && y >= ty && y < ty + h);
    if (!tile) return null;
    x = (x - tile[0]) / tile[2];
    y = (y - tile[1]) / tile[3];
  }
  return [Math.floor(y * rows), Math.floor(x * cols)];
}

function watchPointer(view) {
  const pointers = new Map();
  view.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    view.setPointerCapture(event.pointerId);
    if (state.view !== "points" && state.instrument) {
      const place = pixelAt(event);
      if (place) choosePixel(...place);
    }
  });
  view.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    if (state.view === "points") {
      const others = [...pointers].filter(([id]) => id !== event.pointerId);
      if (others.length) {
        const [ox, oy] = others[0][1];
        const old = Math.hypot(before[0] - ox, before[1] - oy);
        cloud.zoomBy(old / Math.max(1, Math.hypot(event.clientX - ox, event.clientY - oy)));
      } else {
        cloud.turnBy((event.clientX - before[0]) / 150, (event.clientY - before[1]) / 150);
      }
      redraw();
    } else if (state.instrument) {
      const place = pixelAt(event);
      if (place) choosePixel(...place);
    }
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    view.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }
  view.addEventListener("wheel", (event) => {
    if (state.view !== "points") return;
    cloud.zoomBy(Math.exp(event.deltaY / 500));
    redraw();
    event.preventDefault();
  }, { passive: false });
}

// -- beginning -----------------------------------------------------------------------------------

function onStatus(status) {
  state.status = status;
  showState(status, state.connected);
  showFacts(status);
  showButtons();
  document.title = `${status.name} – ${$("state").textContent}`;
  $("name").textContent = status.name;
}

async function learnInstrument() {
  const instrument = await ask("GET", "/api/instrument");
  state.instrument = instrument;
  const { rows, cols, pixel_aspect } = instrument;
  $("view").style.aspectRatio = `${cols} / ${rows * pixel_aspect}`;
  $("guidance").textContent = instrument.guidance.reference;
  drawHistogram($("histogram"), null, instrument.bands);
  drawSpectrum($("spectrum"), null, instrument.bands);
  chooseView(state.view);
}

function begin() {
  const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  chooseTheme(localStorage.getItem("hueflight-theme") ?? system);
  try {
    plane = new Plane($("plane"));
    cloud = new Cloud($("cloud"));
  } catch (error) {
    $("problem").textContent = error.message;
    $("problem").hidden = false;
    return;
  }
  paintBar();
  for (const tab of document.querySelectorAll("[role=tab]")) {
    tab.addEventListener("click", () => chooseView(tab.dataset.view));
    tab.addEventListener("keydown", onTabKey);
  }
  for (const name of Object.keys(commands)) $(name).addEventListener("click", commands[name]);
  $("calibrate-dialog").addEventListener("close", () => {
    if ($("calibrate-dialog").returnValue === "go") beginCalibration();
  });
  $("calibrate-cancel").addEventListener("click", () => $("calibrate-dialog").close("cancel"));
  $("three").addEventListener("change", redraw);
  document.addEventListener("keydown", onKey);
  watchPointer($("view"));
  new ResizeObserver(() => {
    redraw();
    if (state.pixelFacts) showPixel(state.pixelFacts);
  }).observe($("view"));
  live({
    onPicture,
    onStatus,
    onOpen: () => {
      state.connected = true;
      learnInstrument().catch((error) => say(error.message));
    },
    onClose: () => {
      state.connected = false;
      if (state.status) {
        showState(state.status, false);
        showButtons();
      } else {
        $("state").textContent = "daemon not reachable";
      }
    },
  });
  requestAnimationFrame(draw);
}

begin();
