// SPDX-License-Identifier: Apache-2.0
// Ranges of the colour scales, which follow the pictures slowly.

import { $ } from "./dom.js";
import { state } from "./state.js";

const UNKNOWN = 65535;
const ranges = {};

/** Third and 97th percentile of a plane's known values. */
function percentiles(values) {
  const sample = [];
  const step = Math.max(1, Math.floor(values.length / 4096));
  for (let i = 0; i < values.length; i += step) if (values[i] !== UNKNOWN) sample.push(values[i]);
  if (sample.length < 2) return [0, 1];
  sample.sort((a, b) => a - b);
  const low = sample[Math.floor(0.03 * sample.length)];
  const high = sample[Math.floor(0.97 * (sample.length - 1))];
  return [low, Math.max(high, low + 1)];
}

function follow(name, [low, high]) {
  const before = ranges[name];
  if (before && $("lock").checked) return;
  const jump = !before || Math.abs(high - before[1]) > 0.5 * (before[1] - before[0]);
  const share = jump ? 1 : 0.1;
  const [a, b] = jump ? [low, high] : before;
  ranges[name] = [a + share * (low - a), b + share * (high - b)];
}

/** Adapt the ranges to a picture, unless they are locked. */
export function updateRanges({ planes, depth_scale: scale }) {
  if (planes.depth) follow("depth", percentiles(planes.depth).map((v) => v * scale));
  follow("photons", percentiles(planes.photons));
}

/** Range of a view, in metres of depth or in photons. */
export function rangeOf(view) {
  return ranges[view] ?? [0, 1];
}

/** Range of a view in the units of its plane; of views without a scale, that of depth. */
export function planeRange(view) {
  if (view === "photons") return rangeOf("photons");
  const scale = state.picture?.depth_scale ?? 1;
  return rangeOf("depth").map((v) => v / scale);
}
