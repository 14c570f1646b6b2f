// SPDX-License-Identifier: Apache-2.0
// Ranges of the colour scales: they follow the pictures slowly, unless they are locked.

import { $ } from "./dom.js";
import { state } from "./state.js";
import { brightnessOf, depthOf, materialOf } from "./values.js";

const SAMPLES = 4096;
const KEPT = 0.9; // of a range, from picture to picture
const ranges = {};
const samples = {}; // sorted known values of each view

/** Views that have a colour scale: unit, decimals, and the value of a pixel. */
export const SCALES = {
  depth: { unit: "m", digits: 3, value: depthOf },
  photons: { unit: "photons per frame", digits: 4, value: brightnessOf },
  materials: { unit: "", digits: 3, value: (_, index) => materialOf(state.material, index) },
};

function sample(picture, value) {
  const count = picture.rows * picture.cols;
  const step = Math.max(1, Math.floor(count / SAMPLES));
  const found = new Float64Array(Math.ceil(count / step));
  let known = 0;
  for (let i = 0; i < count; i += step) {
    const v = value(picture, i);
    if (Number.isFinite(v)) found[known++] = v;
  }
  return found.subarray(0, known).sort();
}

/** Range that holds most values of sorted ones. */
function most(sorted) {
  const low = sorted[Math.floor(0.03 * sorted.length)];
  return [low, Math.max(sorted[Math.floor(0.97 * (sorted.length - 1))], low + 1e-4)];
}

/** Range that holds most values of a picture; `value` gives that of a pixel. */
export function spanOf(picture, value) {
  const sorted = sample(picture, value);
  return sorted.length < 2 ? [0, 1] : most(sorted);
}

function follow(name, sorted, pictures) {
  if (sorted.length < 2) return;
  const [low, high] = most(sorted);
  const before = ranges[name];
  if (before && $("lock").checked) return;
  const jump = !before || Math.abs(high - before[1]) > 0.5 * (before[1] - before[0]);
  const share = jump ? 1 : 1 - KEPT ** pictures;
  const [a, b] = jump ? [low, high] : before;
  ranges[name] = [a + share * (low - a), b + share * (high - b)];
}

/** Adapt the ranges to the last one of some pictures, unless they are locked. */
export function updateRanges(picture, pictures) {
  if (picture.planes.depth) updateRange("depth", picture, pictures);
  updateRange("photons", picture, pictures);
}

/** Adapt the range of one view to the last one of some pictures, unless it is locked. */
export function updateRange(name, picture, pictures = 1) {
  samples[name] = sample(picture, SCALES[name].value);
  follow(name, samples[name], pictures);
}

/** Range of a view, in metres of depth or in photons per frame. */
export function rangeOf(view) {
  return ranges[view] ?? [0, 1];
}

/** Choose the range of a view by hand, which locks it. */
export function setRange(view, low, high) {
  if (!(high > low)) return;
  ranges[view] = [low, high];
  $("lock").checked = true;
}

/** Range of a view in the units of its plane; of views without a scale, that of depth. */
export function planeRange(view) {
  if (view === "photons") return rangeOf("photons");
  const scale = state.picture?.depth_scale ?? 1;
  return rangeOf("depth").map((v) => v / scale);
}

/** Pixels in each of `bins` classes between the ends of a view's values, and these ends. */
export function histogramOf(view, bins) {
  const sorted = samples[view] ?? [];
  if (sorted.length < 2) return null;
  const [low, high] = [sorted[0], sorted.at(-1)];
  const counts = new Array(bins).fill(0);
  for (const v of sorted) counts[Math.min(bins - 1, Math.floor(((v - low) / (high - low || 1)) * bins))]++;
  return { low, high, counts };
}
