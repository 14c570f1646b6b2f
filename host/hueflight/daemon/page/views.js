// SPDX-License-Identifier: Apache-2.0
// The views of a picture: which one is chosen, drawing it, and what stands around it.

import { drawAxes } from "./axes.js";
import { chosenFlags, depthLimit, fadeLimit, startCertainty } from "./certainty.js";
import { Cloud } from "./cloud.js";
import { rgbBands } from "./colours.js";
import { $, tabs } from "./dom.js";
import { showHover, startHover } from "./hover.js";
import { placeMeasurements, showMeasurements } from "./measure.js";
import { showCursor } from "./pixel.js";
import { Plane } from "./plane.js";
import { planeRange, rangeOf, updateRanges } from "./ranges.js";
import { isLogarithmic, showScale, startScale } from "./scale.js";
import { addToSeries, drawSeries } from "./series.js";
import { isCalibrated, redraw, state } from "./state.js";

let plane, cloud;
let answerShown = null; // tells the daemon that the latest picture is on the screen

/** Make the canvases and begin to draw; throws an Error in a browser without WebGL2. */
export function startViews() {
  plane = new Plane($("plane"));
  cloud = new Cloud($("cloud"));
  startScale((name) => plane.chooseMap(name));
  startCertainty();
  startHover();
  $("series-of").addEventListener("change", drawSeries);
  requestAnimationFrame(draw);
}

/** Choose the view by its name. */
export function chooseView(view) {
  state.view = view;
  for (const tab of tabs()) tab.setAttribute("aria-selected", String(tab.dataset.view === view));
  $("plane").hidden = view === "points";
  for (const id of ["cloud", "axes", "reset-points"]) $(id).hidden = view !== "points";
  if (state.picture) chosenCanvas().show(state.picture);
  labelBands();
  redraw();
}

/** Take a new picture; `shown` is called when it is on the screen. */
export function showPicture(picture, shown) {
  answerShown = shown;
  if (!state.frozen) {
    state.picture = picture;
    state.arrivedMs = performance.now();
    updateRanges(picture);
    chosenCanvas().show(picture);
    addToSeries(picture, showMeasurements());
    drawSeries();
    showHover();
  }
  redraw();
}

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

function draw() {
  requestAnimationFrame(draw);
  showAge();
  if (state.drawn || !state.instrument) return;
  state.drawn = true;
  const { bands, slope_right, slope_down } = state.instrument;
  const rgb = rgbBands(bands);
  const three = $("three").checked || !state.picture?.planes.colours;
  const calibrated = isCalibrated();
  const view = calibrated ? state.view : "photons";
  const canvas = view === "points" ? cloud : plane;
  if (canvas === cloud) {
    const limit = Number.isFinite(depthLimit()) ? depthLimit() : 0;
    cloud.draw({
      rgb, three, range: planeRange("depth"), slopes: [slope_right, slope_down], limit, flags: chosenFlags(),
    });
    const [near, far] = rangeOf("depth");
    const across = [slope_right, slope_down].map((slope) => 0.8 * Math.abs(slope) * near);
    drawAxes($("axes"), cloud.camera, [...across.map((v) => [-v, v]), [near, far]]);
  } else {
    plane.draw({
      view, bands, rgb, three, range: planeRange(view), logarithmic: isLogarithmic(), limit: fadeLimit(),
      flags: chosenFlags(),
    });
  }
  $("hint").hidden = calibrated || !state.picture;
  $("hint").textContent = hint();
  showScale(view);
  $("three-label").hidden = !["colour", "points"].includes(view) || !state.picture?.planes.colours;
  showCursor();
  placeMeasurements();
  if (answerShown) {
    // wait until drawing is done, so that the daemon's latency includes it
    canvas.gl.finish();
    answerShown();
    answerShown = null;
  }
}

function hint() {
  const kind = state.picture?.kind;
  if (kind && !["scene", "reference"].includes(kind)) return `Capture of kind ${kind}: photons only.`;
  return state.status?.calibration.calibrated
    ? "Photons only." : "This camera is not calibrated: photons only. Press C to calibrate.";
}

function showAge() {
  const age = state.arrivedMs === null ? Infinity : (performance.now() - state.arrivedMs) / 1e3;
  const { status, connected } = state;
  const old = !state.frozen && (!connected || (status !== null && (age > status.picture.stale_after_s || ["disconnected", "failed"].includes(status.state))));
  $("view").classList.toggle("old", old && state.picture !== null);
  const reason = !connected ? "The daemon is not reachable."
    : !status || status.state === "idle" ? "Stopped."
    : status.state === "disconnected" ? "No camera."
    : status.state === "failed" ? "Acquisition has failed; it begins anew soon."
    : state.picture ? "No new picture." : "Waiting for the first picture.";
  const duration = age < 100 ? `${age.toFixed(0)} s` : `${Math.round(age / 60)} min`;
  const since = Number.isFinite(age) ? `\nThis picture is ${duration} old.` : "";
  const text = state.frozen ? "" : old || !state.picture ? reason + since : "";
  const stale = $("stale");
  stale.hidden = !text;
  if (stale.textContent !== text) stale.textContent = text;
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
