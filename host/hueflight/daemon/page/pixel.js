// SPDX-License-Identifier: Apache-2.0
// The chosen pixel: its numbers and plots, and the mark on the picture.

import { $ } from "./dom.js";
import { ask } from "./link.js";
import { drawHistogram, drawSpectrum } from "./plots.js";
import { isCalibrated, redraw, state } from "./state.js";

const INTERVAL_MS = 250; // between requests while the same pixel is chosen
let askedMs = 0;

/** Choose a pixel; places outside the picture mean its edge. */
export function choosePixel(row, col) {
  const { rows, cols } = state.instrument;
  state.pixel = [Math.max(0, Math.min(rows - 1, row)), Math.max(0, Math.min(cols - 1, col))];
  askedMs = 0;
  refreshPixel();
  redraw();
}

/** Ask for the numbers of the chosen pixel, not too often. */
export async function refreshPixel() {
  const now = performance.now();
  if (!state.pixel || !state.picture || now - askedMs < INTERVAL_MS) return;
  askedMs = now;
  const [row, col] = state.pixel;
  try {
    const facts = await ask("GET", `/api/pixel?row=${row}&col=${col}`);
    if (state.pixel[0] === row && state.pixel[1] === col) {
      state.pixelFacts = facts;
      showPixel();
    }
  } catch (error) {
    $("pixel-note").textContent = error.message;
  }
}

/** Show the latest numbers of the pixel, or empty plots. */
export function showPixel() {
  if (!state.instrument) return;
  const { bands } = state.instrument;
  const facts = state.pixelFacts;
  drawHistogram($("histogram"), facts, bands);
  drawSpectrum($("spectrum"), facts, bands);
  if (!facts) return;
  $("pixel-place").textContent = `row ${facts.row}, column ${facts.col}`;
  const depth = facts.depth_m === null ? "no depth" : `${facts.depth_m.toFixed(4)} m`;
  const spread = facts.depth_std_m === null ? "" : ` ± ${(1e3 * facts.depth_std_m).toFixed(1)} mm`;
  $("pixel-depth").textContent = depth + spread;
  // a pixel that a live picture skips has not changed since it was fitted
  const words = facts.quality.map((flag) => (flag === "skipped" ? "unchanged" : flag.replaceAll("_", " ")));
  const flags = words.length ? `; ${words.join(", ")}` : "";
  $("pixel-note").textContent = `${facts.photons.toLocaleString("en")} photons in ${facts.frames} frames${flags}`;
}

/** Put the mark on the chosen pixel, in views that show the picture once. */
export function showCursor() {
  const cursor = $("cursor");
  const tiled = state.view === "bands" && isCalibrated();
  cursor.hidden = !state.pixel || state.view === "points" || tiled;
  if (cursor.hidden) return;
  const { rows, cols } = state.instrument;
  cursor.style.left = `${((state.pixel[1] + 0.5) / cols) * 100}%`;
  cursor.style.top = `${((state.pixel[0] + 0.5) / rows) * 100}%`;
}
