// SPDX-License-Identifier: Apache-2.0
// The views of a picture: which one is chosen, drawing it, and what stands around it.

import { drawAxes } from "./axes.js";
import { chosenFlags, depthLimit, fadeLimit, startCertainty } from "./certainty.js";
import { Cloud } from "./cloud.js";
import { rgbBands } from "./colours.js";
import { $, setShown, setText, tabs } from "./dom.js";
import { showHover, startHover } from "./hover.js";
import { drawMaterials, refreshMaterials } from "./materials.js";
import { measureRegion, placeMeasurements, showMeasurements } from "./measure.js";
import { showMessage } from "./messages.js";
import { paced } from "./pace.js";
import { showCursor } from "./pixel.js";
import { Plane } from "./plane.js";
import { planeRange, rangeOf, updateRanges } from "./ranges.js";
import { isLogarithmic, showScale, startScale } from "./scale.js";
import { addToSeries, drawSeries } from "./series.js";
import { drawBy, isCalibrated, redraw, state } from "./state.js";

const AROUND_MS = 200; // from change to change of what stands around the picture: nobody reads faster
const AGE_MS = 250; // from look to look at the picture's age

let plane = null;
let cloud = null; // made when points are first looked at
let answerShown = null; // tells the daemon that the latest picture is on the screen
let frame = null; // the animation frame that is waited for
let pictureOutdated = true;
let aroundOutdated = true;
let followed = 0; // pictures since the ranges were adapted

/** Make the canvas and begin to draw. */
export function startViews() {
  plane = new Plane($("plane"));
  startScale((name) => plane.chooseMap(name));
  startCertainty();
  startHover();
  $("series-of").addEventListener("change", drawSeries);
  drawBy(() => {
    aroundOutdated = true;
    drawPictureSoon();
  });
  setInterval(showAge, AGE_MS);
  redraw();
}

/** Choose the view by its name. */
export function chooseView(view) {
  if (view === "points") {
    try {
      cloud ??= new Cloud($("cloud"));
    } catch (error) {
      showMessage(error.message);
      return;
    }
  }
  state.view = view;
  for (const tab of tabs()) tab.setAttribute("aria-selected", String(tab.dataset.view === view));
  $("plane").hidden = view === "points";
  for (const id of ["cloud", "axes", "reset-points"]) $(id).hidden = view !== "points";
  if (state.picture) chosenCanvas().show(state.picture);
  labelBands();
  refreshMaterials();
  redraw();
}

/** Take a new picture; `shown` is called when it is on the screen. */
export function showPicture(picture, shown) {
  answerShown = shown;
  if (state.frozen) {
    drawSoon();
    return;
  }
  const before = state.picture;
  const isOther = !before?.planes.depth !== !picture.planes.depth; // the ranges before say nothing of this one
  state.picture = picture;
  state.arrivedMs = performance.now();
  followed++;
  addToSeries(picture, measureRegion(picture, state.region, state.instrument?.bands.length));
  chosenCanvas().show(picture);
  if (!before || isOther) follow();
  else followSoon();
  drawPictureSoon();
}

/** Adapt to the latest picture what stands around it. */
function follow() {
  if (!state.picture) return;
  updateRanges(state.picture, followed);
  followed = 0;
  showMeasurements();
  drawSeries();
  showHover();
  redraw();
}

const followSoon = paced(follow, AROUND_MS);

/** Turn the cloud of points, in radians. */
export function turnCloud(turn, tilt) {
  cloud.turnBy(turn, tilt);
  redraw();
}

/** Move the cloud of points away by a factor. */
export function zoomCloud(factor) {
  cloud.zoomBy(factor);
  redraw();
}

/** Show the cloud of points as at the beginning. */
export function resetCloud() {
  cloud.home();
  redraw();
}

function chosenCanvas() {
  return state.view === "points" ? cloud : plane;
}

function drawSoon() {
  frame ??= requestAnimationFrame(draw);
}

function drawPictureSoon() {
  pictureOutdated = true;
  drawSoon();
}

/** Draw what is outdated, once for all that happened since the last animation frame. */
function draw() {
  frame = null;
  if (!state.instrument) return;
  const view = isCalibrated() ? state.view : "photons";
  if (pictureOutdated) drawPicture(view);
  if (aroundOutdated) drawAround(view);
  pictureOutdated = aroundOutdated = false;
  if (answerShown) setTimeout(answerShown); // after the browser has painted, so that the daemon's latency includes it
  answerShown = null;
}

function drawPicture(view) {
  const { bands } = state.instrument;
  const rgb = rgbBands(bands);
  const three = $("three").checked || !state.picture?.planes.colours;
  if (view === "points") {
    drawPoints(rgb, three);
  } else {
    plane.draw({
      view, bands, rgb, three, range: planeRange(view), logarithmic: isLogarithmic(), limit: fadeLimit(),
      flags: chosenFlags(),
    });
  }
}

function drawPoints(rgb, three) {
  const { slope_right, slope_down } = state.instrument;
  const limit = Number.isFinite(depthLimit()) ? depthLimit() : 0;
  cloud.draw({
    rgb, three, range: planeRange("depth"), slopes: [slope_right, slope_down], limit, flags: chosenFlags(),
  });
  const [near, far] = rangeOf("depth");
  const across = [slope_right, slope_down].map((slope) => 0.8 * Math.abs(slope) * near);
  drawAxes($("axes"), cloud.camera, [...across.map((v) => [-v, v]), [near, far]]);
  cloud.gl.finish();
}

function drawAround(view) {
  drawMaterials(view === "materials");
  setShown($("hint"), !isCalibrated() && state.picture);
  setText($("hint"), hint());
  showScale(view);
  setShown($("three-label"), ["colour", "points"].includes(view) && state.picture?.planes.colours);
  showCursor();
  placeMeasurements();
  showAge();
}

function hint() {
  const kind = state.picture?.kind;
  const { file } = state;
  if (file && ["scene", "reference"].includes(kind)) return "Photons only: there is no calibration for this file.";
  if (kind && !["scene", "reference"].includes(kind)) return `Capture of kind ${kind}: photons only.`;
  if (state.status?.simulation?.calibrating) return "Photons only, until the simulated camera is calibrated in some seconds.";
  return state.status?.calibration.calibrated
    ? "Photons only." : "This camera is not calibrated: photons only. Press C to calibrate.";
}

function showAge() {
  const age = state.arrivedMs === null ? Infinity : (performance.now() - state.arrivedMs) / 1e3;
  const { status, connected } = state;
  const old = !state.frozen && !state.file && (!connected || (status !== null && (age > status.picture.stale_after_s || ["disconnected", "failed"].includes(status.state))));
  const reading = state.file !== null && !state.picture; // what is drawn is still of before
  $("view").classList.toggle("old", (old && state.picture !== null) || reading);
  const reason = state.file ? "Reading." : !connected ? "The daemon is not reachable."
    : !status || status.state === "idle" ? "Stopped."
    : status.state === "disconnected" ? "No camera."
    : status.state === "failed" ? "Acquisition has failed; it begins anew soon."
    : state.picture ? "No new picture." : "Waiting for the first picture.";
  const duration = age < 100 ? `${age.toFixed(0)} s` : `${Math.round(age / 60)} min`;
  const since = Number.isFinite(age) ? `\nThis picture is ${duration} old.` : "";
  const text = state.frozen ? "" : old || !state.picture ? reason + since : "";
  const stale = $("stale");
  setShown(stale, text);
  setText(stale, text);
}

function labelBands() {
  const labels = $("labels");
  labels.replaceChildren();
  if (state.view !== "bands" || !state.instrument) return;
  const { bands } = state.instrument;
  Plane.tiles(bands.length).forEach(([x, y], i) => {
    const label = document.createElement("span");
    label.textContent = `${bands[i].name} ${bands[i].wavelength_nm} nm`;
    label.style.left = `${100 * x}%`;
    label.style.top = `${100 * y}%`;
    labels.append(label);
  });
}
