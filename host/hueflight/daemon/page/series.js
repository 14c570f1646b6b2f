// SPDX-License-Identifier: Apache-2.0
// Values of the chosen pixel and of the region from picture to picture, as a plot and for a file.

import { $, setText } from "./dom.js";
import { plotFrame } from "./plots.js";
import { state } from "./state.js";
import { brightnessOf, depthOf, depthStdOf } from "./values.js";

const MOST = 3000; // pictures; older ones are forgotten
let entries = [];
let subject = "";

/** Forget everything when another pixel or region is chosen. */
function checkSubject() {
  const now = JSON.stringify([state.pixel, state.region, state.file?.name]);
  if (now !== subject) entries = [];
  subject = now;
}

/** Add a picture; `region` is what was measured in it. */
export function addToSeries(picture, region) {
  checkSubject();
  const unix_s = isCounted() ? picture.number : picture.received_unix_s; // times, or numbers in place of them
  if (entries.length && unix_s < entries.at(-1).unix_s) entries = []; // a file that is played again
  const index = state.pixel && state.pixel[0] * picture.cols + state.pixel[1];
  entries.push({
    number: picture.number,
    unix_s,
    depth: index === null ? NaN : depthOf(picture, index),
    depth_std: index === null ? NaN : depthStdOf(picture, index),
    photons: index === null ? NaN : brightnessOf(picture, index),
    region_depth: region?.depth.mean ?? NaN,
    region_depth_error: region?.depth.error ?? NaN,
    region_photons: region?.photons.mean ?? NaN,
    region_spectrum: region?.spectrum.map(({ mean }) => mean) ?? [],
  });
  if (entries.length > MOST) entries.shift();
}

/** Whether pictures are counted, as those of a file that does not say when they were taken. */
function isCounted() {
  return state.file !== null && state.file.kind !== "recording";
}

/** Draw the chosen value over time: the pixel as dots, the region as a line. */
export function drawSeries() {
  const canvas = $("series");
  const name = $("series-of").value;
  const of = (key) => entries.map((entry) => entry[key]);
  const [pixel, region] = [of(name), of(`region_${name}`)];
  const known = [...pixel, ...region].filter(Number.isFinite);
  const last = entries.at(-1);
  const t = entries.map((entry) => entry.unix_s - last.unix_s);
  const [low, high] = known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
  const margin = 0.08 * (high - low) || 0.01;
  const span = [Math.min(-1, t[0] ?? -1), 0];
  const { c, x, y, colour } = plotFrame(
    canvas, span, [low - margin, high + margin], isCounted() ? "pictures" : "s ago", name === "depth" ? "m" : "photons per frame",
  );
  c.fillStyle = colour("--soft");
  pixel.forEach((v, i) => Number.isFinite(v) && c.fillRect(x(t[i]) - 1, y(v) - 1, 2.5, 2.5));
  c.strokeStyle = colour("--accent");
  c.lineWidth = 1.5;
  c.beginPath();
  region.forEach((v, i) => Number.isFinite(v) && c.lineTo(x(t[i]), y(v)));
  c.stroke();
  setText($("series-now"), entries.length > 1 ? `${entries.length} pictures` : "");
}

/** The series as text with commas between values. */
export function seriesText(bands) {
  const names = Object.keys(entries[0] ?? {}).filter((name) => name !== "region_spectrum");
  const head = [...names, ...bands.map(({ wavelength_nm }) => `region_reflectance_${wavelength_nm}nm`)];
  const cell = (v) => (Number.isFinite(v) ? String(v) : "");
  const rows = entries.map((entry) => [...names.map((name) => entry[name]), ...bands.map((_, b) => entry.region_spectrum[b])]);
  return [head, ...rows.map((row) => row.map(cell))].map((row) => row.join(",")).join("\n") + "\n";
}
