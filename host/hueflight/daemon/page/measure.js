// SPDX-License-Identifier: Apache-2.0
// Measurements on the picture: a region's mean depth and spectrum, and the distance of two points.

import { $, setShown, setText } from "./dom.js";
import { redraw, state } from "./state.js";
import { brightnessOf, depthOf, depthStdOf, placeOf, reflectanceOf } from "./values.js";

/** Choose what a drag or click measures; the same tool again puts it away. */
export function chooseTool(tool) {
  state.tool = state.tool === tool ? "" : tool;
  if (tool === "region" && !state.tool) state.region = null;
  if (tool === "distance") state.ends = [];
  for (const name of ["region", "distance"]) {
    $(`${name}-tool`).setAttribute("aria-pressed", String(state.tool === name));
  }
  showMeasurements();
  redraw();
}

/** Span the region from one pixel to another. */
export function spanRegion([row0, col0], [row1, col1]) {
  const [top, left] = [Math.min(row0, row1), Math.min(col0, col1)];
  state.region = [top, left, Math.abs(row1 - row0) + 1, Math.abs(col1 - col0) + 1];
  showMeasurements();
  redraw();
}

/** Add an end of the distance; a third one begins anew. */
export function addEnd(place) {
  state.ends = state.ends.length === 2 ? [place] : [...state.ends, place];
  showMeasurements();
  redraw();
}

/**
 * Mean, standard error of the mean from the scatter of the pixels, scatter, and number of pixels;
 * with standard deviations each pixel is weighted by 1 / std².
 */
export function meanOf(values, stds = null) {
  let [sum, weights, n] = [0, 0, 0];
  const weight = (i) => (stds ? 1 / Math.max(stds[i], 1e-9) ** 2 : 1);
  const known = (i) => Number.isFinite(values[i]) && (!stds || Number.isFinite(stds[i]));
  for (let i = 0; i < values.length; i++) {
    if (!known(i)) continue;
    sum += weight(i) * values[i];
    weights += weight(i);
    n++;
  }
  if (!n) return { mean: NaN, error: NaN, scatter: NaN, n };
  const mean = sum / weights;
  let [squares, weighted] = [0, 0];
  for (let i = 0; i < values.length; i++) {
    if (!known(i)) continue;
    squares += (values[i] - mean) ** 2;
    weighted += (weight(i) * (values[i] - mean)) ** 2;
  }
  const scatter = n > 1 ? Math.sqrt(squares / (n - 1)) : NaN;
  const error = n > 1 ? Math.sqrt((weighted * n) / (n - 1)) / weights : NaN;
  return { mean, error, scatter, n };
}

/** What is known of the region in a picture; null without a region. */
export function measureRegion(picture, region, bandCount) {
  if (!region || !picture) return null;
  const indices = [];
  for (let row = region[0]; row < region[0] + region[2]; row++) {
    for (let col = region[1]; col < region[1] + region[3]; col++) indices.push(row * picture.cols + col);
  }
  const of = (value) => indices.map((index) => value(picture, index));
  const bands = picture.planes.bands ? bandCount : 0;
  return {
    depth: meanOf(of(depthOf), of(depthStdOf)),
    photons: meanOf(of(brightnessOf)),
    spectrum: Array.from({ length: bands }, (_, band) => meanOf(indices
      .filter((index) => Number.isFinite(depthOf(picture, index)))
      .map((index) => reflectanceOf(picture, band, index)))),
    pixels: indices.length,
  };
}

/** Distance in metres of two pixels in space, and its standard deviation; NaN where a depth is unknown. */
export function distanceOf(picture, instrument, [from, to]) {
  const indices = [from, to].map(([row, col]) => row * picture.cols + col);
  const [a, b] = indices.map((index) => placeOf(picture, index, instrument));
  const gap = a.map((v, i) => b[i] - v);
  const distance = Math.hypot(...gap);
  // an end moves along its own ray when its depth changes
  const variance = indices.reduce((sum, index, end) => {
    const ray = (end ? b : a).map((v) => v / depthOf(picture, index));
    const along = ray.reduce((s, v, i) => s + v * gap[i], 0) / distance;
    return sum + (along * depthStdOf(picture, index)) ** 2;
  }, 0);
  return { distance, std: Math.sqrt(variance), gap };
}

/** Show the measurements in the present picture. */
export function showMeasurements() {
  const { picture, instrument, region, ends } = state;
  const found = instrument && measureRegion(picture, region, instrument.bands.length);
  setShown($("measured"), found);
  if (found) showRegion(found);
  const text = $("distance-text");
  setShown(text, state.tool === "distance" || ends.length === 2);
  setText(text, ends.length === 2 && picture ? distanceText(distanceOf(picture, instrument, ends)) : "Click two points to measure their distance.");
}

function distanceText({ distance, std, gap }) {
  if (!Number.isFinite(distance)) return "Distance unknown: an end has no depth.";
  const [right, down, away] = gap.map((v) => v.toFixed(3));
  return `Distance ${distance.toFixed(4)} m ± ${(1e3 * std).toFixed(1)} mm (right ${right}, down ${down}, away ${away} m)`;
}

function showRegion({ depth, photons, spectrum, pixels }) {
  const [row, col, rows, cols] = state.region;
  setText($("region-place"), `${rows} × ${cols} pixels at row ${row}, column ${col}`);
  setText($("region-depth"), depth.n
    ? `depth ${depth.mean.toFixed(4)} m ± ${(1e3 * depth.error).toFixed(2)} mm, scatter ${(1e3 * depth.scatter).toFixed(1)} mm, ${depth.n} of ${pixels} pixels`
    : `no depth; ${photons.mean.toFixed(4)} photons per frame`);
  setText($("region-spectrum"), spectrum
    .map(({ mean, error }, band) => `${state.instrument.bands[band].wavelength_nm} nm ${mean.toFixed(3)} ± ${error.toFixed(3)}`)
    .join(" · "));
}

/** Draw region and distance over the picture. */
export function placeMeasurements() {
  const { region, ends, instrument, view } = state;
  const flat = instrument && !["points", "bands"].includes(view);
  setShown($("region"), flat && region);
  const percent = (v, all) => `${(100 * v) / all}%`;
  if (!$("region").hidden) {
    const style = $("region").style;
    [style.top, style.height] = [region[0], region[2]].map((v) => percent(v, instrument.rows));
    [style.left, style.width] = [region[1], region[3]].map((v) => percent(v, instrument.cols));
  }
  $("ruler").toggleAttribute("hidden", !flat || ends.length < 2);
  if (!flat || ends.length < 2) return;
  const line = $("ruler").firstElementChild;
  ends.forEach(([row, col], i) => {
    line.setAttribute(`x${i + 1}`, percent(col + 0.5, instrument.cols));
    line.setAttribute(`y${i + 1}`, percent(row + 0.5, instrument.rows));
  });
}
