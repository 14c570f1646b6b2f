// SPDX-License-Identifier: Apache-2.0
// The present picture as a file: the view, the numbers of all pixels, the points, or the series.

import { chosenFlags, depthLimit } from "./certainty.js";
import { $ } from "./dom.js";
import { screenSize } from "./gl.js";
import { showMessage } from "./messages.js";
import { seriesText } from "./series.js";
import { state } from "./state.js";
import { depthOf, depthStdOf, flagsOf, placeOf, reflectanceOf } from "./values.js";

const KEPT_MS = 60_000; // a file that the browser may still be saving

/** Save as the format that is chosen. */
export async function save(format) {
  const { picture, instrument } = state;
  if (!picture) {
    showMessage("There is no picture yet.");
    return;
  }
  const base = `${state.file?.name ?? state.status?.name ?? "hueflight"}-${picture.number}`.replaceAll(" ", "-");
  if (format === "png") {
    const canvas = $({ points: "cloud", materials: "materials" }[state.view] ?? "plane");
    const blob = await new Promise((done) => onScreen(canvas).toBlob(done, "image/png"));
    offer(URL.createObjectURL(blob), `${base}-${state.view}.png`);
  } else if (format === "csv") {
    offerText(pixelsText(picture, instrument), "text/csv", `${base}.csv`);
  } else if (format === "series") {
    offerText(seriesText(instrument.bands), "text/csv", `${base}-series.csv`);
  } else if (!picture.planes.depth) {
    showMessage("There are no points without a calibration.");
  } else {
    offerText(pointsText(picture, instrument), "model/ply", `${base}.ply`);
  }
}

/** A canvas with as many pixels as it covers on the screen. */
function onScreen(canvas) {
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = screenSize(canvas);
  const c = copy.getContext("2d");
  c.imageSmoothingEnabled = false;
  c.drawImage(canvas, 0, 0, copy.width, copy.height);
  return copy;
}

/** Have the browser save what is at an address. */
export function offer(address, name) {
  const link = document.createElement("a");
  link.href = address;
  link.download = name;
  link.click();
  if (address.startsWith("blob:")) setTimeout(() => URL.revokeObjectURL(address), KEPT_MS);
}

function offerText(text, type, name) {
  offer(URL.createObjectURL(new Blob([text], { type })), name);
}

const number = (v, digits) => (Number.isFinite(v) ? v.toFixed(digits) : "");

function pixelsText(picture, { bands, flags }) {
  const names = bands.map(({ wavelength_nm }) => `reflectance_${wavelength_nm}nm`);
  const lines = [["row", "col", "photons", "frames", "depth_m", "depth_std_m", "flags", ...names].join(",")];
  for (let i = 0; i < picture.rows * picture.cols; i++) {
    lines.push([
      Math.floor(i / picture.cols), i % picture.cols, picture.planes.photons[i],
      picture.planes.frames?.[i] ?? picture.frames,
      number(depthOf(picture, i), 5), number(depthStdOf(picture, i), 5),
      flagsOf(picture, i, flags).join(" "),
      ...bands.map((_, b) => (Number.isFinite(depthOf(picture, i)) ? number(reflectanceOf(picture, b, i), 4) : "")),
    ].join(","));
  }
  return lines.join("\n") + "\n";
}

/** Points as the view of points shows them: none that are less certain than asked for, or flagged. */
function pointsText(picture, instrument) {
  const points = [];
  const [limit, leftOut] = [depthLimit(), chosenFlags()];
  for (let i = 0; i < picture.rows * picture.cols; i++) {
    const std = depthStdOf(picture, i);
    if (!Number.isFinite(std) || std > limit || picture.planes.quality[i] & leftOut) continue;
    const [right, down, away] = placeOf(picture, i, instrument);
    const colour = picture.planes.colours?.subarray(3 * i, 3 * i + 3) ?? [128, 128, 128];
    points.push([right, -down, -away].map((v) => v.toFixed(5)).concat(...colour, std.toFixed(5)).join(" "));
  }
  return [
    "ply", "format ascii 1.0", "comment metres; x right, y up, z towards the camera",
    `element vertex ${points.length}`,
    ...["x", "y", "z"].map((name) => `property float ${name}`),
    ...["red", "green", "blue"].map((name) => `property uchar ${name}`),
    "property float depth_std", "end_header", ...points,
  ].join("\n") + "\n";
}
