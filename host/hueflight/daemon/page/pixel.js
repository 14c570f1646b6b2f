// SPDX-License-Identifier: Apache-2.0
// The chosen pixel: its numbers and plots, and the mark on the picture.

import { $, setShown, setText } from "./dom.js";
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

/** Ask for the numbers of the chosen pixel, not too often unless it must be `now`. */
export async function refreshPixel(now = false) {
  const time = performance.now();
  if (!state.pixel || !state.picture || (!now && time - askedMs < INTERVAL_MS)) return;
  askedMs = time;
  const [row, col] = state.pixel;
  try {
    const facts = await ask("GET", pixelPath(row, col));
    if (state.pixel[0] === row && state.pixel[1] === col) {
      state.pixelFacts = facts;
      showPixel();
    }
  } catch (error) {
    setText($("pixel-note"), error.message);
  }
}

/** Where the daemon has the numbers of a pixel: of the live picture, or of that of a file. */
function pixelPath(row, col) {
  const { file, picture } = state;
  if (!file) return `/api/pixel?row=${row}&col=${col}`;
  const [start, stop] = picture.span;
  return `/api/playback/${file.name}/pixel?start=${start}&stop=${stop}&row=${row}&col=${col}`;
}

/** Show the latest numbers of the pixel, or empty plots. */
export function showPixel() {
  if (!state.instrument) return;
  const { bands } = state.instrument;
  const facts = state.pixelFacts;
  drawHistogram($("histogram"), facts, bands);
  drawSpectrum($("spectrum"), facts, bands);
  if (!facts) return;
  setText($("pixel-place"), `row ${facts.row}, column ${facts.col}`);
  const depth = facts.depth_m === null ? "no depth" : `${facts.depth_m.toFixed(4)} m`;
  const spread = facts.depth_std_m === null ? "" : ` ± ${(1e3 * facts.depth_std_m).toFixed(1)} mm`;
  setText($("pixel-depth"), depth + spread);
  // a pixel that a live picture skips has not changed since it was fitted
  const words = facts.quality.map((flag) => (flag === "skipped" ? "unchanged" : flag.replaceAll("_", " ")));
  const flags = words.length ? `; ${words.join(", ")}` : "";
  setText($("pixel-note"), `${facts.photons.toLocaleString("en")} photons${facts.frames ? ` in ${facts.frames} frames` : ""}${flags}${facts.counts_missing ? `; ${facts.counts_missing}` : ""}`);
  setText($("pixel-materials"), (facts.materials ?? []).map(materialText).join("; "));
}

/** An abundance or index with its standard deviation. */
export function materialText({ name, value, std }) {
  return `${name}: ${value === null || std === null ? "unknown" : `${value.toFixed(2)} ± ${std.toFixed(2)}`}`;
}

/** Put the mark on the chosen pixel, in views that show the picture once. */
export function showCursor() {
  const cursor = $("cursor");
  const tiled = state.view === "bands" && isCalibrated();
  setShown(cursor, state.pixel && state.view !== "points" && !tiled);
  if (cursor.hidden) return;
  const { rows, cols } = state.instrument;
  cursor.style.left = `${((state.pixel[1] + 0.5) / cols) * 100}%`;
  cursor.style.top = `${((state.pixel[0] + 0.5) / rows) * 100}%`;
}
